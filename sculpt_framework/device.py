"""Where tensors live."""

import torch

from sculpt_framework.errors import DeviceError


def pick_device(wanted: str) -> torch.device:
    """Raises DeviceError if CUDA is asked for and absent."""
    available = torch.cuda.is_available()
    if wanted == "cuda" and not available:
        raise DeviceError("--device cuda was asked for, but torch sees no CUDA device here; use --device cpu or auto")
    return torch.device("cuda" if available and wanted != "cpu" else "cpu")
