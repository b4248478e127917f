"""Checkpoints are read as they were written, and one that cannot be is told of in a line."""

import errno
from pathlib import Path

import pytest
import torch
from safetensors import safe_open
from safetensors.torch import save_file
from small_runs import fail_for

from sculpt_framework.engine.checkpoint import Progress, read_checkpoint, write_checkpoint
from sculpt_framework.errors import CheckpointError, OutputError


@pytest.fixture
def checkpoint(tmp_path: Path) -> Path:
    progress = Progress(
        outer=3, progress=0.5, trained_seconds=1.5, best_psnr=None, rate_scale=1.0, recoveries=0, milestones=[]
    )
    write_checkpoint(tmp_path, {"a": torch.arange(5)}, progress)
    return tmp_path / "latest.safetensors"


def test_checkpoints_go_round(checkpoint: Path):
    state, progress = read_checkpoint(checkpoint.parent)
    assert torch.equal(state["a"], torch.arange(5))
    assert progress.outer == 3


def test_another_version_is_one_line(checkpoint: Path):
    with safe_open(checkpoint, framework="pt") as file:
        header = {**file.metadata(), "format": "99"}
    save_file({"a": torch.arange(5)}, checkpoint, metadata=header)
    with pytest.raises(CheckpointError, match="checkpoint format 99, this version reads 1"):
        read_checkpoint(checkpoint.parent)


@pytest.mark.parametrize("keep", [0, 4, 60])
def test_a_cut_checkpoint_is_one_line(checkpoint: Path, keep: int):
    checkpoint.write_bytes(checkpoint.read_bytes()[:keep])
    with pytest.raises(CheckpointError, match="is damaged and cannot be read"):
        read_checkpoint(checkpoint.parent)


def test_no_checkpoint_and_no_progress(checkpoint: Path):
    save_file({"a": torch.arange(5)}, checkpoint, metadata={"format": "1", "progress": "{}"})
    with pytest.raises(CheckpointError, match="no valid progress"):
        read_checkpoint(checkpoint.parent)
    checkpoint.unlink()
    with pytest.raises(CheckpointError, match="no checkpoint at"):
        read_checkpoint(checkpoint.parent)


def test_a_full_disk_keeps_the_old_checkpoint(checkpoint: Path, monkeypatch: pytest.MonkeyPatch):
    before = checkpoint.read_bytes()
    fail_for(monkeypatch, checkpoint.name, OSError(errno.ENOSPC, "No space left on device"))
    _, progress = read_checkpoint(checkpoint.parent)
    with pytest.raises(OutputError, match="No space left"):
        write_checkpoint(checkpoint.parent, {"a": torch.zeros(2)}, progress)
    assert checkpoint.read_bytes() == before
    assert list(checkpoint.parent.iterdir()) == [checkpoint]
