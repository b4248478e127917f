"""Which backend suits a device."""

import logging

import torch

from sculpt_framework import registry
from sculpt_framework.config import RasterizerConfig
from sculpt_framework.errors import ComponentImportError, DeviceError
from sculpt_framework.rasterizers import Rasterizer

_FASTEST_FIRST = {"cpu": ("numba",), "cuda": ("triton", "gsplat")}


def choose(device: torch.device) -> Rasterizer:
    """The fastest backend that runs on the device; the reference where none does. Logs which, and why."""
    log = logging.getLogger("sculpt")
    for name in _FASTEST_FIRST.get(device.type, ()):
        try:
            rasterizer = _config(name).build(device)
        except (ComponentImportError, DeviceError) as error:
            log.warning("rasterizer %s left out: %s", name, error)
        else:
            log.info("rasterizer %s: the fastest that runs on %s", name, device.type)
            return rasterizer
    log.warning("rasterizer reference: nothing compiled for %s; expect it to be slow", device.type)
    return _config("reference").build(device)


def _config(name: str) -> RasterizerConfig:
    config = registry.default("rasterizer", name)
    assert isinstance(config, RasterizerConfig)  # noqa: S101 - what the registry promises for the slot
    return config
