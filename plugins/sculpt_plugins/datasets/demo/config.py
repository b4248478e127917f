from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from sculpt_framework.config import DatasetConfig

if TYPE_CHECKING:
    from sculpt_plugins.datasets.demo.dataset import DemoDataset


@dataclass(frozen=True, kw_only=True)
class DemoConfig(DatasetConfig):
    """A built-in scene: --data demo, or demo:NAME; sculpt-data list has the names."""

    resolution: int | None = None
    """Side of the square images, in pixels. Default: as the scene asks, mostly 400."""
    train_views: int = 100
    """Images to learn from."""
    test_views: int = 20
    """Images to measure on, from other places."""
    seen_from: Literal["around", "above", "front"] | None = None
    """Where cameras stand: on all sides, above the equator, or within 75 degrees of +x. Default: as the scene asks."""

    def build(self, data: str) -> "DemoDataset":
        from sculpt_plugins.datasets.demo.dataset import DemoDataset

        return DemoDataset(self, data)
