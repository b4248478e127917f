"""Runs that fail, on the way or at their end, leave what they have, and one line that says so."""

import errno
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from small_runs import fail_for, files_of, small_config, train

from sculpt_framework.config import MethodConfig
from sculpt_framework.engine.run import run, run_status
from sculpt_framework.errors import OutputError, TrainingFailed
from sculpt_framework.evaluation.certificate import certify
from sculpt_framework.evaluation.mesh import load_mesh
from sculpt_framework.sculpting.trainer import BiLevelTrainer
from sculpt_framework.types import Scene


@dataclass
class Poison:
    """Makes the field's parameters NaN before chosen outer steps."""

    when: Sequence[int]
    seen: int = 0

    def install(self, monkeypatch: pytest.MonkeyPatch) -> None:
        original = BiLevelTrainer.update

        def update(trainer: BiLevelTrainer, *arguments: object) -> object:
            self.seen += 1
            report = original(trainer, *arguments)  # pyright: ignore
            if self.seen in self.when:
                with torch.no_grad():
                    for parameter in trainer.field.parameters():
                        parameter.fill_(torch.nan)
            return report

        monkeypatch.setattr(BiLevelTrainer, "update", update)


def test_one_nan_is_recovered_from(scene: Scene, monkeypatch: pytest.MonkeyPatch):
    Poison(when=(3,)).install(monkeypatch)
    outcome = train(small_config(), scene)
    (recovered,) = outcome.of("recovered")
    assert recovered.data["rate_scale"] == 0.5
    assert "not finite" in recovered.data["error"]
    assert certify(outcome.result.vertices, outcome.result.faces).watertight


def test_the_last_step_may_be_the_one_that_fails(scene: Scene, monkeypatch: pytest.MonkeyPatch):
    Poison(when=(8,)).install(monkeypatch)
    outcome = train(small_config(steps=8), scene)
    assert len(outcome.of("recovered")) == 1
    assert np.isfinite(outcome.result.vertices).all()


@pytest.mark.slow
def test_repeated_failure_ends_with_the_best_mesh_so_far(config: MethodConfig, monkeypatch: pytest.MonkeyPatch):
    Poison(when=range(2, 100)).install(monkeypatch)
    with pytest.raises(TrainingFailed, match=r"cannot go on after .* best mesh until then is .*mesh\.ply"):
        run(replace(config, steps=30), resume=None, started=0.0)
    assert config.output is not None
    assert run_status(config.output) == "failed"
    mesh = load_mesh(config.output / "mesh.ply")
    assert certify(mesh.vertices, mesh.faces).watertight


def test_a_failure_before_any_surface_has_nothing_to_save(config: MethodConfig, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr("sculpt_framework.sculpting.initial_fit.fit_field", poisoned_fit)
    with pytest.raises(TrainingFailed, match="after 0 outer steps"):
        run(config, resume=None, started=0.0)
    assert config.output is not None
    assert not (config.output / "mesh.ply").exists()


def poisoned_fit(field: torch.nn.Module, *arguments: object, **options: object) -> float:
    with torch.no_grad():
        for parameter in field.parameters():
            parameter.fill_(torch.nan)
    return 0.0


@pytest.mark.slow
def test_a_disk_full_at_the_end_loses_nothing(config: MethodConfig, monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    free = fail_for(monkeypatch, "mesh.ply", OSError(errno.ENOSPC, "No space left on device"))
    with pytest.raises(OutputError, match=r"mesh\.ply \(No space left on device\)"):
        run(config, resume=None, started=0.0)
    assert run_status(tmp_path / "run") is None
    free()
    run(config, resume=tmp_path / "run", started=0.0)
    assert run_status(tmp_path / "run") == "finished"
    run(replace(config, output=tmp_path / "other"), resume=None, started=0.0)
    assert (tmp_path / "run" / "mesh.ply").read_bytes() == (tmp_path / "other" / "mesh.ply").read_bytes()


@pytest.mark.slow
def test_a_report_that_fails_is_a_warning(config: MethodConfig, monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    fail_for(monkeypatch, "report.html", OSError(errno.EROFS, "Read-only file system"))
    run(config, resume=None, started=0.0)
    assert run_status(tmp_path / "run") == "finished"
    last = json.loads((tmp_path / "run" / "events.jsonl").read_text(encoding="utf-8").splitlines()[-1])
    assert last["event"] == "warning"
    assert "Read-only file system" in last["data"]["message"]


@pytest.mark.slow
def test_a_finished_run_without_its_report_gets_it_when_resumed(
    config: MethodConfig, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    """As a run that was killed while it wrote its report."""
    folder = tmp_path / "run"
    run(config, resume=None, started=0.0)
    before = files_of(folder)
    (folder / "report.html").rename(folder / ".report.html.0.partial")
    run(config, resume=folder, started=0.0)
    assert "has finished already" in capsys.readouterr().out
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "reference image (" in page
    assert "rendering" in page
    assert files_of(folder) == before | {"report.html": page.encode()}


@pytest.mark.slow
def test_a_finished_run_whose_data_are_gone_is_still_finished(
    config: MethodConfig, tmp_path: Path, capsys: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture
):
    run(config, resume=None, started=0.0)
    text = (tmp_path / "run" / "config.json").read_text(encoding="utf-8")
    (tmp_path / "run" / "config.json").write_text(
        text.replace(str(config.data), str(tmp_path / "gone")), encoding="utf-8"
    )
    (tmp_path / "run" / "report.html").unlink()
    run(config, resume=tmp_path / "run", started=0.0)
    assert "has finished already" in capsys.readouterr().out
    assert "no report" in caplog.text
    assert not (tmp_path / "run" / "report.html").exists()
