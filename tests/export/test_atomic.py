"""A file is whole or not there, also when the disk is full."""

import errno
import os
from pathlib import Path
from typing import BinaryIO

import pytest

from sculpt_framework.errors import OutputError
from sculpt_framework.export import atomic
from sculpt_framework.export.atomic import link_or_copy, write_atomically


def fill_the_disk(file: BinaryIO) -> None:
    file.write(b"half")
    raise OSError(errno.ENOSPC, "No space left on device")


def test_writes_bytes_and_callbacks(tmp_path: Path):
    write_atomically(tmp_path / "a", b"one")
    write_atomically(tmp_path / "b", lambda file: file.write(b"two") and None)
    assert (tmp_path / "a").read_bytes() == b"one"
    assert (tmp_path / "b").read_bytes() == b"two"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "b"]


def test_disk_full_keeps_the_earlier_file_and_leaves_nothing(tmp_path: Path):
    path = tmp_path / "mesh.ply"
    write_atomically(path, b"earlier")
    with pytest.raises(OutputError, match=r"mesh\.ply \(No space left on device\)"):
        write_atomically(path, fill_the_disk)
    assert path.read_bytes() == b"earlier"
    assert list(tmp_path.iterdir()) == [path]


def test_disk_full_at_the_flush(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Small writes fit into buffers; the system refuses them later."""

    def refuse(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    path = tmp_path / "mesh.ply"
    write_atomically(path, b"earlier")
    monkeypatch.setattr(atomic.os, "fsync", refuse)
    with pytest.raises(OutputError):
        write_atomically(path, b"later")
    assert path.read_bytes() == b"earlier"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_a_device_that_is_really_full(tmp_path: Path):
    (tmp_path / f".full.{atomic.os.getpid()}.partial").symlink_to("/dev/full")
    with pytest.raises(OutputError, match="No space left"):
        write_atomically(tmp_path / "full", b"x" * 100_000)
    assert list(tmp_path.iterdir()) == []


def test_no_such_folder_names_the_file(tmp_path: Path):
    with pytest.raises(OutputError, match=r"missing/mesh\.ply"):
        write_atomically(tmp_path / "missing" / "mesh.ply", b"")


def test_a_fault_of_ours_passes_through_and_cleans_up(tmp_path: Path):
    def fail(file: BinaryIO) -> None:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        write_atomically(tmp_path / "a", fail)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_without_a_name_is_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(OutputError, match=r"cannot write \. \(it is a folder\); give the name of a file in it"):
        write_atomically(Path("."), b"one")


def test_a_file_has_two_names_or_is_copied(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "a").write_bytes(b"one")
    assert link_or_copy(tmp_path / "a", tmp_path / "in" / "b").samefile(tmp_path / "a")

    def refuse(source: Path, target: Path) -> None:
        raise OSError(errno.EXDEV, "Invalid cross-device link")

    monkeypatch.setattr(os, "link", refuse)
    copied = link_or_copy(tmp_path / "a", tmp_path / "in" / "c")
    assert copied.read_bytes() == b"one"
    assert not copied.samefile(tmp_path / "a")
    assert sorted(path.name for path in (tmp_path / "in").iterdir()) == ["b", "c"]
