"""What a run says of itself: its clock, the digests of its input, its pictures, the same figures each time."""

import hashlib
import json
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from small_runs import TWO_STAGES, small_config, train

from sculpt_framework.engine.clock import TrainingClock
from sculpt_framework.engine.inputs import file_digest, input_digests
from sculpt_framework.engine.run import run
from sculpt_framework.engine.session import Session
from sculpt_framework.errors import DataError
from sculpt_framework.evaluation.album import ERROR_LIMIT, view_pictures
from sculpt_framework.evaluation.curve import read_curve
from sculpt_framework.evaluation.evaluator import Evaluator, image_measures
from sculpt_framework.evaluation.geometry import MeasuredMesh
from sculpt_framework.evaluation.mesh import Mesh, load_mesh
from sculpt_framework.evaluation.pictures import error_colors
from sculpt_framework.export.drawn_mesh import draw_mesh_in_colors
from sculpt_framework.types import Camera, Rendering, Scene, View
from sculpt_plugins.datasets.blender.config import BlenderConfig
from sculpt_plugins.observers.recorder.config import RecorderConfig

TIMES = ("t_train_s", "t_wall_s", "t_cpu_s", "rss_mb")


# -- the clock -------------------------------------------------------------------------------------------------------


class Time:
    """A clock that goes when it is told to."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch):
        self.seconds = 1000.0
        monkeypatch.setattr(time, "monotonic", lambda: self.seconds)

    def passes(self, seconds: float) -> None:
        self.seconds += seconds


def test_training_seconds_leave_out_pauses_and_idle_time(monkeypatch: pytest.MonkeyPatch):
    now, compiled = Time(monkeypatch), [0.0]
    clock = TrainingClock(started=now.seconds, idle=lambda: compiled[0])
    now.passes(5)
    clock.start()
    now.passes(2)
    with clock.pause():
        now.passes(10)
        # What is compiled while the clock stands still is not taken off twice.
        compiled[0] += 4
    now.passes(1)
    compiled[0] += 0.5
    assert clock.train_seconds == pytest.approx(2.5)
    assert clock.wall_seconds == pytest.approx(18)
    clock.stop()
    now.passes(7)
    assert clock.train_seconds == pytest.approx(2.5)
    clock.go_on_from(30.0)
    now.passes(1)
    assert clock.train_seconds == pytest.approx(31)
    assert clock.wall_seconds == pytest.approx(26)


def test_time_spent_measuring_is_not_training(
    scene: Scene, monkeypatch: pytest.MonkeyPatch, time_passes: Callable[[float], None]
):
    """Measuring is made slow; training seconds do not notice, wall seconds do."""
    from sculpt_framework.evaluation import evaluator

    original = evaluator.image_measures

    def slow(*arguments: Any) -> Mapping[str, Any]:
        time_passes(1000.0)
        return original(*arguments)

    monkeypatch.setattr(evaluator, "image_measures", slow)
    events = train(small_config(steps=2), scene).of("evaluation")
    assert len(events) >= 3
    trained, passed = (events[-1].t_train - events[0].t_train), (events[-1].t_wall - events[0].t_wall)
    assert passed >= 1000.0 * (len(events) - 1)
    assert trained < 1000.0
    times = [(event.t_train, event.t_wall) for event in events]
    assert times == sorted(times)


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_views_that_show_nothing_are_not_measured_and_numbers_that_are_none_are_told(scene: Scene, value: float):
    shown = scene.train[0]
    assert shown.alpha is not None
    empty = replace(shown, alpha=torch.zeros_like(shown.alpha))

    def white(camera: Camera) -> Rendering:
        blank = torch.zeros(camera.height, camera.width)
        return Rendering(rgb=torch.ones(camera.height, camera.width, 3), alpha=blank, depth=blank)

    def broken(camera: Camera) -> Rendering:
        made = white(camera)
        made.rgb[3, 4, 0] = value
        return made

    alone, both = (image_measures(white, views) for views in ([shown], [shown, empty]))
    assert alone == both
    assert image_measures(white, [empty]) == dict.fromkeys(alone, None)
    with pytest.raises(FloatingPointError, match="held-out view is not finite"):
        image_measures(broken, [shown])


def test_a_reference_without_area_is_one_line(scene: Scene, tmp_path: Path):
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", encoding="utf-8")
    with pytest.raises(DataError, match=r"flat\.obj cannot be compared with"):
        Evaluator(small_config(reference=tmp_path / "flat.obj"), scene, ())


# -- inputs ----------------------------------------------------------------------------------------------------------


def test_digests_are_those_of_standard_tools(scene: Scene, scene_folder: Path):
    digests = input_digests(scene, scene.reference_mesh)
    assert set(digests) == {"train images", "test images", "cameras", "reference mesh"}
    assert digests["reference mesh"] == hashlib.sha256((scene_folder / "gt_mesh.ply").read_bytes()).hexdigest()
    files = [scene_folder / "train" / f"r_{index}.png" for index in range(11)]
    column = "".join(hashlib.sha256(file.read_bytes()).hexdigest() + "\n" for file in files)
    assert digests["train images"] == hashlib.sha256(column.encode()).hexdigest()


def test_digests_notice_a_pixel_and_a_camera(scene: Scene):
    bare = replace(scene, train=tuple(replace(view, source=None) for view in scene.train), test=())
    before = input_digests(bare, None)
    first, *rest = bare.train
    rgb = first.rgb.clone()
    rgb[0, 0, 0] += 1e-3
    changed = input_digests(replace(bare, train=(replace(first, rgb=rgb), *rest)), None)
    assert changed["cameras"] == before["cameras"]
    assert changed["train images"] != before["train images"]
    moved = replace(first, camera=replace(first.camera, cx=first.camera.cx + 1e-9))
    changed = input_digests(replace(bare, train=(moved, *rest)), None)
    assert changed["train images"] == before["train images"]
    assert changed["cameras"] != before["cameras"]


def test_a_file_that_is_gone_is_named(tmp_path: Path):
    with pytest.raises(DataError, match=r"gone\.png: cannot be read any more"):
        file_digest(tmp_path / "gone.png")


# -- pictures --------------------------------------------------------------------------------------------------------


def test_errors_are_drawn_in_the_color_of_their_distance():
    """A triangle in front of a camera, one unit above a large plate: as dark as a distance of one is."""
    corners = np.array([[-9.0, -9, 1], [9, -9, 1], [9, 9, 1], [-9, 9, 1]])
    plate = MeasuredMesh(Mesh(vertices=corners, faces=np.array([[0, 1, 2], [0, 2, 3]])), samples=10)
    triangle = Mesh(vertices=np.array([[-1.0, -1, 2], [1, -1, 2], [0, 1, 2]]), faces=np.array([[0, 1, 2]]))
    pose = torch.diag(torch.tensor([1.0, -1, -1, 1]))
    pose[2, 3] = 6.0
    camera = Camera(world_to_camera=pose, fx=20.0, fy=20.0, cx=8.0, cy=8.0, width=16, height=16)
    view = View(name="one", camera=camera, rgb=torch.ones(16, 16, 3), alpha=None)
    render = partial(draw_mesh_in_colors, triangle, np.zeros((3, 3), np.float32))
    pictures = view_pictures(render, triangle, view, plate)
    assert not pictures["rendering"][8, 8].any()
    (errors,) = (picture for name, picture in pictures.items() if name.startswith("mesh error"))
    limit = ERROR_LIMIT * (18**2 * 2) ** 0.5
    np.testing.assert_allclose(errors[8, 8] / 255, error_colors(np.array([1 / limit]))[0], atol=0.01)
    assert (errors[0, 0] == 255).all()
    np.testing.assert_allclose(pictures["normals, world frame"][8, 8] / 255, [0.5, 0.5, 1.0], atol=0.01)


def test_pictures_are_of_the_result_and_of_the_start(scene: Scene):
    session = Session(scene, small_config(steps=3))
    session.run()
    pages = session.pictures()
    assert list(pages) == ["Result", "Before training"]
    shape = scene.train[0].rgb.shape
    names = [name.split(":")[0] for name in pages["Result"]]
    assert names == [
        "reference image (train/r_5)",
        "rendering",
        "difference from the reference image",
        "normals, world frame",
        "mesh error",
    ]
    assert all(picture.shape == shape for page in pages.values() for picture in page.values())
    assert [*pages["Before training"]] == [*pages["Result"]][1:]
    assert (pages["Before training"]["rendering"] != pages["Result"]["rendering"]).any()
    bare = Session(replace(scene, reference_mesh=None), small_config(steps=1))
    bare.run()
    assert not any(name.startswith("mesh error") for name in bare.pictures()["Result"])


# -- without a reference ---------------------------------------------------------------------------------------------


def test_without_a_reference_a_run_is_held_against_its_photographs(scene: Scene):
    bare = train(small_config(steps=2), replace(scene, reference_mesh=None))
    row, result = bare.of("evaluation")[-2].data, bare.of("evaluation")[-1].data
    for each in (row, result):
        assert each["pairs"] == 4  # Of eleven views all round most have no neighbour.
        assert 0 < each["residual_px"] <= each["residual_p90_px"]
        assert 0 < each["judged"] <= 1
        assert 0 < each["roughness"] < 90
        assert each["psnr_fitted"] > each["psnr"] - 0.5
    known = train(small_config(steps=2), scene).of("evaluation")[-1].data
    assert known.get("roughness") is None


# -- whole runs ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def twice(scene_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two runs of the same config and seed."""
    config = small_config(
        data=str(scene_folder), dataset=BlenderConfig(), observers=(RecorderConfig(),), steps=5, stages=TWO_STAGES
    )
    root = tmp_path_factory.mktemp("twice")
    for name in ("one", "two"):
        run(replace(config, output=root / name), resume=None, started=0.0)
    return root / "one", root / "two"


def test_the_same_seed_gives_the_same_metrics(twice: tuple[Path, Path]):
    """All of metrics.json but for times and memory, and the mesh to the byte."""
    found = []
    for folder in twice:
        metrics = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
        for column in TIMES:
            assert metrics["final"].pop(column) > 0
        found.append((metrics, (folder / "mesh.ply").read_bytes()))
    assert found[0] == found[1]


def test_a_run_leaves_all_measures(twice: tuple[Path, Path]):
    folder, _ = twice
    metrics = json.loads((folder / "metrics.json").read_text(encoding="utf-8"))
    final = metrics["final"]
    for name in ("point_to_surface", "point_to_point", "point_to_surface_squared", "smallest_angle"):
        assert final[name] > 0
    assert final["point_to_point_floor"] < final["point_to_point"]
    assert metrics["certificate"]["self_intersections"] is not None
    assert load_mesh(folder / "mesh.ply").faces.shape[0] == final["faces"]
    rows = read_curve(folder / "curve.csv")
    for column in ("t_train_s", "t_wall_s", "t_cpu_s"):
        times = [row[column] or 0.0 for row in rows]
        assert times == sorted(times)


def test_the_report_shows_what_was_measured(twice: tuple[Path, Path], scene_folder: Path):
    page = (twice[0] / "report.html").read_text(encoding="utf-8")
    digest = input_digests(BlenderConfig().build(str(scene_folder)).load(), None)["train images"]
    for text in ("Where the time went", "Before training", "mesh error", digest, "processor", "mean_radius_ratio"):
        assert text in page
    assert "Not recorded" not in page
    assert "<h2>Plan</h2>" not in page
