"""Masks that are right to a pixel of coarse images, and the finer ones that colours cut along them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from sculpt_framework.multi_view_stereo.depth_maps import depth_bounds
from sculpt_framework.multi_view_stereo.stereo_views import StereoViews
from sculpt_framework.posed_images.grab_cut import background_of, cut_along, masked, rough_cut
from sculpt_framework.posed_images.solid import GROWN, Solid
from sculpt_framework.posed_images.still_background import with_still_background
from sculpt_framework.threads import in_threads
from sculpt_framework.types import View


@dataclass(frozen=True, kw_only=True, eq=False)
class RoughMask:
    """A view's mask at the size of the images that were compared."""

    inside: Bool[np.ndarray, "h w"]
    sure: Bool[np.ndarray, "h w"]
    """What is nearest there has been seen; elsewhere something only hides what is behind it from most views."""


_NOTHING = RoughMask(inside=np.zeros((1, 1), bool), sure=np.zeros((1, 1), bool))


def rough_masks(stack: StereoViews, count: int, solid: Solid) -> list[RoughMask]:
    """Of so many views, of which ``stack`` has those that show the volume."""
    nearest, _ = depth_bounds(stack, solid.inside, solid.volume)
    nearest_seen, _ = depth_bounds(stack, solid.inside & solid.seen, solid.volume)
    sure = (nearest_seen > 0) & (nearest_seen < nearest + GROWN * solid.volume.cell)
    found = {
        int(given): RoughMask(inside=nearest[i, :rows, :columns] > 0, sure=sure[i, :rows, :columns])
        for i, (given, (rows, columns)) in enumerate(zip(stack.given, stack.sizes, strict=True))
    }
    return [found.get(index, _NOTHING) for index in range(count)]


def cut_masks(views: Sequence[View], rough: Sequence[RoughMask], *, blind: bool) -> list[View]:
    """Those without an alpha get one, along their rough outlines; ``blind`` where these end short of borders."""
    bare = [number for number, view in enumerate(views) if view.alpha is None]
    cuts = in_threads(
        lambda number: rough_cut(views[number], rough[number].inside, rough[number].sure, blind=blind), bare
    )
    cuts = with_still_background(cuts, [views[number].camera for number in bare])
    background = background_of(cuts)
    out = list(views)
    for number, mask in zip(bare, in_threads(lambda cut: cut_along(cut, background), cuts), strict=True):
        out[number] = masked(views[number], mask)
    return out
