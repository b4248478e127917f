"""Without a GPU, Triton kernels run in its interpreter, which has to be said before triton is imported."""

import os

import pytest

# Before torch: it sets how OpenMP waits.
import sculpt_framework  # noqa: F401  # isort: skip
import torch

from tests.rasterizers.backends import BACKENDS, Backend

if not torch.cuda.is_available():
    os.environ.setdefault("TRITON_INTERPRET", "1")


@pytest.fixture(params=BACKENDS)
def backend(request: pytest.FixtureRequest) -> Backend:
    """Every backend but the reference, each with the device it can be tried on."""
    return request.param()
