from dataclasses import dataclass
from typing import TYPE_CHECKING

from sculpt_framework.config import DatasetConfig

if TYPE_CHECKING:
    from sculpt_plugins.datasets.auto.dataset import AutoDataset


@dataclass(frozen=True, kw_only=True)
class AutoDatasetConfig(DatasetConfig):
    """Recognises demo names and folder layouts; name a layout with --dataset to set its options."""

    def build(self, data: str) -> "AutoDataset":
        from sculpt_plugins.datasets.auto.dataset import AutoDataset

        return AutoDataset(data)
