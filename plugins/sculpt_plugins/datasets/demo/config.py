from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Literal

from sculpt_framework.config import DatasetConfig
from sculpt_framework.demo_scenes.limits import RESOLUTION, TEST_VIEWS, TRAIN_VIEWS

if TYPE_CHECKING:
    from sculpt_plugins.datasets.demo.dataset import DemoDataset


@dataclass(frozen=True, kw_only=True)
class DemoConfig(DatasetConfig):
    """A built-in scene: --data demo, or demo:NAME; sculpt-data list has the names."""

    resolution: Annotated[int | None, RESOLUTION] = None
    """Side of the square images, in pixels. Default: as the scene asks, mostly 400."""
    train_views: Annotated[int, TRAIN_VIEWS] = 100
    """Images to learn from."""
    test_views: Annotated[int, TEST_VIEWS] = 20
    """Images to measure on, from other places."""
    seen_from: Literal["around", "above", "front"] | None = None
    """Where cameras stand: on all sides, above the equator, or within 75 degrees of +x. Default: as the scene asks."""

    def build(self, data: str) -> "DemoDataset":
        from sculpt_plugins.datasets.demo.dataset import DemoDataset

        return DemoDataset(self, data)
