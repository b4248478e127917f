"""Faces that have not moved since their Gaussians last learned: for these an inner step has nothing new to say."""

from collections.abc import Mapping

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from sculpt_framework.geometry.keys import locate
from sculpt_framework.types import Surface


class StillFaces:
    """Remembers, by face key, where a face was when its Gaussians last took part in an inner loop."""

    def __init__(self, cells: float):
        """``cells``: a face is still while none of its corners has moved so far, in cells of the grid; 0: none is."""
        self._cells = cells
        self._keys: Int64[Tensor, " n"] = torch.empty(0, dtype=torch.int64)
        self._corners: Float[Tensor, "n 3 3"] = torch.empty(0, 3, 3)

    def moving(self, surface: Surface, cell: float) -> Bool[Tensor, " f"] | None:
        """Whether a face's Gaussians learn now: those of new ones do and of those that are not still. None: all.

        ``cell`` is the width of a cell, in the surface's units.
        """
        if self._cells == 0.0:
            return None
        corners = surface.vertices.detach()[surface.faces]
        if len(self._keys) == 0:
            self._keys, self._corners = surface.face_keys, corners
            return None
        row, known = locate(self._keys, surface.face_keys)
        before = self._corners[row]
        # The other way round a NaN would count as still.
        still = known & ((corners - before).square().sum(dim=2).amax(dim=1) < (self._cells * cell) ** 2)
        self._keys, self._corners = surface.face_keys, torch.where(still[:, None, None], before, corners)
        return ~still

    def forget(self) -> None:
        """Have the Gaussians of all faces learn next."""
        self._keys, self._corners = self._keys[:0], self._corners[:0]

    def state(self) -> dict[str, Tensor]:
        """For a checkpoint; empty where nothing is remembered."""
        return {"keys": self._keys, "corners": self._corners} if len(self._keys) > 0 else {}

    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Inverse of ``state``. Raises KeyError where one of two entries is missing."""
        if not state:
            self.forget()
            return
        self._keys, self._corners = state["keys"].clone(), state["corners"].clone()
