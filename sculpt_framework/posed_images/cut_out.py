"""Masks for photographs with anything behind the object: GrabCut, seeded by a box in space.

The box is projected into each view. What is outside its outline is background for certain; what is in the middle of it
is the object and the rest background, until colours say otherwise. Colours are learned once for all views, from a sheet
of small ones side by side: what is the same behind the object everywhere is then known as background even where a view
has it inside the outline. The masks of all views bound the object more tightly than the seed did, so this is done
twice; a last cut, at more pixels, only decides along the outlines.

Rother, Kolmogorov, Blake: "GrabCut", SIGGRAPH 2004; the implementation is OpenCV's.
"""

from collections.abc import Sequence
from functools import partial

import cv2
import numpy as np
import torch

from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.box import fit_box
from sculpt_framework.posed_images.grab_cut import LEAST, Colors, Mask, Trimap, cut, masked, reduced, strip
from sculpt_framework.posed_images.projected_box import box_outline
from sculpt_framework.threads import in_threads
from sculpt_framework.types import Box, Camera, View

_COARSE, _FINE = 160, 400
"""Longer side of the images the two cuts are made on, in pixels."""
_SHEET_VIEWS, _SHEET_SIDE = 24, 96
"""Views on the sheet that colours are learned from, and the longer side of each in pixels."""
_ROUNDS = 6
_CORE = 0.55
"""What is taken for the object at first: the outline of the box shrunk to this share."""
_BAND = 0.02
"""Half the width of the strip along an outline that the second cut decides, as a share of the image's longer side."""
_SLACK = 0.08
"""By which the box is enlarged before it is projected."""
_ENOUGH = 0.5
"""Share of the views in which something must be found for it to be taken for the object."""


def cut_out(views: Sequence[View], test: Sequence[View], seed: Box) -> tuple[list[View], list[View], str]:
    """The views with an alpha each, without those that show nothing, and one line on what was done.

    Views that have an alpha keep it. Raises DataError if no view shows an object.
    """
    bare = [view for view in (*views, *test) if view.alpha is None]
    given = [view for view in views if view.alpha is not None]
    box, told = seed, ""
    masks: list[Mask] = []
    for _ in range(2):
        colors = _learn(bare, box)
        masks = in_threads(partial(_coarse, box=box, colors=colors), bare)
        found = [masked(view, mask) for view, mask in zip(bare, masks, strict=True) if mask.mean() >= LEAST]
        if not found and not given:
            raise DataError(
                f"no object could be cut out of {len(bare)} images; put masks into a folder 'masks' beside the images, "
                "or say where the object is with --dataset.box."
            )
        box, told = _tightened([*given, *found], box)
    fine = in_threads(lambda pair: _fine(pair[0], pair[1], box, colors), list(zip(bare, masks, strict=True)))
    done = {id(view): masked(view, mask) for view, mask in zip(bare, fine, strict=True)}
    train = [done.get(id(view), view) for view in views]
    seen = [view for view in train if view.alpha is not None and float(view.alpha.mean()) >= LEAST]
    if len(seen) < _ENOUGH * len(train):
        raise DataError(
            f"an object could be cut out of {len(seen)} of {len(train)} images only, which is more likely a part of "
            "what is around it; put masks into a folder 'masks' beside the images, or say where the object is with "
            "--dataset.box."
        )
    note = f"{len(bare)} of {len(views) + len(test)} images have no mask: the object is cut out of them{told}"
    note += "; look at the masks: sculpt-data masks DIR."
    if len(seen) < len(train):
        note += f" {len(train) - len(seen)} images in which nothing was found are left out."
    return seen, [done.get(id(view), view) for view in test], note


def _tightened(masked: Sequence[View], seed: Box) -> tuple[Box, str]:
    try:
        box = fit_box(masked).box
    except DataError:
        return seed, ", though the first cuts contradict each other"
    return Box(minimum=torch.maximum(box.minimum, seed.minimum), maximum=torch.minimum(box.maximum, seed.maximum)), ""


def _learn(views: Sequence[View], box: Box) -> Colors:
    """Colours of background and object over all views."""
    step = -(-len(views) // _SHEET_VIEWS)
    small = [reduced(view, _SHEET_SIDE) for view in views[::step]]
    side = max(max(item.image.shape[:2]) for item in small)
    sheet = np.zeros((side, side * len(small), 3), np.uint8)
    trimap = np.full(sheet.shape[:2], cv2.GC_BGD, np.uint8)
    real = np.zeros(sheet.shape[:2], bool)
    for index, item in enumerate(small):
        height, width = item.image.shape[:2]
        place = slice(0, height), slice(index * side, index * side + width)
        sheet[place], trimap[place], real[place] = item.image, _first_trimap(item.camera, box), True
    # What only fills the sheet up repeats its first column, so that it teaches no colour of its own.
    sheet = np.where(real[..., None], sheet, np.median(sheet[real], axis=0).astype(np.uint8))
    background, object_ = np.zeros((1, 65)), np.zeros((1, 65))
    # The clusters it starts from are drawn at random, from a generator of each thread.
    cv2.setRNGSeed(0)
    cv2.grabCut(sheet, trimap, (0, 0, 1, 1), background, object_, _ROUNDS, cv2.GC_INIT_WITH_MASK)
    return Colors(background=background, object=object_)


def _first_trimap(camera: Camera, box: Box) -> Trimap:
    allowed, core = box_outline(camera, box, 1 + _SLACK), box_outline(camera, box, _CORE)
    trimap = np.where(core, cv2.GC_PR_FGD, cv2.GC_PR_BGD)
    trimap = np.where(allowed, trimap, cv2.GC_BGD).astype(np.uint8)
    _add_border(trimap)
    return trimap


def _coarse(view: View, box: Box, colors: Colors) -> Mask:
    small = reduced(view, _COARSE)
    return cut(small.image, _first_trimap(small.camera, box), colors)


def _fine(view: View, coarse: Mask, box: Box, colors: Colors) -> Mask:
    small = reduced(view, _FINE)
    height, width = small.image.shape[:2]
    start = cv2.resize(coarse.astype(np.float32), (width, height), interpolation=cv2.INTER_LINEAR) > 0.5
    allowed = box_outline(small.camera, box, 1 + _SLACK)
    trimap = strip(start, max(2, round(_BAND * max(height, width))), sure=allowed, possible=allowed)
    return cut(small.image, trimap, colors)


def _add_border(trimap: Trimap) -> None:
    """Where the box fills the image, a thin border of it is background: a cut needs some of each."""
    if (trimap == cv2.GC_BGD).mean() >= 0.02:
        return
    wide = max(1, round(0.01 * max(trimap.shape)))
    for side in (trimap[:wide], trimap[-wide:], trimap[:, :wide], trimap[:, -wide:]):
        side[:] = cv2.GC_BGD
