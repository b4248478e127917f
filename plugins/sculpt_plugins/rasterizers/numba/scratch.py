"""Working memory that is used again: pages fresh from the system cost more than what is written to them."""

import numpy as np

_CACHE_LINE = 64


class Scratch:
    """Named arrays that grow and are handed out again. Their contents are whatever was there before."""

    def __init__(self):
        self._bytes: dict[str, np.ndarray] = {}

    def take(self, name: str, shape: tuple[int, ...], kind: type[np.generic]) -> np.ndarray:
        """An array that starts at a cache line, valid until the same name is taken again."""
        size = int(np.prod(shape)) * np.dtype(kind).itemsize
        held = self._bytes.get(name)
        if held is None or held.size < size + _CACHE_LINE:
            # A quarter more: the number of Gaussians changes a little from step to step.
            held = self._bytes[name] = np.empty(size + size // 4 + _CACHE_LINE, np.uint8)
        start = -held.ctypes.data % _CACHE_LINE
        return held[start : start + size].view(kind).reshape(shape)


class Lease:
    """A scratch of its own until the lease is dropped; then another rendering may have it."""

    def __init__(self, free: list[Scratch]):
        self._free = free
        self.scratch = free.pop() if free else Scratch()

    def __del__(self):
        self._free.append(self.scratch)
