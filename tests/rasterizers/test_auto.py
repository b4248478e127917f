"""Which backend is taken, and that the log says so."""

import logging
from dataclasses import dataclass

import pytest
import torch

from sculpt_framework import registry
from sculpt_framework.config import RasterizerConfig
from sculpt_framework.errors import ComponentImportError, DeviceError, SculptError
from sculpt_framework.rasterizers import Rasterizer
from sculpt_plugins.rasterizers.auto.choice import choose
from sculpt_plugins.rasterizers.auto.config import AutoRasterizerConfig
from sculpt_plugins.rasterizers.numba.rasterizer import NumbaRasterizer
from sculpt_plugins.rasterizers.reference.config import ReferenceRasterizerConfig
from sculpt_plugins.rasterizers.reference.rasterizer import ReferenceRasterizer
from tests.rasterizers.backends import CPU

CUDA = torch.device("cuda")


@dataclass(frozen=True, kw_only=True)
class Pretended(RasterizerConfig):
    """A backend that is there, or fails as a real one does."""

    fails: SculptError | None = None

    def build(self, device: torch.device) -> Rasterizer:
        if self.fails is not None:
            raise self.fails
        return ReferenceRasterizerConfig(pairs_at_once=1).build(device)


def test_without_a_gpu(caplog: pytest.LogCaptureFixture):
    with caplog.at_level(logging.INFO, logger="sculpt"):
        assert isinstance(AutoRasterizerConfig().build(CPU), NumbaRasterizer)
        assert isinstance(AutoRasterizerConfig().build(torch.device("meta")), ReferenceRasterizer)
    assert "rasterizer numba: the fastest that runs on cpu" in caplog.text
    assert "rasterizer reference: nothing compiled for meta; expect it to be slow" in caplog.text


@pytest.mark.parametrize("taken", ["triton", "gsplat", "reference"])
def test_on_cuda_the_first_that_runs(taken: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture):
    asked: list[str] = []
    problems = {"triton": ComponentImportError("no triton here"), "gsplat": DeviceError("no compiler here")}

    def default(slot: str, name: str) -> RasterizerConfig:
        asked.append(name)
        return Pretended(fails=None if name == taken else problems[name])

    monkeypatch.setattr(registry, "default", default)
    with caplog.at_level(logging.INFO, logger="sculpt"):
        choose(CUDA)
    order = ["triton", "gsplat", "reference"]
    assert asked == order[: order.index(taken) + 1]
    assert ("rasterizer triton left out: no triton here" in caplog.text) == (taken != "triton")
    assert ("rasterizer gsplat left out: no compiler here" in caplog.text) == (taken == "reference")
    assert f"rasterizer {taken}: " in caplog.text


def test_faults_of_ours_are_not_hidden(monkeypatch: pytest.MonkeyPatch):
    @dataclass(frozen=True, kw_only=True)
    class Faulty(RasterizerConfig):
        def build(self, device: torch.device) -> Rasterizer:
            raise KeyError("ours")

    monkeypatch.setattr(registry, "default", lambda slot, name: Faulty())
    with pytest.raises(KeyError):
        choose(CUDA)
