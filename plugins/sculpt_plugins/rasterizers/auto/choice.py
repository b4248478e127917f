"""Which backend suits a device."""

import logging
from typing import cast

import torch

from sculpt_framework import registry
from sculpt_framework.config import RasterizerConfig
from sculpt_framework.errors import ComponentImportError

_FASTEST = {"cpu": "numba", "cuda": "triton"}


def choose(device: torch.device) -> RasterizerConfig:
    """numba on the CPU, triton on CUDA; the reference where these cannot be had. Logs which, and why."""
    log = logging.getLogger("sculpt")
    name = _FASTEST.get(device.type)
    if name in registry.names("rasterizer"):
        try:
            config = cast(RasterizerConfig, registry.default("rasterizer", name))
        except ComponentImportError as error:
            log.warning("rasterizer %s left out: %s", name, error)
        else:
            log.info("rasterizer %s: the fastest on %s", name, device.type)
            return config
    log.info("rasterizer reference: nothing compiled for %s; expect it to be slow", device.type)
    return cast(RasterizerConfig, registry.default("rasterizer", "reference"))
