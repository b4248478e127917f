"""A jug of one colour."""

import numpy as np
import trimesh

from blender_captures.parts import Piece, at, bare, bow, revolved, turned_outward


def jug() -> list[Piece]:
    """A belly, a neck, a lip that opens, a handle; hollow, plain and glazed: nothing to match but what it mirrors."""
    outside, inside = _outlines()
    handle = at(bow((0.3, 0.31), (0.036, 0.05), reach=0.34), [0, 0, 0.72])
    # Its ends stay in the wall.
    cavity = turned_outward(bare(revolved(np.array([[0, 0.05], *inside[::-1], [0, 1.2]]), 192)))
    handle = trimesh.boolean.difference([turned_outward(handle), cavity], engine="manifold")
    body = bare(revolved(np.array([*outside, *inside, [0, 0.05]]), 192))
    return [Piece(mesh=body, paint="plain glaze"), Piece(mesh=handle, paint="plain glaze")]


def _outlines() -> tuple[np.ndarray, np.ndarray]:
    """Radius and height of both sides of the wall: from the middle of the foot up to the lip, and down again."""
    height = np.linspace(0.05, 1.17, 40)
    share = (height - height[0]) / (height[-1] - height[0])
    outer = np.interp(share, [0, 0.1, 0.3, 0.5, 0.72, 0.86, 1], [0.28, 0.36, 0.47, 0.45, 0.29, 0.26, 0.33])
    # Rounded as clay is.
    outer = np.convolve(np.pad(outer, 3, mode="reflect", reflect_type="odd"), np.full(7, 1 / 7), mode="valid")
    rounding = np.linspace(0, np.pi, 12)[1:-1]
    lip = np.stack([outer[-1] - 0.015 + 0.015 * np.cos(rounding), height[-1] + 0.015 * np.sin(rounding)], axis=1)
    outside = np.concatenate([[[0, 0], [0.24, 0], [0.27, 0.015]], np.stack([outer, height], axis=1), lip])
    inside = np.concatenate([np.stack([outer - 0.03, height], axis=1)[:0:-1], [[0.2, 0.06]]])
    return outside, inside
