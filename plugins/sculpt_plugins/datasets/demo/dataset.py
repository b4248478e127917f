"""A demo scene, rendered into the user's cache once and read from there as anybody's data would be."""

from dataclasses import replace

from sculpt_framework.datasets import Dataset
from sculpt_framework.demo_scenes.folder import DemoSettings, cached_scene
from sculpt_framework.demo_scenes.objects import DEFAULT, demo_object
from sculpt_framework.errors import DataError
from sculpt_framework.types import Scene

# The one import across plug-ins of a slot: what a demo is on disk is the other plug-in's layout, and reading it there
# makes a demo run exercise the loader that users' own data go through.
from sculpt_plugins.datasets.blender.config import BlenderConfig
from sculpt_plugins.datasets.demo.config import DemoConfig


class DemoDataset(Dataset):
    def __init__(self, config: DemoConfig, data: str):
        """Raises DataError if ``data`` is not a demo scene."""
        kind, _, name = data.partition(":")
        if kind != "demo":
            raise DataError(f"{data}: not a demo scene; expected demo or demo:NAME, or another --dataset for a folder.")
        self.item = demo_object(name or DEFAULT)
        self.settings = DemoSettings(
            train_views=config.train_views,
            test_views=config.test_views,
            resolution=self.item.resolution if config.resolution is None else config.resolution,
            seen_from=config.seen_from,
        )

    def load(self) -> Scene:
        folder = cached_scene(self.item, self.settings)
        scene = BlenderConfig().build(str(folder)).load()
        return replace(scene, notes=(f"demo scene '{self.item.name}': {self.item.summary}.", *scene.notes))
