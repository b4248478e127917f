"""The reference meshes of the demo scenes are as near to the analytic surfaces as docs/reference/measures.md says."""

import numpy as np
import pytest

from sculpt_framework.demo_scenes.objects import OBJECTS, DemoObject
from sculpt_framework.demo_scenes.reference import reference_mesh


@pytest.mark.slow
@pytest.mark.parametrize("item", OBJECTS.values(), ids=OBJECTS.keys())
def test_vertices_lie_on_the_surface_and_faces_near_it(item: DemoObject):
    vertices, faces = reference_mesh(item.distance, item.reference_cells)
    assert np.abs(item.distance(vertices.T.copy())).max() < 1e-6
    middles = np.abs(item.distance(vertices[faces].mean(axis=1).T.copy()))
    assert middles.max() < 2.5e-3
    assert middles.mean() < 1.1e-4
