"""Folders in the layout of OmniObject3D, written here: renders of a box without symmetry, from its scan set upright."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import trimesh
from plain_scenes import write_image

from sculpt_framework.demo_scenes.cameras import FIELD_OF_VIEW, demo_cameras
from sculpt_framework.errors import ConfigError, DataError
from sculpt_framework.evaluation.mesh import load_mesh
from sculpt_framework.types import Scene
from sculpt_framework.validation import check_component
from sculpt_plugins.datasets.auto.config import AutoDatasetConfig
from sculpt_plugins.datasets.auto.dataset import recognise
from sculpt_plugins.datasets.omniobject3d.config import OmniObject3DConfig
from sculpt_plugins.datasets.omniobject3d.scan import find_scan, to_render_frame

SIDE = 96
VIEWS = 12
LOW, HIGH = np.array([-10.0, -4.0, -3.0]), np.array([6.0, 20.0, 5.0])
"""Corners of the scanned box: y up, in millimetres, no two sides alike and not around the origin."""
SCALE = 0.99 / 20.0
"""As the dataset's renderer has it: 0.99 over the largest coordinate."""
_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
Write = Callable[..., Path]


@pytest.fixture(autouse=True)
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return tmp_path / "cache"


def scan() -> trimesh.Trimesh:
    return trimesh.creation.box(bounds=np.stack([LOW, HIGH]))


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """``write(place, scan_place)``: an object's renders, and its scan; places are below the dataset's root."""

    def put(
        place: str = "blender_renders/pan/pan_007",
        scan_place: str | None = "raw_scans/pan/pan_007",
        *,
        alpha: bool = True,
        scale: float = SCALE,
        prefix: str = "",
        change: Callable[[dict[str, Any]], object] = lambda document: None,
    ) -> Path:
        render = tmp_path / place / "render"
        (render / "images").mkdir(parents=True)
        x, y, z = np.asarray(scan().vertices).T
        corners = SCALE * np.stack([x, -z, y], axis=1)
        frames = []
        for index, camera in enumerate(demo_cameras(VIEWS, SIDE)):
            view = camera.world_to_camera.numpy()
            seen = corners @ view[:3, :3].T + view[:3, 3]
            pixels = seen[:, :2] / seen[:, 2:] * camera.fx + (camera.cx, camera.cy)
            image = np.zeros((SIDE, SIDE, 4 if alpha else 3), np.uint8)
            hull = cv2.convexHull(np.round(pixels * 16).astype(np.int32))
            color = (60, 120, 180, 255) if alpha else (60, 120, 180)
            cv2.fillConvexPoly(image, hull, color, lineType=cv2.LINE_AA, shift=4)
            write_image(render / "images" / f"r_{index}.png", image)
            matrix = np.linalg.inv(view) @ _FLIP
            frames.append({"file_path": f"{prefix}r_{index}", "rotation": 0.06, "transform_matrix": matrix.tolist()})
            frames[-1]["scale"] = scale
        document = {"camera_angle_x": FIELD_OF_VIEW, "frames": frames}
        change(document)
        (render / "transforms.json").write_text(json.dumps(document), encoding="utf-8")
        if scan_place is not None:
            (tmp_path / scan_place / "Scan").mkdir(parents=True)
            scan().export(tmp_path / scan_place / "Scan" / "Scan.obj")
        return tmp_path / place

    return put


def load(folder: Path, **options: Any) -> Scene:
    return OmniObject3DConfig(**options).build(str(folder)).load()


def test_images_poses_and_scan_fit_together(write: Write):
    scene = load(write())
    assert scene.name == "pan_007"
    assert len(scene.train) == VIEWS
    assert scene.test == ()
    assert scene.reference_mesh is not None
    vertices = load_mesh(scene.reference_mesh).vertices
    low, high = SCALE * np.array([LOW[0], -HIGH[2], LOW[1]]), SCALE * np.array([HIGH[0], -LOW[2], HIGH[1]])
    np.testing.assert_allclose([vertices.min(0), vertices.max(0)], [low, high], atol=1e-6)
    # The box comes from masks and poses alone: it holds the scan, and not much more of its height.
    assert (scene.box.minimum.numpy() < low + 0.02).all()
    assert (scene.box.maximum.numpy() > high - 0.02).all()
    assert scene.box.maximum.numpy()[2] < high[2] + 0.15
    assert f"all {VIEWS} views are learned from" in " ".join(scene.notes)
    assert "turned to z up and scaled by 0.0495" in scene.notes[-1]


def test_the_quarter_turn():
    up = to_render_frame(np.array([[1.0, 2.0, 3.0]]), 2.0)
    np.testing.assert_array_equal(up, [[2.0, -6.0, 4.0]])


@pytest.mark.parametrize(
    ("place", "scan_place"),
    [
        ("blender_renders/pan/pan_007", "raw_scans/pan/pan_007"),
        ("blender_renders/pan_007", "raw_scans/pan_007"),
        ("blender_renders/pan_007", "raw_scans/pan/pan_007"),
        ("pan/pan_007", "pan/pan_007"),
    ],
)
def test_where_a_scan_may_be(place: str, scan_place: str, write: Write, tmp_path: Path):
    folder = write(place, scan_place)
    assert find_scan(folder) == tmp_path / scan_place / "Scan" / "Scan.obj"
    assert load(folder).reference_mesh is not None


def test_the_placed_scan_is_kept_and_made_again_when_the_scan_changes(write: Write, cache: Path, tmp_path: Path):
    folder = write()
    first = load(folder).reference_mesh
    assert first is not None
    assert first.is_relative_to(cache)
    assert load(folder).reference_mesh == first
    path = tmp_path / "raw_scans" / "pan" / "pan_007" / "Scan" / "Scan.obj"
    path.write_text(path.read_text(encoding="utf-8") + "\n# measured again\n", encoding="utf-8")
    assert load(folder).reference_mesh != first


def test_without_a_scan(write: Write):
    scene = load(write(scan_place=None))
    assert scene.reference_mesh is None
    assert "no scan found" in scene.notes[-1]


@pytest.mark.parametrize(("factor", "message"), [(3.0, r"out of their box"), (0.3, "times as large")])
def test_a_scan_that_does_not_fit_the_images_is_not_used(factor: float, message: str, write: Write):
    scene = load(write(scale=factor * SCALE))
    assert scene.reference_mesh is None
    assert message in scene.notes[-1]
    assert scene.notes[-1].endswith("it is not used.")


def test_images_without_alpha_on_black(write: Write):
    scene = load(write(alpha=False))
    assert all(view.alpha is not None for view in scene.train)
    assert scene.reference_mesh is not None


@pytest.mark.parametrize("prefix", ["/mnt/storage/renders/pan_007/render/images/", "images/", "C:\\renders\\"])
def test_only_the_name_of_an_image_counts(prefix: str, write: Write):
    assert len(load(write(prefix=prefix)).train) == VIEWS


def test_holding_views_out(write: Write):
    scene = load(write(), test_every=4)
    assert [view.name for view in scene.test] == ["images/r_0", "images/r_4", "images/r_8"]
    assert len(scene.train) == VIEWS - 3


def test_auto_recognises_the_object_and_its_renders(write: Write):
    folder = write()
    for data in (folder, folder / "render"):
        scene = AutoDatasetConfig().build(str(data)).load()
        assert scene.name == "pan_007"
        assert scene.notes[0] == "layout: OmniObject3D (there is render/transforms.json)."
    with pytest.raises(DataError, match=r"scenes inside it \(pan_007\)"):
        AutoDatasetConfig().build(str(folder.parent))


def test_transforms_beside_images_are_not_taken_for_it(write: Write):
    folder = write()
    (folder / "render").rename(folder / "other")
    assert recognise(str(folder / "other")).name == "nerfstudio"


def frame(number: int, **values: Any) -> Callable[[dict[str, Any]], object]:
    return lambda document: document["frames"][number].update(values)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda document: [each.update(file_path="r_99") for each in document["frames"]],
            r"images are not there \(r_99, .*\), which leaves 0; expected 3 or more",
        ),
        (frame(3, scale=0.1), r"scales \[0\.0495, 0\.1\]; expected one above 0 for all frames"),
        (frame(3, scale="big"), "frame 3: scale is a text; expected a number"),
        (lambda document: document["frames"][1].pop("scale"), "frame 1: no 'scale'"),
        (lambda document: document.pop("camera_angle_x"), "no focal length"),
        (lambda document: document.update(frames=[]), "'frames' is empty"),
        (frame(4, transform_matrix=[[1]]), "frame 4 .*: transform_matrix is not 4 rows"),
    ],
)
def test_what_is_wrong_is_one_line(change: Callable[[dict[str, Any]], object], message: str, write: Write):
    with pytest.raises(DataError, match=message):
        load(write(change=change))


def test_frames_without_an_image_are_left_out(write: Write):
    scene = load(write(change=frame(2, file_path="r_99")))
    total = len(scene.train) + 1
    assert any(f"1 of {total} images are not there and are left out: r_99." in note for note in scene.notes)


def test_wrong_folders_and_options(write: Write, tmp_path: Path):
    folder = write()
    with pytest.raises(DataError, match=r"no render/transforms\.json; found pan_007/; expected an object of"):
        load(folder.parent)
    with pytest.raises(ConfigError, match=r"--dataset\.test-every is 1; expected 0, or 2 or more"):
        check_component(OmniObject3DConfig(test_every=1))
    (tmp_path / "raw_scans" / "pan" / "pan_007" / "Scan" / "Scan.obj").write_text("v 0 0 0\n", encoding="utf-8")
    with pytest.raises(DataError, match=r"Scan\.obj"):
        load(folder)
