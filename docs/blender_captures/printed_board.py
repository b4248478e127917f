"""A printed board under an object: from it metres and up, or the cameras of a turntable, are found again."""

import numpy as np
import trimesh
from PIL import Image
from trimesh.visual import TextureVisuals
from trimesh.visual.material import SimpleMaterial

from blender_captures.parts import Piece
from sculpt_framework.frame import WorldFrame
from sculpt_framework.markers.boards import Board, board_of
from sculpt_framework.markers.sheets import PIXELS, draw_sheet

METRES = 0.1
"""Of the object's radius."""
BOARD = "ring-7x6-28"
"""Its free place is 1.8 x 1.4 of these."""
PAPER, MARGIN = "a3", 8.0
"""The sheet is cut so many millimetres beyond the markers."""
THICK = 0.004
"""Above the marks on a turntable's plate."""
COARSER = 4
"""The print has 5 pixels to the millimetre, which is finer than any photograph."""


def board_below(floor: float) -> Piece:
    """The sheet on the floor, its middle below the origin; turned, so that its sides are not along the axes."""
    board = board_of(BOARD)
    width, height = (0.5e-3 * (side + 2 * MARGIN) / METRES for side in (board.width, board.height))
    corners = [[-width, -height, 0], [width, -height, 0], [width, height, 0], [-width, height, 0]]
    mesh = trimesh.Trimesh(corners, [[0, 1, 2], [0, 2, 3]], process=False)
    mesh.apply_transform(trimesh.transformations.euler_matrix(0, 0, 0.3))
    mesh.apply_translation([0, 0, floor + THICK])
    uv = np.array([[0, 0], [1, 0], [1, 1], [0, 1]], float)
    mesh.visual = TextureVisuals(uv=uv, material=SimpleMaterial(image=_print(board)))
    return Piece(mesh=mesh, paint="print")


def true_frame() -> WorldFrame:
    """Of the world of these captures."""
    evidence = {"scale_from": "the scene", "up_from": "the scene"}
    return WorldFrame(metres_per_unit=METRES, up=(0.0, 0.0, 1.0), evidence=evidence)


def _print(board: Board) -> Image.Image:
    sheet = draw_sheet(board, PAPER)
    column, row = sheet.origin
    across, along = (PIXELS * (side / 2 + MARGIN) for side in (board.width, board.height))
    cut = Image.fromarray(sheet.pixels).crop(
        tuple(round(each) for each in (column - across, row - along, column + across, row + along))
    )
    return cut.resize((cut.width // COARSER, cut.height // COARSER), Image.Resampling.BOX)
