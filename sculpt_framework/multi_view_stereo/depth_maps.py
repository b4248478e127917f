"""Depth, normal and confidence for every pixel of every view, by PatchMatch.

Planes are guessed at a pixel, handed on to its neighbours, and judged by the normalised correlation of their windows in
the views that see them best (Bleyer, Rhemann and Rother 2011; Zheng and others 2014); from coarse images to fine ones;
after the first images, by how well they agree with the depths of the other views as well (Xu and Tao 2019). Views take
turns in rounds: each round compares with the depths that the round before left, so the result does not depend on the
order, or on the number of threads.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Lock

import numpy as np
from jaxtyping import Bool, Float32, Int64

from sculpt_framework.cpu_kernels import kernel_cache
from sculpt_framework.multi_view_stereo.stereo_views import StereoViews, stereo_views
from sculpt_framework.shape_from_images.missing import ray_kernels
from sculpt_framework.shape_from_images.volume import Volume
from sculpt_framework.threads import in_threads
from sculpt_framework.types import View

with kernel_cache("stereo", Path(__file__).with_name("patch_match_kernels.py")):
    from sculpt_framework.multi_view_stereo import patch_match_kernels as kernels

_COARSEST = 64
"""Pixels across the object in the coarsest images, at most."""
_STRIDE = 1
"""Pixels between the samples of a window, of which there are five by five."""
_COUNTED, _JUDGES = 3, 4
"""Views whose differences count, of those that see a plane best and judge the next ones."""
_BACK_PIXELS, _BACK_SHARE, _ALIKE = 1.5, 0.01, 0.8
"""Depths of two views are the same if a point comes back within so many pixels, its depth within such a share, and the
cosine between the normals is not smaller."""
_FARTHEST = 1e3
"""Object units: as good as infinitely far."""
_SURE = 4
"""Views that agree after which more of them do not make a depth surer."""
_WORST = 0.6
"""1 - NCC, and what the views disagree by, above which no depth is believed."""

Bounds = tuple[Float32[np.ndarray, "v h w"], Float32[np.ndarray, "v h w"]]
"""Nearest and farthest depth of each pixel of each view; 0 where there is nothing."""


@dataclass(frozen=True, kw_only=True)
class StereoOptions:
    """What is spent on depth maps."""

    pixels: int
    """Along the longest side of the object, in the finest images."""
    neighbours: int
    """Views each view is compared with."""
    agreeing: int
    """Views that must have the same depth for it to be believed."""
    beyond: bool = False
    """Whether what stands behind the solid part has depths, too, as far as there is anything."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DepthMaps:
    """What is known of the surface at the pixels of ``views``."""

    views: StereoViews
    depths: Float32[np.ndarray, "v h w"]
    """Along the camera's axis, in object units; 0 where nothing is known."""
    normals: Float32[np.ndarray, "v h w 3"]
    """Unit normals in the camera's frame, which face the camera; meaningless where nothing is known."""
    confidence: Float32[np.ndarray, "v h w"]
    """From 0, where nothing is known, to 1: how many views agree, and how well windows correlate."""

    @property
    def known(self) -> float:
        """Share of the object's pixels that have a depth."""
        return float((self.depths > 0).sum() / max(1, self.views.inside.sum()))

    @property
    def mean_confidence(self) -> float:
        """Over the pixels that have a depth; 0 if none has."""
        return float(self.confidence.sum() / max(1, (self.depths > 0).sum()))


@dataclass(frozen=True, kw_only=True, eq=False)
class _Planes:
    """A hypothesis a pixel, in all views, changed in place."""

    depths: Float32[np.ndarray, "v h w"]
    normals: Float32[np.ndarray, "v h w 3"]
    costs: Float32[np.ndarray, "v h w"]
    nearest: Float32[np.ndarray, "v h w"]
    farthest: Float32[np.ndarray, "v h w"]
    """Between which the object is; 0 where it is not."""


@dataclass(frozen=True, kw_only=True)
class _Round:
    """How all views are swept over once."""

    geometric: bool
    """Whether the other views' depths are compared with."""
    sweeps: int
    span: float
    """Pixels, in another view, that the first guess near a plane is away from it at most."""
    tries: int
    fresh: bool
    """Whether planes at random are tried, too."""


_FIRST = (
    _Round(geometric=False, sweeps=5, span=8.0, tries=2, fresh=True),
    _Round(geometric=True, sweeps=2, span=2.0, tries=3, fresh=True),
    _Round(geometric=True, sweeps=1, span=1.0, tries=2, fresh=False),
)
"""In the coarsest images."""
_FINER = (
    # What all views have wrong together in coarse images they would go on agreeing on.
    _Round(geometric=False, sweeps=2, span=2.0, tries=2, fresh=False),
    _Round(geometric=True, sweeps=1, span=1.0, tries=2, fresh=False),
)
"""In each of the others."""


def find_depths(
    views: Sequence[View],
    solid: Volume,
    options: StereoOptions,
    tell: Callable[[float], None] = lambda share: None,
) -> DepthMaps:
    """Depth maps of all views, their cameras in the object frame, within the ``solid`` part (value below 0).

    ``tell`` hears what share of the work is done. A view without neighbours at a useful angle has no depths. Nothing is
    known in plain places, saturated ones among them, nor where fewer than ``options.agreeing`` other views say the same
    or more of them see through.
    """
    # No finer than the images are.
    native = [2 * max(v.camera.fx, v.camera.fy) / max(float(v.camera.position.norm()), 1e-9) for v in views]
    sides = [min(options.pixels, max(1, round(float(np.median(native)))) if native else 1)]
    while sides[-1] > _COARSEST:
        sides.append(sides[-1] // 2)
    work = sum(side**2 * sum(r.sweeps for r in (_FIRST if side == sides[-1] else _FINER)) for side in sides)
    done = 0.0
    stack, planes = stereo_views(views, sides[-1] / 2), None
    for side in reversed(sides):
        if planes is None:
            planes, rounds = _blank(stack, _bounds(stack, solid, options.beyond)), _FIRST
        else:
            finer = stereo_views(views, side / 2)
            planes = _at_finer(planes, stack, finer, _bounds(finer, solid, options.beyond))
            stack, rounds = finer, _FINER
        others = stack.neighbours(options.neighbours)
        for number, each in enumerate(rounds):
            share = side**2 * each.sweeps / work / max(1, len(stack))
            _sweep(stack, planes, others, each, seed=side + number, tell=_Adder(tell, done, share))
            done += share * len(stack)
    assert planes is not None  # noqa: S101
    return _believed(stack, planes, others, options)


class _Adder:
    """Tells a sum of equal shares."""

    def __init__(self, tell: Callable[[float], None], start: float, share: float):
        self._tell, self._sum, self._share = tell, start, share
        # Views are done in threads.
        self._lock = Lock()

    def __call__(self) -> None:
        with self._lock:
            self._sum += self._share
            self._tell(min(1.0, self._sum))


def depth_bounds(stack: StereoViews, full: Bool[np.ndarray, "x y z"], volume: Volume) -> Bounds:
    """Nearest and farthest depth at which a pixel's ray meets what is ``full`` of the volume's cells, a cell more on
    both sides; 0 where it does not, or where the view shows nothing of the object."""
    shape = stack.luminance.shape
    nearest, farthest = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    origin, cell = np.array(volume.origin, np.float32), np.float32(volume.cell)

    def bound(i: int) -> None:
        ray_kernels.bound_depths(
            stack.inside[i], stack.poses[i], stack.lenses[i], stack.positions[i], full, origin, cell,
            nearest[i], farthest[i],
        )  # fmt: skip

    in_threads(bound, range(len(stack)))
    return nearest, farthest


def _bounds(stack: StereoViews, solid: Volume, beyond: bool) -> Bounds:
    """Between which depths there is something solid along each ray, and whether there may be something behind it."""
    nearest, farthest = depth_bounds(stack, solid.values < solid.cell, solid)
    if beyond:
        farthest[farthest > 0] = _FARTHEST
    return nearest, farthest


def _blank(stack: StereoViews, bounds: Bounds) -> _Planes:
    """Nothing known but these."""
    shape, (nearest, farthest) = stack.luminance.shape, bounds
    return _Planes(
        depths=np.zeros(shape, np.float32),
        normals=np.zeros((*shape, 3), np.float32),
        costs=np.ones(shape, np.float32),
        nearest=nearest,
        farthest=farthest,
    )


def _at_finer(planes: _Planes, coarse: StereoViews, fine: StereoViews, bounds: Bounds) -> _Planes:
    """The planes of the pixels that lie under those of finer images, as far as they are within the ``bounds`` there."""
    shape = fine.luminance.shape
    height, width = coarse.luminance.shape[1:]
    made = _Planes(
        depths=np.empty(shape, np.float32),
        normals=np.empty((*shape, 3), np.float32),
        costs=np.ones(shape, np.float32),
        nearest=bounds[0],
        farthest=bounds[1],
    )
    for i in range(len(fine)):
        ratio = coarse.lenses[i, :2] / fine.lenses[i, :2]
        columns = (np.arange(shape[2]) + 0.5 - fine.lenses[i, 2]) * ratio[0] + coarse.lenses[i, 2]
        rows = (np.arange(shape[1]) + 0.5 - fine.lenses[i, 3]) * ratio[1] + coarse.lenses[i, 3]
        under = np.ix_(np.clip(rows.astype(np.int64), 0, height - 1), np.clip(columns.astype(np.int64), 0, width - 1))
        made.depths[i], made.normals[i] = planes.depths[i][under], planes.normals[i][under]
        made.depths[i][(made.depths[i] < made.nearest[i]) | (made.depths[i] > made.farthest[i])] = 0
    return made


def _sweep(
    stack: StereoViews,
    planes: _Planes,
    others: Sequence[Int64[np.ndarray, " _"]],
    each: _Round,
    seed: int,
    tell: Callable[[], None],
) -> None:
    before = planes.depths.copy() if each.geometric else planes.depths

    def improve(i: int) -> None:
        if len(others[i]):
            judges = min(_JUDGES, len(others[i])) if each.geometric else len(others[i])
            kernels.improve(
                stack.luminance, stack.pure, stack.lenses, i, others[i], stack.relative(i, others[i]),
                before, each.geometric, planes.nearest[i], planes.farthest[i], min(_COUNTED, judges), judges,
                _STRIDE, each.sweeps, np.float32(each.span), each.tries, each.fresh, seed * len(stack) + i,
                planes.depths[i], planes.normals[i], planes.costs[i],
            )  # fmt: skip
        tell()

    in_threads(improve, range(len(stack)))


def _believed(
    stack: StereoViews, planes: _Planes, others: Sequence[Int64[np.ndarray, " _"]], options: StereoOptions
) -> DepthMaps:
    shape = stack.luminance.shape
    agreeing, against = np.zeros(shape, np.int32), np.zeros(shape, np.int32)

    def look(i: int) -> None:
        # A pixel is an ever larger share of the depth behind the object, and always one of an inverse depth.
        near = float(np.linalg.norm(stack.positions[i])) if options.beyond else _FARTHEST
        kernels.agree(
            stack.lenses, i, others[i], stack.relative(i, others[i]), planes.depths, planes.normals,
            np.float32(_BACK_PIXELS), np.float32(_BACK_SHARE), np.float32(near), np.float32(_ALIKE),
            agreeing[i], against[i],
        )  # fmt: skip

    in_threads(look, range(len(stack)))
    believed = (planes.depths > 0) & (agreeing >= options.agreeing) & (against <= agreeing) & (planes.costs < _WORST)
    sureness = np.minimum(agreeing, _SURE).astype(np.float32) / np.float32(_SURE)
    return DepthMaps(
        views=stack,
        depths=np.where(believed, planes.depths, np.float32(0)),
        normals=planes.normals,
        confidence=np.where(believed, sureness * (1 - np.clip(planes.costs, 0, 0.9)), np.float32(0)),
    )
