import pytest

from sculpt_plugins.extractors.flexicubes.config import FlexiCubesConfig
from sculpt_plugins.extractors.marching_tetrahedra.config import MarchingTetrahedraConfig

CONFIGS = {
    "tetrahedra": MarchingTetrahedraConfig(),
    "diagonal": FlexiCubesConfig(split="diagonal", learn_weights=False),
    "center": FlexiCubesConfig(split="center", learn_weights=True),
    "deformed": FlexiCubesConfig(split="diagonal", learn_weights=True, learn_deformation=True),
}


@pytest.fixture(scope="session", params=CONFIGS.values(), ids=CONFIGS.keys())
def config(request: pytest.FixtureRequest):
    """The config of every extractor, in each of its ways to make triangles."""
    return request.param
