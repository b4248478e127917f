"""What the suite found, each with the fault it would show again."""

from pathlib import Path

import pytest
import torch

from sculpt_framework.binders import Binding
from sculpt_framework.demo_scenes.cameras import demo_cameras
from sculpt_framework.demo_scenes.objects import demo_object
from sculpt_framework.errors import DataError
from sculpt_framework.export.atomic import remove_partial_files
from sculpt_framework.export.ply import read_vertex_rows
from sculpt_framework.shape_from_images.hull import visual_hull
from sculpt_framework.stress import life, small
from sculpt_framework.stress.cases import run_cases
from sculpt_framework.stress.faces import make_constraint


def test_the_largest_eigenvalue_keeps_its_digits_where_both_agree():
    """As trace and determinant it was off by 5e-4."""
    generator = torch.Generator().manual_seed(0)
    corners = torch.randn(300, 3, 2, generator=generator)
    corners = corners - corners.mean(dim=1, keepdim=True)
    ellipse = (2.0 / 3.0) * corners.transpose(1, 2) @ corners
    one = torch.ones(300, 1)
    binding = Binding(
        means=torch.zeros(300, 1, 3),
        scales=torch.ones(300, 1, 3),
        rotations=torch.eye(3).expand(300, 1, 3, 3),
        opacities=one,
        barycentrics=torch.full((300, 1, 3), 1.0 / 3.0),
        tangent_covariance=4.0 * ellipse[:, None],
        tangent_corners=corners,
    )
    well_shaped = torch.linalg.cond(ellipse) < 100.0
    assert int(well_shaped.sum()) > 200
    errors = []
    for face in well_shaped.nonzero()[:, 0]:
        each = slice(int(face), int(face) + 1)
        alone = Binding(**{name: value[each] for name, value in vars(binding).items()})
        errors.append(abs(float(make_constraint("mee-scale")(alone)) - 3.0))
    assert max(errors) < 2e-5


NOTICED = ("life-colour-nan", "life-shape-nan")


@pytest.mark.slow
@pytest.mark.parametrize("name", NOTICED)
def test_injuries_are_noticed_at_once(name: str):
    (case,) = (case for case in life.life_cases() if case.id == name)
    (result,) = run_cases([case])
    assert result.ok, result.note


@pytest.mark.slow
@pytest.mark.parametrize("case", list(life.life_cases()), ids=lambda case: case.id)
def test_every_injury(case):
    (result,) = run_cases([case])
    assert result.ok, result.note


def test_a_silhouette_thinner_than_half_a_pixel_carves_nothing():
    cameras = demo_cameras(3, 24)
    views = [small.view_of(demo_object("blob"), camera, str(index)) for index, camera in enumerate(cameras)]
    inside, outside = torch.tensor([[0.0, 0.0, -0.2]]), torch.tensor([[0.0, 0.0, 1.6]])
    thin = small.View(
        name="thin", camera=cameras[0], rgb=views[0].rgb, alpha=0.4 * torch.ones_like(views[0].rgb[..., 0])
    )
    hull = visual_hull([*views, thin], 100)
    assert float(hull(inside)) < 0 < float(hull(outside))
    with pytest.raises(DataError, match="all masks are empty"):
        visual_hull([thin, thin], 100)


def test_what_a_killed_writer_left_is_removed(tmp_path: Path):
    left, kept = tmp_path / "checkpoints" / ".latest.safetensors.123.partial", tmp_path / "mesh.ply"
    left.parent.mkdir()
    for path in (left, kept):
        path.write_bytes(b"x")
    remove_partial_files(tmp_path)
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == [kept]


@pytest.mark.parametrize(
    "header",
    ["element vertex x", "element vertex", "element", "property float", "element vertex -3\nproperty float x", ""],
)
def test_a_header_that_is_no_header_is_one_line(header: str, tmp_path: Path):
    path = tmp_path / "bad.ply"
    path.write_bytes(f"ply\nformat binary_little_endian 1.0\n{header}\nend_header\n".encode() + bytes(64))
    with pytest.raises(DataError):
        read_vertex_rows(path)
