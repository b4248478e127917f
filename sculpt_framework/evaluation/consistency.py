"""How well a mesh explains posed photographs, without a reference: what it leaves unmatched between neighbouring views.

One image is brought into a neighbour's through the mesh. Were the mesh and the cameras true, the two would lie on
each other; the displacement that is left, found by dense optical flow, is the residual. Local mean and contrast are
taken out first, so that light which changes from image to image does not count. Only pixels with texture can be judged;
where there is none, ``plain_roughness`` says how uneven the mesh is.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from sculpt_framework.evaluation.image_pairs import choose_pairs, prepare
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.evaluation.residual import STRIDE, Residuals, SeenMesh, residuals
from sculpt_framework.evaluation.roughness import FACING, Unevenness, pixels_of, unevenness
from sculpt_framework.export.mesh_pixels import cosines, draw_mesh, visibility_slack
from sculpt_framework.threads import in_threads
from sculpt_framework.types import View


@dataclass(frozen=True, kw_only=True)
class Consistency:
    """A mesh against photographs. None where there is nothing to tell it from, never NaN."""

    residual_px: float | None
    """Median displacement left between two neighbouring views, in pixels of the views as they were given."""
    residual_p90_px: float | None
    """Its 90th percentile."""
    residual_depth: float | None
    """Median of how far the surface is off across itself, by the displacement along epipolar lines; scene units."""
    residual_depth_p90: float | None
    """Its 90th percentile, which errors in a part of the surface move too."""
    depth_error: float | None
    """Its 75th percentile, less what is left across epipolar lines, in quadrature: what cameras, noise and gloss leave
    of a true mesh too. Never below zero, scene units. Of all these the one that ranks meshes best."""
    judged: float
    """Share of the pixels of the masks, over all pairs, that have texture and that the mesh shows to both cameras."""
    pairs: int
    """Ordered pairs of views that were compared."""
    roughness: float | None
    """Mean angle between normals and their mean around, over what the cameras see, degrees."""
    plain_roughness: float | None
    """The same over plain places alone: where the views that see a place have no texture there."""
    plain: float | None
    """Share of the surface seen that is plain."""

    def values(self) -> Mapping[str, float | None]:
        return asdict(self)


CURVE_PAIRS, CURVE_PIXELS = 12, 150_000
"""Neighbouring views that a surface is judged by while it is trained, and pixels in each."""
EVALUATION_PIXELS = 1_000_000
"""Of a photograph that a finished mesh is held against: finer ones take their time, and surfaces are not that exact."""
DEPTH_ERROR_PERCENTILE = 75
"""Half-way between the median, which an error in a part leaves alone, and what outliers move."""
_NOTHING = Consistency(
    residual_px=None,
    residual_p90_px=None,
    residual_depth=None,
    residual_depth_p90=None,
    depth_error=None,
    judged=0.0,
    pairs=0,
    roughness=None,
    plain_roughness=None,
    plain=None,
)


class PosedImages:
    """Views made ready once, to measure any number of meshes against."""

    def __init__(
        self,
        views: Sequence[View],
        center: Float[np.ndarray, " 3"],
        *,
        pairs_at_most: int | None = None,
        pixels_at_most: int | None = None,
    ):
        """``center`` is about the middle of the object, world frame: angles between cameras are seen from there.

        Of more than ``pairs_at_most`` pairs some are compared, images of more than ``pixels_at_most`` pixels made
        smaller. What two meshes score can be compared where all this is the same.
        """
        pairs = choose_pairs([view.camera for view in views], np.asarray(center, np.float64), pairs_at_most)
        # Without pairs the images still say what of a mesh is seen.
        alone = range(0, len(views), max(1, len(views) // (pairs_at_most or len(views) or 1)))
        used = sorted({number for pair in pairs for number in pair} or alone)
        self.pairs = [(used.index(i), used.index(j)) for i, j in pairs]
        self.images = in_threads(lambda number: prepare(views[number], pixels_at_most), used)

    def measure(self, mesh: Mesh) -> Consistency:
        """``mesh`` is in world frame. Without area there is nothing to measure, without pairs no residual."""
        if not mesh.areas.sum() > 0 or not self.images:
            return replace(_NOTHING, pairs=len(self.pairs))
        seen = self.seen(mesh)
        return self.told(mesh, seen, self.residuals(mesh, seen))

    def told(self, mesh: Mesh, seen: Sequence[SeenMesh], found: Sequence[Residuals]) -> Consistency:
        """The figures of a mesh that has been looked at."""
        pixels = np.concatenate([np.empty(0), *(each.pixels for each in found)])
        depths = np.concatenate([np.empty(0), *(each.depths for each in found)])
        beside = np.concatenate([np.empty(0), *(each.beside for each in found)])
        whole = sum(int(self.images[first].mask[::STRIDE, ::STRIDE].sum()) for first, _ in self.pairs)
        uneven = unevenness(mesh)
        known, plain = _places(uneven, seen, visibility_slack(mesh.vertices))
        return Consistency(
            residual_px=float(np.median(pixels)) if len(pixels) else None,
            residual_p90_px=float(np.percentile(pixels, 90)) if len(pixels) else None,
            residual_depth=float(np.median(depths)) if len(depths) else None,
            residual_depth_p90=float(np.percentile(depths, 90)) if len(depths) else None,
            depth_error=_without(depths, beside) if len(depths) else None,
            judged=len(pixels) / whole if whole else 0.0,
            pairs=len(self.pairs),
            roughness=uneven.mean(known),
            plain_roughness=uneven.mean(plain),
            plain=float(plain.sum() / known.sum()) if known.any() else None,
        )

    def seen(self, mesh: Mesh) -> list[SeenMesh]:
        """The mesh, world frame, as the cameras of ``images`` see it."""
        return in_threads(
            lambda image: SeenMesh(image=image, pixels=draw_mesh(mesh.vertices, mesh.faces, image.camera)), self.images
        )

    def residuals(self, mesh: Mesh, seen: Sequence[SeenMesh]) -> list[Residuals]:
        """What is left in each pair, pixel by pixel."""
        slack = visibility_slack(mesh.vertices)
        return in_threads(lambda pair: residuals(mesh, seen[pair[0]], seen[pair[1]], slack), self.pairs)


def _without(depths: Float[np.ndarray, " m"], beside: Float[np.ndarray, " m"]) -> float:
    """A high percentile of what is left along epipolar lines, but for what the same one across them explains."""
    along, across = (float(np.percentile(each, DEPTH_ERROR_PERCENTILE)) for each in (depths, beside))
    return max(0.0, along**2 - across**2) ** 0.5


def _places(
    uneven: Unevenness, seen: Sequence[SeenMesh], slack: float
) -> tuple[Bool[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
    """Which of the points some image sees, and which of those are plain in most of the images that see them."""
    times, textured = np.zeros(len(uneven.points), int), np.zeros(len(uneven.points), int)
    for each in seen:
        image = each.image
        cosine = cosines(uneven.points, uneven.normals, image.camera, each.pixels.depth, slack)
        number = np.flatnonzero(cosine > FACING)
        column, row = pixels_of(uneven.points[number], image.camera)
        inside = image.mask[row, column]
        times[number[inside]] += 1
        textured[number[inside]] += image.textured[row, column][inside]
    return times > 0, (times > 0) & (2 * textured < times)
