"""Which pieces of a mesh are the object's."""

import numpy as np
import trimesh

from sculpt_framework.geometry.stray import main_faces


def test_specks_and_bubbles_go_and_a_rod_that_lost_its_joint_stays():
    body, bubble = trimesh.creation.icosphere(radius=1.0), trimesh.creation.icosphere(radius=0.5)
    bubble.invert()
    rod = trimesh.creation.cylinder(radius=0.005, height=0.4, sections=6)
    rod.apply_translation([0.0, 0.0, 1.4])
    speck = trimesh.creation.icosphere(subdivisions=1, radius=0.02)
    speck.apply_translation([1.5, 0.0, 0.0])
    pieces = {"body": body, "bubble": bubble, "rod": rod, "speck": speck}
    whole = trimesh.util.concatenate(list(pieces.values()))
    kept = main_faces(np.asarray(whole.vertices), np.asarray(whole.faces, np.int64))
    first = np.cumsum([0, *(len(each.faces) for each in pieces.values())])
    share = {name: kept[a:b].mean() for name, a, b in zip(pieces, first[:-1], first[1:], strict=True)}
    assert share == {"body": 1.0, "bubble": 0.0, "rod": 1.0, "speck": 0.0}
    assert rod.area < 0.01 * body.area
