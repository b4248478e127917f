"""Memory that will not suffice is told before it is asked for, with the setting to lower."""

import subprocess
import sys
from pathlib import Path

import pytest
import torch
from small_runs import TWO_STAGES, method_of, small_config

from sculpt_framework import memory
from sculpt_framework.engine.session import Session
from sculpt_framework.errors import DataError, TrainingFailed
from sculpt_framework.evaluation.certificate import certify
from sculpt_framework.events import Event
from sculpt_framework.geometry.band import cells_at_level, discover
from sculpt_framework.memory import available_bytes, in_words, peak_bytes
from sculpt_framework.posed_images.training_images import prepare_image
from sculpt_framework.sculpting import memory_check
from sculpt_framework.types import Scene
from sculpt_plugins.datasets.blender.config import BlenderConfig

GIB = 1 << 30
MEMINFO = "MemTotal:       24000000 kB\nMemAvailable:   16777216 kB\nSwapFree: 9 kB\n"


def system(root: Path, **files: str) -> Path:
    """Files of a system under ``root``; ``__`` in a name stands for a slash."""
    for name, text in files.items():
        path = root / name.replace("__", "/").replace("_D_", ".")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")
    return root


@pytest.fixture(autouse=True)
def no_limit_of_this_process(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(memory.resource, "getrlimit", lambda which: (memory.resource.RLIM_INFINITY,) * 2)


def test_the_peak_is_this_process_and_not_that_of_the_one_that_started_it(tmp_path: Path):
    assert peak_bytes(system(tmp_path, proc__self__status="Name: x\nVmHWM:\t    2048 kB\n")) == 2 << 20
    # Where the system does not say, its own count is what there is.
    assert peak_bytes(tmp_path / "elsewhere") >= peak_bytes() * 0.99
    before = peak_bytes()
    held = bytearray(256 << 20)
    held[::4096] = b"x" * len(held[::4096])
    assert peak_bytes() >= before
    script = "from sculpt_framework.memory import peak_bytes; print(peak_bytes())"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True, encoding="utf-8")
    assert int(done.stdout) < 128 << 20 < len(held) <= peak_bytes()


def test_of_the_machine(tmp_path: Path):
    assert available_bytes(tmp_path) is None
    assert available_bytes(system(tmp_path, proc__meminfo=MEMINFO)) == 16 * GIB


def test_of_a_container(tmp_path: Path):
    """The group's path is the host's; inside, the mount is the group."""
    group = {
        "sys__fs__cgroup__memory_D_max": f"{4 * GIB}\n",
        "sys__fs__cgroup__memory_D_current": f"{3 * GIB}\n",
        "sys__fs__cgroup__memory_D_stat": f"anon 5\ninactive_file {GIB // 2}\n",
    }
    system(tmp_path, proc__meminfo=MEMINFO, proc__self__cgroup="0::/kubepods/pod1\n", **group)
    assert available_bytes(tmp_path) == 3 * GIB // 2


def test_of_a_group_above(tmp_path: Path):
    above = "sys__fs__cgroup__memory__jobs__memory_D_"
    own = "sys__fs__cgroup__memory__jobs__7__memory_D_"
    group = {
        f"{above}limit_in_bytes": f"{2 * GIB}\n",
        f"{above}usage_in_bytes": f"{GIB}\n",
        f"{own}limit_in_bytes": "9223372036854771712\n",
        f"{own}usage_in_bytes": f"{GIB}\n",
    }
    system(tmp_path, proc__meminfo=MEMINFO, proc__self__cgroup="3:cpu:/other\n4:memory:/jobs/7\n", **group)
    assert available_bytes(tmp_path) == GIB


def test_no_limit_is_no_limit(tmp_path: Path):
    group = {"sys__fs__cgroup__memory_D_max": "max\n", "sys__fs__cgroup__memory_D_current": "5\n"}
    system(tmp_path, proc__meminfo=MEMINFO, proc__self__cgroup="0::/\n", **group)
    assert available_bytes(tmp_path) == 16 * GIB


def test_of_this_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(memory.resource, "getrlimit", lambda which: (3 * GIB, 3 * GIB))
    monkeypatch.setattr(memory.resource, "getpagesize", lambda: 4096)
    assert available_bytes(system(tmp_path, proc__self__statm=f"{GIB // 4096} 5 6 7\n")) == 2 * GIB


def test_sizes_in_words():
    assert in_words(3.25 * GIB) == "3.2 GiB"
    assert in_words(5 << 20) == "5 MiB"


def test_images_that_do_not_fit_are_refused_before_they_are_read(scene_folder: Path, monkeypatch: pytest.MonkeyPatch):
    # 13 images of 48 x 48 pixels, 16 bytes each: 468 KiB.
    monkeypatch.setattr("sculpt_framework.posed_images.views.available_bytes", lambda: 300 << 10)
    with pytest.raises(DataError, match=r"13 images take .* --dataset\.downscale 2 or more \(now 1\)") as refused:
        BlenderConfig().build(str(scene_folder)).load()
    assert "\n" not in str(refused.value)
    assert len(BlenderConfig(downscale=2).build(str(scene_folder)).load().train) == 11


@pytest.fixture
def begun(scene: Scene) -> Session:
    """A run that knows where its surface is and has taken no step."""
    session = Session(scene, small_config())
    trainer = method_of(session).trainer
    trainer.seeds = discover(trainer.signed_distance, trainer.extractor.grid, coarse_level=0, lipschitz=1.5)
    return session


def checked(session: Session, left: int | None, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What a run is warned of before its only stage, on a machine with so much memory left."""
    monkeypatch.setattr(memory_check, "available_bytes", lambda: left)
    warned: list[str] = []
    scene, (stage,) = session.scene, method_of(session).config.trainer.stages
    memory_check.check_memory(method_of(session).trainer, scene.train, scene.box, stage, 0, warned.append)
    return warned


def test_a_step_that_may_not_fit_is_warned_of_and_one_that_cannot_is_not_begun(
    begun: Session, monkeypatch: pytest.MonkeyPatch
):
    scene = begun.scene
    images = [prepare_image(view, scene.box, 1.0, torch.device("cpu")) for view in scene.train]
    kept = sum(image.premultiplied.nbytes + (0 if image.alpha is None else image.alpha.nbytes) for image in images)
    largest = max(image.camera.width * image.camera.height for image in images)
    step = memory_check.step_bytes(memory_check.sizes(method_of(begun).trainer, largest))
    assert checked(begun, None, monkeypatch) == []
    assert checked(begun, kept + step, monkeypatch) == []
    (warning,) = checked(begun, kept + step - 1, monkeypatch)
    assert "lower --trainer.stages.0.level (now 0)" in warning
    assert "\n" not in warning
    with pytest.raises(TrainingFailed, match=r"for its images .* for a step .* are left: lower --trainer\.stages\.0\."):
        checked(begun, kept + step // 3, monkeypatch)


def test_cells_of_the_next_level_are_foreseen(begun: Session):
    trainer = method_of(begun).trainer
    trainer.extract()
    now = memory_check.sizes(trainer, 0)
    assert trainer.extraction is not None
    assert now.gaussians == len(trainer.extraction.surface.faces) * trainer.scene.binder.gaussians_per_face
    assert trainer.seeds is not None
    fine = trainer.extractor.grid.at_level(1)
    trainer.extractor.set_grid(fine)
    trainer.seeds = cells_at_level(trainer.seeds, 1)
    foreseen = memory_check.sizes(trainer, 0)
    trainer.extract()
    found = memory_check.sizes(trainer, 0)
    assert foreseen.cells == pytest.approx(found.cells, rel=0.25)
    assert foreseen.gaussians == pytest.approx(found.gaussians, rel=0.25)


def test_a_stage_that_does_not_fit_leaves_the_mesh_of_the_one_before(scene: Scene, monkeypatch: pytest.MonkeyPatch):
    asked: list[None] = []

    def left() -> int:
        asked.append(None)
        return GIB if len(asked) == 1 else 1 << 16

    monkeypatch.setattr(memory_check, "available_bytes", left)
    events: list[Event] = []
    session = Session(scene, small_config(stages=TWO_STAGES, steps=2), emit=events.append)
    result = session.run()
    assert [event.data["index"] for event in events if event.event == "stage"] == [0]
    assert session.failure is not None
    assert "stage 1 needs about" in session.failure
    assert "lower --trainer.stages.1." in session.failure
    assert certify(result.vertices, result.faces).watertight
