"""Which scenes a suite has, given what lies in a folder."""

from pathlib import Path

import pytest

from sculpt_framework.demo_scenes.objects import OBJECTS
from sculpt_framework.errors import ConfigError
from sculpt_framework.experiments.paper import OMNIOBJECT3D
from sculpt_framework.experiments.suite_tables import notes
from sculpt_framework.experiments.suites import OMNIOBJECT3D_CATEGORIES, category_of, find_suite, paper_column


def labels(name: str, folder: Path | None, *objects: str, references: Path | None = None) -> list[str]:
    return [scene.label for scene in find_suite(name, folder, objects, references).scenes]


@pytest.fixture
def blender(tmp_path: Path) -> Path:
    for name in ("lego", "chair", "ship", "not-a-scene"):
        (tmp_path / name).mkdir()
        if name != "not-a-scene":
            (tmp_path / name / "transforms_train.json").touch()
    return tmp_path


@pytest.fixture
def omniobject3d(tmp_path: Path) -> Path:
    for name in ("banana/banana_010", "banana/banana_002", "toy_plane/toy_plane_001", "anise/anise_001"):
        (tmp_path / "blender_renders" / name / "render").mkdir(parents=True)
        (tmp_path / "blender_renders" / name / "render" / "transforms.json").touch()
    return tmp_path


def test_demo():
    assert labels("demo", None) == list(OBJECTS)
    assert labels("demo", None, "gaps") == ["gaps"]


def test_blender_takes_the_paper_s_scenes_that_are_there(blender: Path):
    suite = find_suite("blender", blender, [], None)
    assert [(scene.label, scene.data) for scene in suite.scenes] == [
        ("chair", str(blender / "chair")),
        ("lego", str(blender / "lego")),
    ]
    assert suite.missing == ("hotdog", "drums", "mic")
    assert "not in the folder: hotdog, drums, mic." in notes(suite)
    assert labels("blender", blender, "ship", "lego") == ["ship", "lego"]


def test_blender_with_references_of_one_s_own(blender: Path, tmp_path: Path):
    meshes = tmp_path / "meshes"
    meshes.mkdir()
    for name in ("chair.ply", "lego.obj"):
        (meshes / name).touch()
    suite = find_suite("blender", blender, [], meshes)
    assert [scene.words for scene in suite.scenes] == [
        ("--reference", str(meshes / "chair.ply")),
        ("--reference", str(meshes / "lego.obj")),
    ]
    (meshes / "lego.obj").unlink()
    with pytest.raises(ConfigError, match=r"no mesh for lego; expected lego\.ply"):
        find_suite("blender", blender, [], meshes)


def test_omniobject3d_takes_the_first_object_of_each_category(omniobject3d: Path):
    suite = find_suite("omniobject3d", omniobject3d, [], None)
    assert [scene.label for scene in suite.scenes] == ["banana_002", "toy_plane_001"]
    assert suite.scenes[0].data == str(omniobject3d / "blender_renders" / "banana" / "banana_002")
    assert len(suite.missing) == 10
    assert labels("omniobject3d", omniobject3d, "banana_010", "anise") == ["banana_010", "anise_001"]
    assert labels("omniobject3d", omniobject3d / "blender_renders") == ["banana_002", "toy_plane_001"]
    assert any("categories and not scans" in note for note in notes(suite))


def test_omniobject3d_without_the_level_of_categories(tmp_path: Path):
    (tmp_path / "blender_renders" / "durian_003" / "render").mkdir(parents=True)
    (tmp_path / "blender_renders" / "durian_003" / "render" / "transforms.json").touch()
    assert labels("omniobject3d", tmp_path) == ["durian_003"]


def test_every_category_has_its_column():
    assert len(OMNIOBJECT3D_CATEGORIES) == 12
    columns = [paper_column(OMNIOBJECT3D, f"{name}_001") for name in OMNIOBJECT3D_CATEGORIES]
    assert columns == list(range(12))
    assert paper_column(OMNIOBJECT3D, "Toy_Plane_014") == 5
    assert paper_column(OMNIOBJECT3D, "anise_001") is None
    assert category_of("toy_plane_014") == "toy_plane"


def test_mistakes(blender: Path, omniobject3d: Path, tmp_path: Path):
    empty = tmp_path / "empty"
    empty.mkdir()
    cases = [
        (("demo", tmp_path, (), None), "needs no folder"),
        (("demo", None, ("blub",), None), "no such demo scene; there are blob"),
        (("demo", None, ("blob", "gaps", "blob"), None), "--objects blob gaps blob: expected each once"),
        (("blender", blender, ("ship", "ship"), None), "--objects ship ship: expected each once"),
        (("blender", None, (), None), "needs the folder of the data: sculpt-bench suite blender DIR"),
        (("blender", tmp_path / "no", (), None), "no such folder"),
        (("blender", empty, (), None), r"none of the paper's scenes \(chair, .*; there are none"),
        (("blender", blender, ("shipp",), None), "no such scene; there are .*lego, ship"),
        (("blender", blender, (), tmp_path / "no"), "--references .*no such folder"),
        (("omniobject3d", empty, (), None), "expected blender_renders/CATEGORY/OBJECT/render/transforms.json"),
        (("omniobject3d", omniobject3d, ("kiwi",), None), "--objects kiwi: .*neither such an object nor"),
        (("omniobject3d", omniobject3d, (), empty), "leave --references out"),
    ]
    for arguments, message in cases:
        with pytest.raises(ConfigError, match=message):
            find_suite(*arguments)
