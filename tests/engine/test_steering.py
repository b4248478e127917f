"""A run that is told things: what each command does, that it is told, and that it can be told again."""

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from small_runs import ONE_STAGE, finished, method_of, small_config

from sculpt_framework.commands import (
    AddBox,
    ClearBoxes,
    Command,
    ExportMesh,
    Pause,
    Recorded,
    Resume,
    SetRate,
    SetWeight,
    Stop,
    SwitchConstraint,
    TakeSnapshot,
    command_from_json,
    command_to_json,
    read_recorded,
)
from sculpt_framework.config import MethodConfig
from sculpt_framework.engine.session import Session
from sculpt_framework.engine.steering import Steering
from sculpt_framework.errors import ConfigError
from sculpt_framework.evaluation.certificate import certify
from sculpt_framework.evaluation.geometry import MeasuredMesh
from sculpt_framework.events import Event
from sculpt_framework.export.mesh_files import read_colored_mesh
from sculpt_framework.sculpting.boxes import untaught
from sculpt_framework.sculpting.reconstruction import Reconstruction
from sculpt_framework.types import Box, Scene
from sculpt_plugins.losses.consistency.config import ConsistencyConfig
from sculpt_plugins.observers.recorder.observer import event_line

EVERYTHING: tuple[Command, ...] = (
    Pause(),
    Resume(),
    Stop(),
    SetWeight(slot="losses", name="eikonal", weight=0.5),
    SwitchConstraint(name="spacing", on=False),
    SetRate(part="surface", factor=0.0),
    AddBox(kind="freeze", minimum=(0.0, 0.0, 0.0), maximum=(1.0, 1.0, 2.0)),
    ClearBoxes(),
    ExportMesh(),
    TakeSnapshot(),
)


class Told:
    """A run that gets commands after outer steps, and what came of it."""

    def __init__(
        self,
        config: MethodConfig,
        scene: Scene,
        folder: Path,
        told: Sequence[tuple[int, Command]],
        replay: bool = False,
    ):
        (folder / "checkpoints").mkdir(exist_ok=True)
        self.events: list[Event] = []
        self.meshes: dict[int, Reconstruction] = {}
        """What was extracted in the last step before, by outer steps."""
        session = Session(scene, config, emit=self.events.append)
        left = list(told)

        def due() -> list[Command]:
            now = [command for outer, command in left if outer == session.step]
            left[:] = [(outer, command) for outer, command in left if outer != session.step]
            return now

        self.steering = Steering(
            session,
            folder=folder,
            sources=() if replay else (due,),
            replay=[Recorded(outer=outer, command=command) for outer, command in told] if replay else (),
        )

        def watched() -> bool:
            if method_of(session).trainer.extraction is not None:
                self.meshes[session.step] = method_of(session).reconstruction()
            return self.steering()

        self.method = method_of(session)
        self.result = finished(session, watched)

    @property
    def actions(self) -> list[Event]:
        return [event for event in self.events if event.event == "action"]

    @property
    def steps(self) -> list[Event]:
        return [event for event in self.events if event.event == "outer_step"]


def test_commands_survive_json():
    for command in EVERYTHING:
        assert command_from_json(json.loads(json.dumps(command_to_json(command)))) == command


@pytest.mark.parametrize(
    ("value", "complaint"),
    [
        ({"do": "explode"}, "is no command; expected one of pause, resume"),
        ("pause", "is no command"),
        ({"do": "pause", "now": True}, "takes nothing, not"),
        ({"do": "set-weight", "slot": "losses", "name": "eikonal"}, "takes"),
        ({"do": "set-weight", "slot": "losses", "name": "eikonal", "weight": -1}, "weight of command set-weight is -1"),
        ({"do": "set-weight", "slot": "losses", "name": "eikonal", "weight": float("nan")}, "weight of command"),
        ({"do": "set-weight", "slot": "fields", "name": "mlp", "weight": 1}, "expected losses or constraints"),
        ({"do": "switch-constraint", "name": "spacing", "on": "yes"}, "expected true or false"),
        ({"do": "set-rate", "part": "surface", "factor": 1e9}, "expected 0 to 100"),
        ({"do": "add-box", "kind": "refine", "minimum": [0, 0, 0], "maximum": [1, 0, 1]}, "is empty"),
        ({"do": "add-box", "kind": "refine", "minimum": [0, 0], "maximum": [1, 1, 1]}, "expected three numbers"),
    ],
)
def test_what_is_no_command_is_said(value: object, complaint: str):
    with pytest.raises(ConfigError, match=complaint) as error:
        command_from_json(value)
    assert "\n" not in str(error.value)


def test_a_pause_takes_no_steps_and_no_training_time(
    scene: Scene, tmp_path: Path, time_passes: Callable[[float], None]
):
    config = small_config(steps=4, stages=ONE_STAGE)
    seconds, asked = 60.0, 0
    events: list[Event] = []

    def resume_in_the_end() -> Sequence[Command]:
        nonlocal asked
        if events[-1].data.get("message") != "paused":
            return ()
        asked += 1
        time_passes(seconds / 3)
        return (Resume(),) if asked == 3 else ()

    session = Session(scene, config, emit=events.append)
    told = iter([[], [], [Pause()]])
    steering = Steering(session, folder=tmp_path, sources=[lambda: next(told, []), resume_in_the_end])
    finished(session, steering)
    paused, resumed_event = [event for event in events if event.event == "action"]
    between = events[events.index(paused) + 1 : events.index(resumed_event)]
    assert not [event for event in between if event.event == "outer_step"]
    assert resumed_event.t_wall - paused.t_wall >= seconds
    assert resumed_event.t_train - paused.t_train < 0.1 * seconds
    assert [event.outer for event in events if event.event == "outer_step"] == [1, 2, 3, 4]


def test_stop_ends_the_run_and_its_mesh_is_whole(scene: Scene, tmp_path: Path):
    run = Told(small_config(steps=6, stages=ONE_STAGE), scene, tmp_path, [(2, Stop())])
    assert [event.outer for event in run.steps] == [1, 2]
    assert certify(run.result.mesh.vertices, run.result.mesh.faces).watertight


def test_weights_constraints_and_rates_do_what_they_say(scene: Scene, tmp_path: Path):
    config = small_config(steps=4, stages=ONE_STAGE, gradient_isolation=False)
    name = "eikonal"
    told = [
        (1, SetWeight(slot="losses", name=name, weight=0.0)),
        (2, SwitchConstraint(name="mee-scale", on=False)),
        (3, SetRate(part="surface", factor=0.0)),
        (3, SetRate(part="gaussians", factor=0.0)),
    ]
    run = Told(config, scene, tmp_path, told)
    terms = [event.data["terms"] for event in run.steps]
    assert terms[0][name] > 0
    assert terms[1][name] == 0
    assert ["mee-scale" in each for each in terms] == [True, True, False, False]
    assert run.method.trainer.surface_rate == 0
    before = {name: value.clone() for name, value in run.method.trainer.field.state_dict().items()}
    trainer, images, stage = run.method.trainer, run.method.images, config.trainer.stages[0]
    report = trainer.update(trainer.settle(images, stage, 1.0), images, stage, 1.0)
    after = run.method.trainer.field.state_dict()
    assert np.isfinite(report.loss)
    assert all(bool((before[name] == after[name]).all()) for name in before)


def test_a_term_that_compares_photographs_has_a_weight_too_and_costs_nothing_without(scene: Scene, tmp_path: Path):
    config = small_config(steps=3, stages=ONE_STAGE)
    config = replace(config, losses=(*config.losses, ConsistencyConfig(views=1, partners=1)))
    run = Told(config, scene, tmp_path, [(1, SetWeight(slot="losses", name="consistency", weight=0.0))])
    assert not any(event.data.get("refused") for event in run.actions)
    assert ["consistency" in event.data["terms"] for event in run.steps] == [True, False, False]


def test_what_does_not_fit_the_run_is_refused_and_changes_nothing(scene: Scene, tmp_path: Path):
    config = small_config(steps=2, stages=ONE_STAGE)
    told = [
        (1, SetWeight(slot="losses", name="magic", weight=1.0)),
        (1, SwitchConstraint(name="eikonal", on=False)),
        (1, AddBox(kind="refine", minimum=(50.0, 50.0, 50.0), maximum=(51.0, 51.0, 51.0))),
    ]
    run = Told(config, scene, tmp_path, told)
    assert [event.data["refused"] for event in run.actions] == [True] * 3
    assert "'magic' among its losses; it has photometric" in run.actions[0].data["message"]
    assert "no constraint 'eikonal'" in run.actions[1].data["message"]
    assert "outside the object's box" in run.actions[2].data["message"]
    plain = Told(config, scene, tmp_path, [])
    np.testing.assert_array_equal(run.result.vertices, plain.result.vertices)


def half(scene: Scene, *, upper: bool) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    low, high = scene.box.minimum.tolist(), scene.box.maximum.tolist()
    middle = 0.5 * (low[2] + high[2])
    if upper:
        low[2] = middle
    else:
        high[2] = middle
    return (low[0], low[1], low[2]), (high[0], high[1], high[2])


def test_refining_a_box_makes_finer_triangles_there(scene: Scene, tmp_path: Path):
    low, high = half(scene, upper=True)
    config = small_config(steps=6, stages=ONE_STAGE)
    run = Told(config, scene, tmp_path, [(3, AddBox(kind="refine", minimum=low, maximum=high))])
    mesh = run.result.mesh
    certificate = certify(mesh.vertices, mesh.faces)
    assert certificate.watertight
    corners = mesh.vertices[mesh.faces]
    edge = np.linalg.norm(corners[:, 0] - corners[:, 1], axis=1)
    height = (corners[..., 2].mean(axis=1) - float(scene.box.center[2])) / scene.box.scale
    assert 1.6 < np.median(edge[height < -0.15]) / np.median(edge[height > 0.15]) < 2.4
    back = Told(config, scene, tmp_path, [(3, AddBox(kind="refine", minimum=low, maximum=high)), (5, ClearBoxes())])
    assert len(back.result.faces) < 0.7 * len(run.result.faces)


def test_a_frozen_box_stays_and_the_rest_moves(scene: Scene, tmp_path: Path):
    (x0, y0, middle), (x1, y1, z1) = half(scene, upper=True)
    # Walls beyond the object: only the passage at the lower one is on the surface.
    wall = middle - 0.3 * scene.box.scale
    low, high = (x0 - 1, y0 - 1, wall), (x1 + 1, y1 + 1, z1 + 1)
    config = small_config(steps=10, stages=ONE_STAGE, fit_steps=20)
    run = Told(config, scene, tmp_path, [(3, AddBox(kind="freeze", minimum=low, maximum=high))])
    trainer, (frozen,) = run.method.trainer, run.method.trainer.frozen
    passage = 2 * run.method.parts.grid.cell
    with torch.no_grad():
        points = trainer.extract().surface.vertices
        held, kept, free = trainer.signed_distance(points), frozen.field(points), trainer.field(points)
    depth = frozen.box.depth(points)
    deep, outside = depth > passage, depth < 0
    assert bool(deep.any())
    assert torch.equal(held[deep], kept[deep])
    assert torch.equal(held[outside], free[outside])
    assert float((free - kept)[deep].abs().max()) > 1e-4
    reference = MeasuredMesh(run.meshes[4].mesh, 100)
    distance = np.sqrt(reference.squared_distances(run.result.vertices)[0]) / scene.box.scale
    height = (run.result.vertices[:, 2] - wall) / scene.box.scale
    # A vertex has to do with corners and weights up to a cell away.
    assert distance[height > 1.5 * passage].max() < 1e-5 * run.method.parts.grid.cell


def test_images_teach_nothing_where_they_are_ignored(scene: Scene, tmp_path: Path):
    trainer = Told(small_config(steps=1, stages=ONE_STAGE), scene, tmp_path, []).method.trainer
    box = Box(minimum=-scene.box.half_sides, maximum=scene.box.half_sides * scene.box.half_sides.new([1, 1, 0]))
    surface = trainer.extract().surface
    shielded = untaught([box], surface)
    corners = shielded.vertices.sum(dim=1)
    inside = surface.vertices.detach()[:, 2] < 0
    assert bool(inside.any())
    assert bool((~inside).any())
    assert corners[~inside].sum().requires_grad
    surface.vertices.retain_grad()
    shielded = untaught([box], surface)
    shielded.vertices.sum().backward()
    assert surface.vertices.grad is not None
    assert bool((surface.vertices.grad[inside] == 0).all())
    assert bool((surface.vertices.grad[~inside] == 1).all())


def test_an_export_is_the_mesh_as_it_is(scene: Scene, tmp_path: Path):
    run = Told(small_config(steps=3, stages=ONE_STAGE), scene, tmp_path, [(2, ExportMesh())])
    vertices, faces, colors = read_colored_mesh(Path(run.actions[0].data["path"]))
    np.testing.assert_allclose(vertices, run.meshes[2].vertices, atol=1e-6)
    np.testing.assert_array_equal(faces, run.meshes[2].faces)
    assert colors is not None
    assert Path(run.actions[0].data["path"]).with_suffix(".glb").is_file()


def test_an_export_that_cannot_be_written_is_refused(scene: Scene, tmp_path: Path):
    (tmp_path / "exports").write_text("in the way", encoding="utf-8")
    run = Told(small_config(steps=3, stages=ONE_STAGE), scene, tmp_path, [(2, ExportMesh())])
    assert "refused: cannot write" in run.actions[0].data["message"]
    assert len(run.result.faces) > 0


def test_a_replayed_run_ends_as_the_one_it_follows(scene: Scene, tmp_path: Path):
    config = small_config(steps=6, stages=ONE_STAGE)
    low, high = half(scene, upper=False)
    told = [
        (1, SetWeight(slot="losses", name="silhouette", weight=3.0)),
        (2, AddBox(kind="ignore", minimum=low, maximum=high)),
        (3, SetRate(part="surface", factor=2.0)),
        (5, Stop()),
    ]
    first = Told(config, scene, tmp_path, told)
    path = tmp_path / "events.jsonl"
    path.write_text(
        "".join(event_line(event) for event in first.events if event.event != "snapshot") + '{"v": 1, "t_',
        encoding="utf-8",
    )
    recorded = read_recorded(path)
    assert [(each.outer, each.command) for each in recorded] == told
    again = Told(config, scene, tmp_path, told, replay=True)
    np.testing.assert_array_equal(first.result.vertices, again.result.vertices)
    plain = Told(replace(config, steps=5), scene, tmp_path, [])
    assert not np.array_equal(first.result.vertices, plain.result.vertices)


def test_what_a_resumed_run_did_not_do_again_is_not_replayed(tmp_path: Path):
    def line(event: str, outer: int, **data: object) -> str:
        return json.dumps({"v": 1, "t_train": 0, "t_wall": 0, "outer": outer, "event": event, "data": data}) + "\n"

    kept, lost = SetRate(part="surface", factor=0.5), SetRate(part="surface", factor=0.1)
    path = tmp_path / "events.jsonl"
    path.write_text(
        line("outer_step", 1)
        + line("action", 2, message="", command=command_to_json(kept))
        + line("action", 9, message="", command=command_to_json(lost))
        + line("run_started", 0)
        + line("action", 5, message="going on after outer step 5")
        + line("action", 7, message="", command=command_to_json(Pause())),
        encoding="utf-8",
    )
    assert read_recorded(path) == [Recorded(outer=2, command=kept)]


def test_a_replay_that_cannot_be_read_is_one_line(tmp_path: Path):
    with pytest.raises(ConfigError, match=r"--replay .* cannot be read .*; expected the events.jsonl of a run"):
        read_recorded(tmp_path / "none.jsonl")


def test_a_frozen_surface_outlives_a_resumed_run(scene: Scene, tmp_path: Path):
    low, high = half(scene, upper=True)
    config = small_config(steps=3, stages=ONE_STAGE)
    box = AddBox(kind="freeze", minimum=low, maximum=high)
    first = Told(config, scene, tmp_path, [(1, box)]).method.trainer.frozen[0]
    session = Session(scene, replace(config, seed=7))
    steering = Steering(session, folder=tmp_path)
    steering.take_up([Recorded(outer=1, command=box)], outer=2)
    again = method_of(session).trainer.frozen[0]
    points = first.box.center
    assert float(first.field(points[None]).detach()) == float(again.field(points[None]))
    assert float(first.field(points[None]).detach()) != float(method_of(session).trainer.field(points[None]).detach())


def test_a_replay_of_another_file_is_one_line(tmp_path: Path):
    (tmp_path / "config.json").write_text('{\n  "method": "gaussian-sculpting"\n}\n', encoding="utf-8")
    with pytest.raises(ConfigError, match=r"config.json holds no events; expected the events.jsonl of a run"):
        read_recorded(tmp_path / "config.json")
    # A run may be killed while it writes its first line.
    (tmp_path / "events.jsonl").write_text('{"v": 1, "eve', encoding="utf-8")
    assert read_recorded(tmp_path / "events.jsonl") == []
