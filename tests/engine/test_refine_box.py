"""``--refine-box``: finer cells in boxes, from the command line to the mesh."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from small_runs import TWO_STAGES, small_config, train

from sculpt_framework.command_line.request import parse
from sculpt_framework.config import MethodConfig
from sculpt_framework.errors import ConfigError
from sculpt_framework.evaluation.certificate import certify
from sculpt_framework.extractors import Extraction, Extractor
from sculpt_framework.geometry.band import discover, levels_of
from sculpt_framework.geometry.grid import Grid, pack
from sculpt_framework.geometry.signed_distance import SdfFunction
from sculpt_framework.sculpting.assembly import build_parts
from sculpt_framework.sculpting.gaussian_scene import nearest_faces
from sculpt_framework.sculpting.state import capture, restore
from sculpt_framework.serialization import config_from_json, config_to_json
from sculpt_framework.types import Scene
from sculpt_plugins.extractors.flexicubes.config import FlexiCubesConfig
from sculpt_plugins.extractors.marching_tetrahedra.config import MarchingTetrahedraConfig


class OneSize(Extractor):
    """What a package of one's own may bring; it is never asked to do anything."""

    grid = property(lambda self: pytest.fail("asked for its grid"))
    tables = property(lambda self: pytest.fail("asked for its tables"))

    def set_grid(self, grid: Grid) -> None:
        pytest.fail("given a grid")

    def extract(self, sdf: SdfFunction, seeds: torch.Tensor) -> Extraction:
        pytest.fail("asked for a surface")


def upper_half(scene: Scene) -> tuple[float, float, float, float, float, float]:
    """A box round the upper half of the object."""
    low, high = scene.box.minimum.clone(), scene.box.maximum
    low[2] = scene.box.center[2]
    x0, y0, z0, x1, y1, z1 = torch.cat([low, high]).double().tolist()
    return x0, y0, z0, x1, y1, z1


def refined(scene: Scene, **changes: object) -> MethodConfig:
    few = {"steps": 4, "fit_steps": 40, "polish_steps": 0}
    return small_config(**{"refine_box": (upper_half(scene),), **few, **changes})


def test_boxes_on_the_command_line():
    first, second = ["-0.5", "0", "0.25", "0.5", "1", "1e0"], ["0", "0", "0", "1", "1", "1"]
    words = ["--refine-box", *first, "--refine-box", *second, "--refine-box-levels", "2"]
    config = parse(["gaussian-sculpting", "--data", "demo", *words])
    assert config.refine_box == ((-0.5, 0.0, 0.25, 0.5, 1.0, 1.0), (0.0, 0.0, 0.0, 1.0, 1.0, 1.0))
    assert config.refine_box_levels == 2
    assert config_from_json(config_to_json(config)) == config
    assert parse(["gaussian-sculpting", "--data", "demo"]).refine_box == ()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--refine-box 0 0 1 1 1 1", "--refine-box is 0 0 1 1 1 1; expected X0 < X1, Y0 < Y1, Z0 < Z1"),
        ("--refine-box 0 0 0 1 1 1 --refine-box-levels 0", "--refine-box-levels is 0; expected 1 to 6"),
    ],
)
def test_boxes_that_cannot_be(words: str, message: str):
    with pytest.raises(ConfigError, match=message):
        parse(["gaussian-sculpting", "--data", "demo", *words.split()])


def test_boxes_that_do_not_fit_the_run(scene: Scene, monkeypatch: pytest.MonkeyPatch):
    def build(config: MethodConfig) -> None:
        build_parts(config, scene.box, torch.Generator())

    build(refined(scene))
    with pytest.raises(ConfigError, match="--refine-box 7 7 7 8 8 8 lies outside the object's box, which is"):
        build(small_config(refine_box=((7.0, 7.0, 7.0, 8.0, 8.0, 8.0),)))
    build(refined(scene, extractor=MarchingTetrahedraConfig()))
    with monkeypatch.context() as patched:
        patched.setattr(FlexiCubesConfig, "build", lambda self, grid, device: OneSize())
        with pytest.raises(ConfigError, match="extractor 'flexicubes' has cells of one size only"):
            build(refined(scene))
    deep = (replace(TWO_STAGES[0], level=9),)
    with pytest.raises(ConfigError, match="--refine-box-levels 6 is too many here"):
        build(refined(scene, refine_box_levels=6, stages=deep))


def test_a_run_ends_with_finer_triangles_in_the_box(scene: Scene):
    extractor = FlexiCubesConfig(split="center", learn_deformation=True)
    outcome = train(refined(scene, extractor=extractor, stages=TWO_STAGES), scene)
    mesh = outcome.result.mesh
    assert all(np.isfinite(outcome.losses))
    certificate = certify(mesh.vertices, mesh.faces)
    assert certificate.watertight
    assert certificate.consistently_oriented
    corners = mesh.vertices[mesh.faces]
    edge = np.linalg.norm(corners[:, 0] - corners[:, 1], axis=1)
    height = corners[..., 2].mean(axis=1) - float(scene.box.center[2])
    margin = 0.15 * scene.box.scale
    assert 1.6 < np.median(edge[height < -margin]) / np.median(edge[height > margin]) < 2.4


def test_a_run_spares_cells_that_its_pixels_do_not_show(scene: Scene):
    few = {"steps": 3, "fit_steps": 40, "polish_steps": 0, "stages": TWO_STAGES}
    plain, spared = (train(small_config(**few, cell_pixels=pixels), scene) for pixels in (None, 6.0))
    assert all(np.isfinite(spared.losses))
    # The second stage has cells of half the size, which are less than six pixels wide.
    assert len(spared.result.mesh.faces) < 0.5 * len(plain.result.mesh.faces)
    certificate = certify(spared.result.mesh.vertices, spared.result.mesh.faces)
    assert certificate.watertight
    assert certificate.consistently_oriented


def test_a_run_with_boxes_is_restored_as_it_was(scene: Scene):
    config = refined(scene, refine_box_levels=2)
    trainer = build_parts(config, scene.box, torch.Generator()).trainer
    trainer.seeds = discover(trainer.field, trainer.extractor.grid, 0)
    trainer.extract()
    for table in trainer.extractor.tables.values():
        for leaf in table.leaves.values():
            leaf.data.normal_(generator=torch.Generator().manual_seed(1))
    before = trainer.extract()
    assert levels_of(before.cells).unique().tolist() == [0, 1, 2]
    state = capture(trainer, 0, torch.Generator())
    other = build_parts(replace(config, seed=5), scene.box, torch.Generator()).trainer
    restore(other, torch.Generator(), state)
    after = other.extract()
    assert torch.equal(after.surface.face_keys, before.surface.face_keys)
    torch.testing.assert_close(after.surface.vertices, before.surface.vertices)


def test_new_faces_among_faces_of_two_levels_find_the_nearest():
    random = torch.Generator().manual_seed(0)
    places = torch.randint(8, (60, 3), generator=random).unique(dim=0)
    fine = pack(1, places)
    coarse = pack(0, places[::3] // 2).unique()
    # In the order of keys the last coarse place and the first fine one are neighbours, though far apart.
    old_keys = torch.cat([fine[::2], coarse[::2]])
    new_keys = torch.cat([fine[1::2], coarse[1::2]])

    def centers(keys: torch.Tensor) -> torch.Tensor:
        ijk = torch.stack([keys >> 39 & 65535, keys >> 23 & 65535, keys >> 7 & 65535], dim=1)
        return (ijk + 0.5) * 0.5 ** levels_of(keys)[:, None]

    lender = nearest_faces(old_keys, centers(old_keys), new_keys, centers(new_keys))
    apart = (centers(old_keys)[lender] - centers(new_keys)).norm(dim=1)
    nearest = torch.cdist(centers(new_keys), centers(old_keys)).amin(dim=1)
    other_level = levels_of(old_keys[lender]) != levels_of(new_keys)
    torch.testing.assert_close(apart[other_level], nearest[other_level])
    assert bool((apart <= nearest + 3**0.5).all())
