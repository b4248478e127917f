"""The package as a library: what a notebook does with it."""

import itertools
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import sculpt_framework as sculpt
from sculpt_framework.demo_scenes.folder import DemoSettings, write_scene
from sculpt_framework.demo_scenes.objects import demo_object
from sculpt_framework.engine.run import load_finished
from sculpt_framework.errors import OutputError, TrainingFailed
from sculpt_framework.evaluation.mesh import load_mesh
from sculpt_framework.events import Event
from sculpt_framework.stress.small import small_method, small_scene

QUICK_START = Path(__file__).parents[2] / "docs" / "guide" / "quick-start.md"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("library") / "blob"
    write_scene(demo_object("blob"), DemoSettings(train_views=11, test_views=2, resolution=48, reference_cells=32), out)
    return out


@pytest.fixture(scope="module")
def scene() -> sculpt.Scene:
    return small_scene()


def run(scene: sculpt.Scene, seed: int = 0, steps: int = 6) -> sculpt.Session:
    return sculpt.Session(scene, replace(small_method(steps), seed=seed))


def test_what_is_offered_is_there_and_loads_late():
    assert all(getattr(sculpt, name) is not None for name in sculpt.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        sculpt.nothing  # noqa: B018
    script = "import sys, sculpt_framework; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", script], check=False).returncode == 0


@pytest.mark.slow
def test_the_example_of_the_quick_start_runs(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    page = QUICK_START.read_text(encoding="utf-8").partition("## From Python")[2]
    (code,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)[:1]
    # The same on a small scene, in less time, with the smallest method.
    code = code.replace('"demo"', repr(str(folder))).replace("max_time=120", "max_time=15")
    code = code.replace("gaussian-sculpting", "gaussian-sculpting-tiny").replace("outputs/mine", str(tmp_path / "mine"))
    names: dict[str, object] = {}
    exec(compile(code, "quick-start", "exec"), names)
    told = capsys.readouterr().out
    assert re.match(r"\d+%, step 0, loss None\n\d+%, step 1, loss 0\.\d+\n", told)
    assert names["mesh"].is_watertight  # pyright: ignore
    assert names["picture"].shape == (48, 48, 3)  # pyright: ignore
    saved = load_finished(tmp_path / "mine")
    assert saved.scene.train[0].name == names["scene"].train[0].name  # pyright: ignore
    assert (saved.test_measures()["psnr"] or 0) > 12
    vertices = load_mesh(tmp_path / "mine" / "mesh.ply").vertices
    np.testing.assert_allclose(vertices, names["mesh"].vertices, atol=1e-6)  # pyright: ignore
    with pytest.raises(OutputError, match="not empty"):
        names["session"].save(tmp_path / "mine")  # pyright: ignore


def test_methods_are_named(scene: sculpt.Scene):
    assert "gaussian-sculpting" in sculpt.methods
    assert next(iter(sculpt.methods)) == "gaussian-sculpting"
    assert len(sculpt.methods) == len(list(sculpt.methods))
    with pytest.raises(KeyError):
        sculpt.methods["magic"]


def test_reports_come_after_the_start_and_every_step(scene: sculpt.Scene, capsys: pytest.CaptureFixture[str]):
    session = run(scene)
    with pytest.raises(TrainingFailed, match="no surface yet"):
        session.mesh()
    reports = list(session)
    assert [report.step for report in reports] == list(range(7))
    assert [report.loss is None for report in reports] == [True, *[False] * 6]
    assert reports[0].progress == 0
    assert reports[-1].progress == 1
    assert session.status == "finished"
    assert list(session) == []
    assert capsys.readouterr() == ("", "")


@pytest.mark.slow
def test_two_sessions_do_not_disturb_each_other(scene: sculpt.Scene):
    alone = [run(scene, seed).run().vertices for seed in (0, 1)]
    torch.manual_seed(5)
    wanted = torch.rand(3)
    torch.manual_seed(5)
    sessions = [run(scene, seed) for seed in (0, 1)]
    for _ in itertools.zip_longest(*sessions):
        pass
    for session, vertices in zip(sessions, alone, strict=True):
        np.testing.assert_array_equal(session.mesh().vertices, vertices)
    # Nor the numbers of whoever calls.
    assert torch.equal(torch.rand(3), wanted)


@pytest.mark.parametrize("where", ["between steps", "outer_step", "evaluation"])
def test_an_interrupt_leaves_a_session_that_goes_on(scene: sculpt.Scene, where: str):
    left = [1]

    def emit(event: Event) -> None:
        if event.event == where and event.outer >= 2 and left:
            left.clear()
            raise KeyboardInterrupt

    session = sculpt.Session(scene, replace(small_method(6), holdout_every=4), emit=emit)

    def interrupted() -> None:
        for report in session:
            if where == "between steps" and report.step == 3:
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert session.mesh().to_trimesh().is_watertight
    assert session.render(scene.train[0].camera).rgb.shape == (48, 48, 3)
    rest = [report.step for report in session]
    assert rest[-1] == 6
    assert session.status == "finished"
    assert session.mesh().to_trimesh().is_watertight


@pytest.mark.slow
def test_looking_changes_nothing(scene: sculpt.Scene):
    plain = run(scene).run()
    watched = run(scene)
    for _ in watched:
        assert len(watched.mesh().colors) == len(watched.mesh().vertices)
        watched.render(scene.train[1].camera)
    np.testing.assert_array_equal(watched.mesh().vertices, plain.vertices)
    np.testing.assert_array_equal(watched.mesh().colors, plain.colors)


def test_a_scene_is_built_by_hand_and_the_clock_starts_with_the_session(
    scene: sculpt.Scene, time_passes: Callable[[float], None]
):
    """Whatever the process did before; and the session ends when its time is over."""
    bare = sculpt.Scene(name="mine", train=scene.train, test=(), box=scene.box)
    time_passes(1e6)
    session = sculpt.Session(bare, small_method(10_000, polish_steps=0), max_time=6000.0)
    assert session.host.clock.wall_seconds < 5000
    for _ in session:
        time_passes(600.0)
    assert session.step > 2
    assert session.host.clock.wall_seconds < 12_000


def test_a_stopped_session_is_finished_with_what_there_is(scene: sculpt.Scene):
    session = run(scene)
    for report in session:
        if report.step == 2:
            session.stop()
    assert (session.step, session.status) == (2, "stopped")
    assert session.curve[-1]["psnr"] > 5
