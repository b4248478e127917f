import logging
import time
from pathlib import Path

import numba
import pytest
import torch

from sculpt_framework.cpu_kernels import CompileSeconds, kernel_cache, share_threads


@pytest.fixture
def source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    file = tmp_path / "kernels.py"
    file.write_text("x = 1\n", encoding="utf-8")
    return file


def _folder(source: Path) -> str:
    with kernel_cache("tests", source):
        return numba.config.CACHE_DIR


def test_every_state_of_the_source_has_its_folder(source: Path):
    first = _folder(source)
    assert first.startswith(str(source.parent / "cache" / "gaussian-sculpting"))
    assert _folder(source) == first
    source.write_text("x = 2\n", encoding="utf-8")
    assert _folder(source) != first
    assert numba.config.CACHE_DIR == ""


def test_what_kernels_share_counts_as_well(source: Path):
    shared, folders = source.with_name("shared.py"), []
    for text in ("y = 1\n", "y = 2\n"):
        shared.write_text(text, encoding="utf-8")
        with kernel_cache("tests", source, shared):
            folders.append(numba.config.CACHE_DIR)
    assert len({*folders, _folder(source)}) == 3


def test_a_folder_the_user_chose_is_kept(source: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(numba.config, "CACHE_DIR", "/chosen")
    assert _folder(source) == "/chosen"


def test_says_once_that_it_compiles(source: Path, caplog: pytest.LogCaptureFixture):
    with caplog.at_level(logging.INFO, logger="sculpt"):
        folder = _folder(source)
        assert caplog.text.count("compiling") == 1
        Path(folder).mkdir(parents=True)
        _folder(source)
    assert caplog.text.count("compiling") == 1


def test_a_home_that_cannot_be_written_is_replaced(source: Path, monkeypatch: pytest.MonkeyPatch):
    blocked = source.parent / "file"
    blocked.write_text("", encoding="utf-8")
    monkeypatch.setenv("XDG_CACHE_HOME", str(blocked))
    assert not _folder(source).startswith(str(blocked))


def test_numba_follows_torch():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    assert share_threads() == 1
    assert numba.get_num_threads() == 1
    assert torch.get_num_threads() == 1
    torch.set_num_threads(threads)


def test_compile_seconds_are_those_of_compiling_alone():
    @numba.njit
    def twice(x: float) -> float:
        return 2 * x

    with CompileSeconds() as seconds:
        assert seconds() == 0
        assert twice(1.0) == 2
        compiled = seconds()
        assert compiled > 0.01
        time.sleep(0.05)
        assert twice(3.0) == 6
        assert seconds() == compiled
    assert twice(1) == 2
    assert seconds() == compiled, "what is compiled afterwards is no longer counted"
