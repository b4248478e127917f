"""``sculpt-train --resume RUN --refine-box ...``: a finished run gets better in a box and stays as it was outside."""

import json
import math
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from small_runs import ONE_STAGE, finished, small_config

from sculpt_framework.command_line.request import read_request
from sculpt_framework.config import MethodConfig
from sculpt_framework.demo_scenes.distance import Points, Values, smooth_union, sphere
from sculpt_framework.demo_scenes.folder import DemoSettings, write_scene
from sculpt_framework.demo_scenes.objects import DemoObject
from sculpt_framework.demo_scenes.texture import SolidTexture
from sculpt_framework.engine.checkpoint import Progress, read_checkpoint, write_checkpoint
from sculpt_framework.engine.run import run
from sculpt_framework.engine.session import Session
from sculpt_framework.errors import CheckpointError, ConfigError
from sculpt_framework.evaluation.certificate import certify
from sculpt_framework.evaluation.geometry import MeasuredMesh, sample_surface
from sculpt_framework.evaluation.mesh import Mesh, load_mesh
from sculpt_framework.events import Event
from sculpt_framework.types import Scene
from sculpt_plugins.datasets.blender.config import BlenderConfig
from sculpt_plugins.extractors.flexicubes.config import FlexiCubesConfig
from sculpt_plugins.fields.hash_grid.config import HashGridFieldConfig
from sculpt_plugins.observers.recorder.config import RecorderConfig

Corners = tuple[float, float, float, float, float, float]


def trained(config: MethodConfig, folder: Path, output: Path) -> Path:
    config = replace(config, data=str(folder), dataset=BlenderConfig(), observers=(RecorderConfig(),), output=output)
    run(config, resume=None, started=time.monotonic())
    return output


def repaired(words: list[str]) -> Path:
    request = read_request(words)
    assert request.resume is None
    run(request.config, resume=None, started=time.monotonic())
    assert request.config.output is not None
    return request.config.output


def words_for(box: Corners, run_dir: Path, *more: str) -> list[str]:
    return ["--resume", str(run_dir), "--refine-box", *map(str, box), *more]


def octant(scene: Scene, signs: tuple[int, int, int]) -> Corners:
    """A box from the middle of the object to one of its corners."""
    center = scene.box.center.double()
    corner = center + torch.tensor(signs) * scene.box.half_sides.double()
    x0, y0, z0, x1, y1, z1 = torch.cat([torch.minimum(center, corner), torch.maximum(center, corner)]).tolist()
    return x0, y0, z0, x1, y1, z1


def beyond(mesh: Mesh, box: Corners, margin: float) -> np.ndarray:
    """Vertices, in order, farther than the margin from the box."""
    low, high = np.array(box[:3]) - margin, np.array(box[3:]) + margin
    far = ~((mesh.vertices > low) & (mesh.vertices < high)).all(axis=1)
    return np.unique(mesh.vertices[far], axis=0)


@pytest.fixture(scope="module")
def whole(scene_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    extractor = FlexiCubesConfig(split="center", learn_deformation=True)
    config = small_config(extractor=extractor, steps=3, base_cells=16, polish_steps=2)
    return trained(config, scene_folder, tmp_path_factory.mktemp("repair") / "whole")


@pytest.mark.slow
def test_outside_the_box_the_mesh_stays_to_the_bit(scene: Scene, whole: Path):
    box = octant(scene, (1, 1, 1))
    output = repaired(words_for(box, whole, "--steps", "2"))
    assert output == whole.with_name("whole-repair-1")
    before, after = load_mesh(whole / "mesh.ply"), load_mesh(output / "mesh.ply")
    cell = 2 * scene.box.scale / 16
    # The cells the box reaches into, one ring, and half a cell for corners that are shifted.
    kept = beyond(before, box, 2.5 * cell)
    assert len(kept) > 0.25 * len(before.vertices)
    assert np.array_equal(kept, beyond(after, box, 2.5 * cell))
    assert len(after.vertices) > 1.3 * len(before.vertices)
    certificate = certify(after.vertices, after.faces)
    assert certificate.watertight
    assert certificate.consistently_oriented
    metrics = json.loads((output / "metrics.json").read_text(encoding="utf-8"))
    assert metrics["status"] == "finished"
    # Another box of the repaired run; what the first one changed is outside now, and stays.
    other = octant(scene, (-1, -1, -1))
    again = repaired(words_for(other, output, "--steps", "1", "--output", f"{output}-more"))
    third = load_mesh(again / "mesh.ply")
    assert np.array_equal(beyond(after, other, 2.5 * cell), beyond(third, other, 2.5 * cell))
    assert len(third.vertices) > 1.1 * len(after.vertices)


def test_an_interrupted_repair_goes_on_as_an_unbroken_one(
    scene: Scene, whole: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture
):
    words = words_for(octant(scene, (1, 1, 1)), whole, "--steps", "2", "--observers", "none")
    config = read_request(words).config
    start = config.start(scene)
    assert not caplog.records, "the run's mesh is reproduced to the bit"
    unbroken = finished(Session(scene, config, saved=start))
    kept: list[tuple[dict[str, torch.Tensor], Progress]] = []
    steps: list[Event] = []
    session = Session(
        scene,
        config,
        emit=lambda event: steps.append(event) if event.event == "outer_step" else None,
        save_state=lambda state, progress: kept.append((dict(state), progress)),
        saved=start,
    )
    finished(session, lambda: len(steps) == 1)
    write_checkpoint(tmp_path, *kept[-1])
    state, progress = read_checkpoint(tmp_path)
    assert progress.outer == 1
    resumed = finished(Session(scene, config, saved=(state, progress)))
    np.testing.assert_array_equal(resumed.vertices, unbroken.vertices)
    np.testing.assert_array_equal(resumed.faces, unbroken.faces)


def test_what_cannot_be_repaired_is_refused(scene: Scene, whole: Path, tmp_path: Path):
    box = octant(scene, (1, 1, 1))
    unfinished = tmp_path / "unfinished"
    unfinished.mkdir()
    (unfinished / "config.json").write_bytes((whole / "config.json").read_bytes())
    with pytest.raises(CheckpointError, match=r"repairs a finished run; this one is unfinished\. Go on with it first"):
        repaired(words_for(box, unfinished))
    with pytest.raises(ConfigError, match="lies outside the object's box"):
        repaired(words_for((7, 7, 7, 8, 8, 8), whole))
    with pytest.raises(ConfigError, match="seed cannot be changed in a saved run"):
        read_request(words_for(box, whole, "--seed", "3"))
    with pytest.raises(ConfigError, match="trainer cannot be changed in a saved run"):
        read_request(words_for(box, whole, "--trainer.base-cells", "20"))
    assert read_request(["--resume", str(whole)]).resume == whole


def studded(p: Points) -> Values:
    """A ball with sixteen studs on one side, little wider than the cells of the run below."""
    body = sphere(p, (-0.1, 0.0, 0.0), 0.6)
    for up in (-0.6, -0.2, 0.2, 0.6):
        for turn in (-0.6, -0.2, 0.2, 0.6):
            level = 0.62 * math.cos(up)
            place = (level * math.cos(turn) - 0.1, level * math.sin(turn), 0.62 * math.sin(up))
            body = smooth_union(body, sphere(p, place, 0.075), 0.02)
    return body


STUDS: Corners = (0.25, -0.5, -0.5, 0.7, 0.5, 0.5)


def chamfer_in_box(mesh: Mesh, reference: Mesh, box: Corners) -> float:
    """Mean of both directions of point-to-surface distance, for points in the box."""
    ways = []
    for source, target in ((mesh, reference), (reference, mesh)):
        points = sample_surface(source, 60_000, seed=0).points
        inside = ((points > box[:3]) & (points < box[3:])).all(axis=1)
        ways.append(np.sqrt(MeasuredMesh(target, samples=100).squared_distances(points[inside])[0]).mean())
    return float(np.mean(ways))


@pytest.mark.slow
def test_fine_detail_in_the_box_comes_out(tmp_path: Path):
    texture = SolidTexture(ground=(0.85, 0.55, 0.25), patches=(0.2, 0.45, 0.5), spots=(0.95, 0.9, 0.75), seed=11)
    item = DemoObject(name="studs", summary="studs on one side", distance=studded, texture=texture, genus=0)
    settings = DemoSettings(train_views=20, test_views=1, resolution=96, reference_cells=128)
    write_scene(item, settings, tmp_path / "studs")
    config = small_config(
        field=HashGridFieldConfig(num_levels=7, log2_table=14, finest_resolution=128, rate=2e-3),
        stages=(replace(ONE_STAGE[0], inner_steps=3, outer_views=3),),
        base_cells=24,
        steps=30,
        fit_steps=100,
        polish_steps=20,
    )
    whole = trained(config, tmp_path / "studs", tmp_path / "whole")
    output = repaired(words_for(STUDS, whole, "--steps", "60"))
    reference = load_mesh(tmp_path / "studs" / "gt_mesh.ply")
    before, after = load_mesh(whole / "mesh.ply"), load_mesh(output / "mesh.ply")
    assert chamfer_in_box(after, reference, STUDS) <= 2 / 3 * chamfer_in_box(before, reference, STUDS)
    cell = 2 * BlenderConfig().build(str(tmp_path / "studs")).load().box.scale / 24
    kept = beyond(before, STUDS, 2 * cell)
    assert len(kept) > 0.4 * len(before.vertices)
    assert np.array_equal(kept, beyond(after, STUDS, 2 * cell))
