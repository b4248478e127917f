from pathlib import Path

import pytest

from sculpt_framework.demo_scenes.folder import DemoSettings, write_scene
from sculpt_framework.demo_scenes.objects import demo_object
from sculpt_framework.types import Scene
from sculpt_plugins.datasets.blender.config import BlenderConfig


@pytest.fixture(scope="session")
def scene_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """11 train views of 48 x 48 pixels, the last of which repeats the first."""
    folder = tmp_path_factory.mktemp("scene") / "pebble"
    settings = DemoSettings(train_views=10, test_views=1, resolution=48, reference_cells=24)
    write_scene(demo_object("pebble"), settings, folder)
    text = (folder / "transforms_train.json").read_text(encoding="utf-8")
    start, end = text.index("{", text.index("frames")), text.index("}", text.index("frames")) + 1
    again = text[start:end].replace("r_0", "again")
    (folder / "transforms_train.json").write_text(text[:end] + ", " + again + text[end:], encoding="utf-8")
    (folder / "train" / "again.png").write_bytes((folder / "train" / "r_0.png").read_bytes())
    return folder


@pytest.fixture(scope="session")
def scene(scene_folder: Path) -> Scene:
    return BlenderConfig().build(str(scene_folder)).load()
