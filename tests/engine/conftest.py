import os
from pathlib import Path

import pytest
from small_runs import small_config

from sculpt_framework.config import MethodConfig
from sculpt_framework.demo_scenes.folder import DemoSettings, write_scene
from sculpt_framework.demo_scenes.objects import demo_object
from sculpt_framework.types import Scene
from sculpt_plugins.datasets.blender.config import BlenderConfig
from sculpt_plugins.observers.recorder.config import RecorderConfig


@pytest.fixture(scope="session")
def scene_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A demo object as anybody's data would be: 11 train views of 48 x 48, 2 test views, a reference mesh."""
    folder = tmp_path_factory.mktemp("scene") / "blob"
    write_scene(
        demo_object("blob"), DemoSettings(train_views=11, test_views=2, resolution=48, reference_cells=32), folder
    )
    return folder


@pytest.fixture(scope="session")
def scene(scene_folder: Path) -> Scene:
    return BlenderConfig().build(str(scene_folder)).load()


@pytest.fixture(scope="session")
def command_environment() -> dict[str, str]:
    """For programs started by a test: as many threads as the test itself may use, else two."""
    return {"OMP_NUM_THREADS": "2", **os.environ, "COLUMNS": "200"}


@pytest.fixture
def config(scene_folder: Path, tmp_path: Path) -> MethodConfig:
    """A run of four steps on that scene, which is recorded."""
    return small_config(
        data=str(scene_folder),
        dataset=BlenderConfig(),
        observers=(RecorderConfig(),),
        output=tmp_path / "run",
        steps=4,
    )
