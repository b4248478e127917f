"""From the parsed command to the start of a run: threads, device, paths, exit codes."""

import os
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import pytest

from sculpt_framework import registry
from sculpt_framework.cli import exit_codes
from sculpt_framework.cli.train import check_device, limit_threads, main, with_absolute_paths
from sculpt_framework.errors import DataError, DeviceError

VARIABLES = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")


@pytest.fixture
def clean_environment(monkeypatch: pytest.MonkeyPatch):
    for name in VARIABLES:
        monkeypatch.setenv(name, "")  # so that what the test changes is put back
        monkeypatch.delenv(name)


@pytest.mark.usefixtures("clean_environment")
class TestThreads:
    def test_asked_for(self):
        limit_threads(3)
        assert [os.environ[name] for name in VARIABLES] == ["3"] * 4

    def test_default_is_what_the_process_may_use(self):
        limit_threads(None)
        assert {os.environ[name] for name in VARIABLES} <= {str(count) for count in range(1, os.cpu_count() + 1)}

    def test_default_respects_the_environment(self, monkeypatch: pytest.MonkeyPatch):
        monkeypatch.setenv("OMP_NUM_THREADS", "1")
        monkeypatch.setenv("NUMBA_NUM_THREADS", "2")
        limit_threads(None)
        assert [os.environ[name] for name in VARIABLES] == ["1", "1", "1", "2"]


@pytest.mark.usefixtures("fake")
class TestRun:
    @pytest.fixture
    def calls(self, monkeypatch: pytest.MonkeyPatch) -> list[tuple[object, ...]]:
        """A trainer that notes what it is called with."""
        calls: list[tuple[object, ...]] = []
        module = ModuleType("sculpt_framework.engine.run")
        module.run = lambda config, *, resume, started: calls.append((config, resume, started))  # pyright: ignore
        monkeypatch.setitem(sys.modules, module.__name__, module)
        return calls

    @pytest.mark.usefixtures("clean_environment")
    def test_main_starts_the_run(self, calls: list, monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
        monkeypatch.chdir(tmp_path)
        (tmp_path / "jar").mkdir()
        (tmp_path / "gt.ply").touch()
        words = "fake --data jar --reference gt.ply --output out --threads 1"
        monkeypatch.setattr(sys, "argv", ["sculpt-train", *words.split()])
        main()
        ((config, resume, started),) = calls
        expected = replace(registry.load_method("fake")(), output=Path("out"), threads=1)
        assert config == replace(expected, data=str(tmp_path / "jar"), reference=tmp_path / "gt.ply")
        assert resume is None
        assert started > 0
        assert not (tmp_path / "out").exists()

    @pytest.mark.parametrize("data", ["demo", "demo:knot", "https://example.org/jar"])
    def test_names_are_no_paths(self, data: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
        monkeypatch.chdir(tmp_path)
        (tmp_path / "demo").mkdir()
        assert with_absolute_paths(replace(registry.load_method("fake")(), data=data)).data == data

    def test_paths_hold_from_anywhere(self, monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
        monkeypatch.chdir(tmp_path)
        config = replace(registry.load_method("fake")(), reference=Path("a.ply"), replay=Path("events.jsonl"))
        absolute = with_absolute_paths(config)
        assert (absolute.reference, absolute.replay) == (tmp_path / "a.ply", tmp_path / "events.jsonl")

    def test_cuda_must_be_there(self, monkeypatch: pytest.MonkeyPatch):
        import torch

        config = replace(registry.load_method("fake")(), device="cuda")
        monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
        with pytest.raises(DeviceError, match="--device cuda: torch finds no CUDA device here"):
            check_device(config)
        monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
        check_device(config)


class TestExitCodes:
    def code(self, error: BaseException | None) -> object:
        def command() -> None:
            if error is not None:
                raise error

        try:
            exit_codes.run(command)
        except SystemExit as end:
            return end.code
        return 0

    def test_done(self):
        assert self.code(None) == 0

    def test_a_user_s_error_is_one_line(self, capsys: pytest.CaptureFixture[str]):
        assert self.code(DataError("no such\nfolder")) == 2
        assert capsys.readouterr() == ("", "error: no such folder\n")

    def test_an_interrupt(self):
        assert self.code(KeyboardInterrupt()) == 130

    def test_a_fault_of_ours_keeps_its_traceback(self):
        with pytest.raises(ZeroDivisionError):
            self.code(ZeroDivisionError())
