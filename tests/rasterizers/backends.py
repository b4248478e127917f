"""The backends that the reference is the measure of."""

from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec

import pytest
import torch

from sculpt_framework.config import RasterizerConfig
from sculpt_framework.rasterizers import Rasterizer
from sculpt_plugins.rasterizers.gsplat.config import GsplatRasterizerConfig
from sculpt_plugins.rasterizers.numba.config import NumbaRasterizerConfig
from sculpt_plugins.rasterizers.triton.config import TritonRasterizerConfig
from tests.interpreting import spare_the_interpreter
from tests.rasterizers.splats import Splats, random_splats

CPU = torch.device("cpu")


@dataclass(frozen=True, kw_only=True)
class Backend:
    """A float32 rasteriser and how far it may be from the reference in float64."""

    config: RasterizerConfig
    device: torch.device
    interpreted: bool = False
    """Kernels run in Python: a tile takes a hundredth of a second, so that cases are as small as they can be."""
    exact: bool = True
    """It does the reference's arithmetic; otherwise it only comes close to it."""

    @cached_property
    def rasterizer(self) -> Rasterizer:
        return self.config.build(self.device)

    def cloud(
        self, count: int = 150, channels: int = 3, width: int = 45, height: int = 37, seed: int = 0, tiles: int = 2
    ) -> Splats:
        """Random splats, as many as asked for and on as large an image, or a fifth as many on so few tiles."""
        if self.interpreted:
            width, height = min(width, 14), min(height, 8 if tiles == 2 else 11)
            return random_splats(count=count // 5, channels=channels, width=width, height=height, seed=seed, focal=14.0)
        return random_splats(count=count, channels=channels, width=width, height=height, seed=seed)


def numba() -> Backend:
    return Backend(config=NumbaRasterizerConfig(), device=CPU)


def triton() -> Backend:
    """Compiled where there is a GPU, else interpreted."""
    pytest.importorskip("triton", reason="triton is not installed; it comes with the extra 'dev' on Linux")
    if torch.cuda.is_available():
        return Backend(config=TritonRasterizerConfig(), device=torch.device("cuda"))
    from triton.language import sum as a_function_of_tritons_own
    from triton.runtime.interpreter import InterpretedFunction

    assert isinstance(a_function_of_tritons_own, InterpretedFunction), "triton was imported before conftest.py was"
    spare_the_interpreter()
    return Backend(config=TritonRasterizerConfig(), device=CPU, interpreted=True)


def gsplat() -> Backend:
    return Backend(config=GsplatRasterizerConfig(), device=torch.device("cuda"), exact=False)


# Lanes that are masked out afterwards divide by zero; only numpy, in the interpreter's place, minds.
INTERPRETED = pytest.mark.filterwarnings("ignore::RuntimeWarning:triton.runtime.interpreter")
WITH_GSPLAT = pytest.mark.skipif(find_spec("gsplat") is None, reason="gsplat is not installed")
BACKENDS = [
    pytest.param(numba, id="numba"),
    pytest.param(triton, id="triton", marks=INTERPRETED),
    pytest.param(gsplat, id="gsplat", marks=[pytest.mark.gpu, WITH_GSPLAT]),
]
