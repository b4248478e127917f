"""A second device that computes on the CPU, but keeps its tensors apart as an accelerator does.

Its tensors hold one of the CPU each. An operation on tensors of both devices raises, except where CUDA takes numbers,
indices and copies from the CPU too. Kernels compiled for the CPU refuse its tensors, or are passed over for them.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_flatten, tree_map

DEVICE = torch.device("lazy", 0)
"""A name that torch knows and for which it has no code of its own here."""
_CROSSING = ("aten::copy_", "aten::_to_copy", "aten::index", "aten::index_put", "aten::index_put_")


class Away(Tensor):
    """A tensor of the second device."""

    held: Tensor

    @staticmethod
    def __new__(cls, held: Tensor) -> "Away":
        shape = {"strides": held.stride(), "storage_offset": held.storage_offset()}
        return Tensor._make_wrapper_subclass(cls, held.shape, **shape, dtype=held.dtype, device=DEVICE)  # pyright: ignore

    def __init__(self, held: Tensor):
        self.held = held

    def __repr__(self, *, tensor_contents: object = None) -> str:
        return f"Away({self.held!r})"

    def tolist(self) -> Any:
        return self.held.tolist()

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Sequence[Any] = (), kwargs: Any = None) -> Any:
        return _carried_out(func, args, kwargs or {})


class _MadeThere(TorchDispatchMode):
    """Tensors that are asked for on the second device are made there."""

    def __torch_dispatch__(self, func: Any, types: Any, args: Sequence[Any] = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        return _carried_out(func, args, kwargs) if _is_away(kwargs.get("device")) else func(*args, **kwargs)


class _MadeOfNumbers(TorchFunctionMode):
    """The same for tensors made of Python's numbers, which torch does not ask a dispatch mode about."""

    def __torch_function__(self, func: Any, types: Any, args: Sequence[Any] = (), kwargs: Any = None) -> Any:
        kwargs = dict(kwargs or {})
        if func in (torch.tensor, torch.as_tensor) and _is_away(kwargs.get("device")):
            del kwargs["device"]
            return func(*args, **kwargs).to(DEVICE)
        if func is Tensor.new_tensor and isinstance(args[0], Away):
            return torch.tensor(args[1], dtype=kwargs.get("dtype", args[0].dtype)).to(DEVICE)
        if func in (Tensor.__getitem__, Tensor.__setitem__) and isinstance(args[0], Away):
            args = (args[0], _indices(args[1]), *args[2:])
        return func(*args, **kwargs)


def _indices(places: Any) -> Any:
    """Lists as tensors, which torch else makes beyond the reach of modes."""
    if isinstance(places, tuple):
        return tuple(_indices(each) for each in places)
    return torch.tensor(places) if isinstance(places, list) else places


@contextmanager
def second_device() -> Iterator[torch.device]:
    """The device; modules can be moved to it within the context."""
    swapped = torch.__future__.get_swap_module_params_on_conversion()
    torch.__future__.set_swap_module_params_on_conversion(True)
    try:
        with _MadeOfNumbers(), _MadeThere():
            yield DEVICE
    finally:
        torch.__future__.set_swap_module_params_on_conversion(swapped)


def _is_away(device: object) -> bool:
    return device is not None and torch.device(device).type == DEVICE.type  # pyright: ignore


def _carried_out(func: Any, args: Sequence[Any], kwargs: Mapping[str, Any]) -> Any:
    tensors = [each for each in tree_flatten((args, kwargs))[0] if isinstance(each, Tensor)]
    there = [each for each in tensors if isinstance(each, Away)]
    here = [tuple(each.shape) for each in tensors if not isinstance(each, Away) and each.dim() > 0]
    name = func._schema.name
    if there and here and name not in _CROSSING:
        raise RuntimeError(f"{name} of tensors on two devices; those on the CPU have shapes {here}")
    stays = _is_away(kwargs["device"]) if kwargs.get("device") is not None else bool(there)
    held_args, held_kwargs = tree_map(lambda each: each.held if isinstance(each, Away) else each, (args, dict(kwargs)))
    if _is_away(held_kwargs.get("device")):
        held_kwargs["device"] = torch.device("cpu")
    out = func(*held_args, **held_kwargs)
    if not stays:
        return out
    # What was changed in place is what it was.
    same = {id(each.held): each for each in there}
    return tree_map(lambda each: same[id(each)] if id(each) in same else _away(each), out)


def _away(value: Any) -> Any:
    return Away(value) if isinstance(value, Tensor) else value
