"""How thick a solid is below each of its faces, where it is thin."""

from dataclasses import dataclass

import torch
from jaxtyping import Bool, Float, Int64
from torch import Tensor

from sculpt_plugins.binders.face_barycentric.limits import OPPOSITE, PLACE_BITS, UNDECIDED


def thicknesses(centroids: Float[Tensor, "3 f"], normals: Float[Tensor, "3 f"], column: float) -> Float[Tensor, " f"]:
    """Distance from the plane of each face down to the face on the other side, infinite where none was found.

    Faces are put in columns of the width ``column`` along the axis that their normal is nearest to, those that look
    along it apart from those that look back. Each face asks the two of the others that are next to it in its column. A
    column should hold a few faces of each side of a sheet: a face without a partner in it counts as thick.
    """
    longest, second = normals.abs().argsort(dim=0, descending=True)[:2]
    low = centroids.amin(dim=1, keepdim=True)
    cells = ((centroids - low) / column).long()
    places = ((centroids - low) * ((2**PLACE_BITS - 1) / (centroids - low).amax().clamp(min=1e-20))).long()
    count = int(cells.amax()) + 1
    names, face = torch.sort(_names(cells, places, normals > 0.0, longest, count))
    sides = _Sides(names=names, face=face, centroids=centroids, normals=normals)
    nearest = sides.gaps(_names(cells, places, normals <= 0.0, longest, count), centroids, normals)
    most, more = normals.abs().gather(0, torch.stack([longest, second]))
    undecided = (more > UNDECIDED * most).nonzero()[:, 0]
    places, cells = places.index_select(1, undecided), cells.index_select(1, undecided)
    centroids, normals = centroids.index_select(1, undecided), normals.index_select(1, undecided)
    wanted = _names(cells, places, normals <= 0.0, second[undecided], count)
    nearest[undecided] = torch.minimum(nearest[undecided], sides.gaps(wanted, centroids, normals))
    return nearest


@dataclass(frozen=True, kw_only=True, eq=False)
class _Sides:
    """All faces, by their ``_names``."""

    names: Int64[Tensor, " f"]
    face: Int64[Tensor, " f"]
    centroids: Float[Tensor, "3 f"]
    normals: Float[Tensor, "3 f"]

    def gaps(
        self, wanted: Int64[Tensor, " n"], centroids: Float[Tensor, "3 n"], normals: Float[Tensor, "3 n"]
    ) -> Float[Tensor, " n"]:
        """The lesser distance down to those of the two faces next to ``wanted`` that are another side of a sheet."""
        nearest = torch.full_like(centroids[0], torch.inf)
        slot = torch.searchsorted(self.names, wanted)
        for candidate in (slot - 1, slot):
            candidate = candidate.clamp(0, len(self.names) - 1)
            other = self.face.index_select(0, candidate)
            gap = ((centroids - self.centroids.index_select(1, other)) * normals).sum(dim=0)
            cosine = (normals * self.normals.index_select(1, other)).sum(dim=0)
            same_column = self.names.index_select(0, candidate) >> PLACE_BITS == wanted >> PLACE_BITS
            paired = same_column & (gap > 0.0) & (cosine < OPPOSITE)
            nearest = torch.minimum(nearest, torch.where(paired, gap, torch.inf))
        return nearest


def _names(
    cells: Int64[Tensor, "3 n"],
    places: Int64[Tensor, "3 n"],
    ahead: Bool[Tensor, "3 n"],
    axis: Int64[Tensor, " n"],
    count: int,
) -> Int64[Tensor, " n"]:
    """Numbers that sort by axis, direction, column and place along it."""
    axis = axis[None]
    first, second = cells.gather(0, (axis + 1) % 3), cells.gather(0, (axis + 2) % 3)
    column = ((axis * 2 + ahead.gather(0, axis)) * count + first) * count + second
    return (column << PLACE_BITS | places.gather(0, axis))[0]
