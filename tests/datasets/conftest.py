from pathlib import Path

import pytest
from plain_scenes import make_scene

from sculpt_framework.demo_scenes.folder import DemoSettings, write_scene
from sculpt_framework.demo_scenes.objects import OBJECTS


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    return make_scene(tmp_path / "scene")


@pytest.fixture(scope="session")
def demo_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small rendered scene; read-only for tests."""
    folder = tmp_path_factory.mktemp("demo") / "blob"
    write_scene(OBJECTS["blob"], DemoSettings(train_views=8, test_views=2, resolution=80, reference_cells=40), folder)
    return folder
