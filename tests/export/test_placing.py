"""Size, unit, up, origin and base of exported meshes, read back by other libraries."""

import json
import zipfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh

from sculpt_framework.cli.export import export
from sculpt_framework.errors import ConfigError, DataError
from sculpt_framework.evaluation.certificate import Certificate, certify
from sculpt_framework.export.mesh_files import write_mesh_ply
from sculpt_framework.export.options import parse_length, parse_up
from sculpt_framework.export.placing import rotation_between

AXES = {"X": (1, 0, 0), "Y": (0, 1, 0), "Z": (0, 0, 1), "-X": (-1, 0, 0), "-Y": (0, -1, 0), "-Z": (0, 0, -1)}
CORE = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"
COLORS = "{http://schemas.microsoft.com/3dmanufacturing/material/2015/02}"


def cone() -> trimesh.Trimesh:
    """Standing on z = 1, 2 high, 1.2 wide: up can be told from down, and no two sides are as long."""
    made = trimesh.creation.cone(radius=0.6, height=2.0, sections=48)
    made = made.subdivide().subdivide()
    return made.apply_translation([3.0, -2.0, 1.0])


def write_run(folder: Path, shape: trimesh.Trimesh, frame: dict | None = None) -> Path:
    folder.mkdir(parents=True)
    vertices = np.array(shape.vertices)
    # Red below, green above.
    share = (vertices[:, 2:] - vertices[:, 2].min()) / np.ptp(vertices[:, 2])
    colors = np.hstack([1 - share, share, np.full_like(share, 0.25)])
    write_mesh_ply(folder / "mesh.ply", vertices, np.array(shape.faces, np.int64), colors)
    if frame is not None:
        (folder / "frame.json").write_text(json.dumps(frame), encoding="utf-8")
    return folder


@pytest.fixture
def run_dir(tmp_path: Path) -> Path:
    return write_run(tmp_path / "run", cone())


def run(*words: object) -> None:
    export([str(word) for word in words])


def read(path: Path) -> trimesh.Trimesh:
    """With vertices at the same place merged, as trimesh and slicers read a file."""
    if path.suffix == ".3mf":
        return trimesh.Trimesh(*read_3mf(path)[:2])
    return trimesh.load_scene(path).to_mesh()


def read_3mf(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray, str]:
    """Vertices, faces, a colour for each corner, and the unit, by the standard alone."""
    with zipfile.ZipFile(path) as archive:
        root = ElementTree.fromstring(archive.read("3D/3dmodel.model"))
    group = root.find(f".//{COLORS}colorgroup")
    colors = [bytes.fromhex(color.attrib["color"][1:])[:3] for color in group] if group is not None else []
    vertices = [[float(each.attrib[axis]) for axis in "xyz"] for each in root.iter(f"{CORE}vertex")]
    triangles = list(root.iter(f"{CORE}triangle"))
    faces = [[int(each.attrib[name]) for name in ("v1", "v2", "v3")] for each in triangles]
    corners = [[int(each.attrib.get(name, each.attrib["p1"])) for name in ("p1", "p2", "p3")] for each in triangles]
    assert all(each.attrib["pid"] == group.attrib["id"] for each in triangles)
    return (
        np.array(vertices),
        np.array(faces),
        np.array([list(color) for color in colors])[corners],
        root.attrib["unit"],
    )


def check(shape: trimesh.Trimesh) -> Certificate:
    found = certify(np.array(shape.vertices, np.float64), np.array(shape.faces, np.int64))
    assert found.outward
    assert found.watertight_merged
    assert found.vertex_manifold
    assert shape.volume > 0
    return found


def top_of(shape: trimesh.Trimesh, axis: int) -> float:
    """How much wider the mesh is at the lower end of an axis than at the upper."""
    heights = shape.vertices[:, axis]
    widths = [
        np.ptp(np.delete(shape.vertices[heights == end], axis, axis=1), axis=0).max()
        for end in (heights.min(), heights.max())
    ]
    return float(widths[0] - widths[1])


@pytest.mark.parametrize(("kind", "up"), [("stl", 2), ("3mf", 2), ("ply", 2), ("obj", 1), ("glb", 1)])
def test_size_base_and_origin_of_every_format(kind: str, up: int, run_dir: Path, tmp_path: Path):
    out = tmp_path / f"a.{kind}"
    words = ("--size", "80mm", "--flat-base", "--origin", "bottom-center", "--up", "Z", "--target-faces", 800)
    run(run_dir, "--format", kind, *words, "--out", out)
    mesh = read(out)
    found = check(mesh)
    assert 400 < found.faces <= 800
    size = {"glb": 0.08}.get(kind, 80.0)
    assert mesh.extents.max() == pytest.approx(size, rel=1e-6)
    assert mesh.extents.argmax() == up
    low, high = mesh.bounds
    assert low[up] == pytest.approx(0, abs=1e-6 * size)
    middle = np.delete(0.5 * (low + high), up)
    np.testing.assert_allclose(middle, 0, atol=1e-6 * size)
    assert top_of(mesh, up) > 0
    # The base is one flat face, from which nothing sticks out.
    flat = (mesh.vertices[mesh.faces][:, :, up] < 1e-5 * size).all(axis=1)
    assert mesh.area_faces[flat].sum() == pytest.approx(np.pi * (0.3 * size) ** 2, rel=0.03)


@pytest.mark.parametrize("name", AXES)
@pytest.mark.parametrize(("kind", "axis"), [("stl", 2), ("glb", 1)])
def test_any_axis_can_be_up(name: str, kind: str, axis: int, tmp_path: Path):
    shape = cone()
    turn = np.eye(4)
    turn[:3, :3] = rotation_between(np.array([0.0, 0, 1]), np.array(AXES[name], float))
    run_dir = write_run(tmp_path / "run", shape.copy().apply_transform(turn))
    run(run_dir, "--format", kind, "--up", name, "--out", tmp_path / f"a.{kind}")
    mesh = read(tmp_path / f"a.{kind}")
    check(mesh)
    assert mesh.extents.argmax() == axis
    assert top_of(mesh, axis) > 0
    assert mesh.volume == pytest.approx(shape.volume, rel=1e-5)


def test_an_oblique_up(tmp_path: Path):
    direction = np.array([0.2, -0.9, 0.3])
    turn = np.eye(4)
    turn[:3, :3] = rotation_between(np.array([0.0, 0, 1]), direction / np.linalg.norm(direction))
    run_dir = write_run(tmp_path / "run", cone().apply_transform(turn))
    run(run_dir, "--format", "stl", "--up", "0.2 -0.9 0.3", "--flat-base", "--out", tmp_path / "a.stl")
    mesh = read(tmp_path / "a.stl")
    check(mesh)
    assert mesh.extents[2] == pytest.approx(2 * 0.995, rel=1e-4)
    assert mesh.extents[:2] == pytest.approx([1.2, 1.2], rel=0.01)


def test_rotations():
    generator = np.random.default_rng(0)
    directions = [np.array(axis, float) for axis in AXES.values()]
    directions += [vector / np.linalg.norm(vector) for vector in generator.normal(size=(6, 3))]
    for start in directions:
        for end in (*directions, -start):
            turn = rotation_between(start, end)
            np.testing.assert_allclose(turn @ start, end, atol=1e-12)
            np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
            assert np.linalg.det(turn) == pytest.approx(1)


@pytest.mark.parametrize(
    ("words", "longest"),
    [
        ((), 2000.0),
        (("--unit", "cm"), 200.0),
        (("--unit", "in"), 2000 / 25.4),
        (("--size", "80mm"), 80.0),
        (("--size", "80"), 80.0),
        (("--size", "8cm"), 80.0),
        (("--size", "3.1in"), 78.74),
        (("--size", "80mm", "--unit", "m"), 0.08),
    ],
)
def test_units_of_a_scene_in_metres(words: tuple[str, ...], longest: float, tmp_path: Path):
    run_dir = write_run(tmp_path / "run", cone(), {"metres_per_unit": 1.0, "up": None})
    run(run_dir, "--format", "stl", *words, "--out", tmp_path / "a.stl")
    assert read(tmp_path / "a.stl").extents.max() == pytest.approx(longest, rel=1e-6)


def test_true_scale_of_every_format(tmp_path: Path):
    run_dir = write_run(tmp_path / "run", cone(), {"metres_per_unit": 0.05, "up": [0, 0, 2]})
    for kind, longest in {"glb": 0.1, "stl": 100, "3mf": 100, "obj": 2, "ply": 2}.items():
        run(run_dir, "--format", kind, "--out", tmp_path / f"a.{kind}")
        assert read(tmp_path / f"a.{kind}").extents.max() == pytest.approx(longest, rel=1e-6)
    run(run_dir, "--format", "obj", "--unit", "m", "--out", tmp_path / "a.obj")
    assert read(tmp_path / "a.obj").extents.max() == pytest.approx(0.1, rel=1e-6)


@pytest.mark.parametrize(("unit", "name"), [(None, "millimeter"), ("cm", "centimeter"), ("m", "meter"), ("in", "inch")])
def test_3mf_says_its_unit_and_has_colours(unit: str | None, name: str, run_dir: Path, tmp_path: Path):
    lib3mf = pytest.importorskip("lib3mf")
    out = tmp_path / "a.3mf"
    run(run_dir, "--format", "3mf", "--size", "8cm", "--out", out, *(("--unit", unit) if unit else ()))
    vertices, faces, colors, said = read_3mf(out)
    assert said == name
    millimetres = {"millimeter": 1, "centimeter": 10, "meter": 1000, "inch": 25.4}[name]
    assert np.ptp(vertices, axis=0).max() * millimetres == pytest.approx(80, rel=1e-6)
    share = (vertices[faces][:, :, 2] - vertices[:, 2].min()) / np.ptp(vertices[:, 2])
    assert np.abs(colors[:, :, 1] / 255 - share).max() < 0.01
    wrapper = lib3mf.get_wrapper()
    reader = wrapper.CreateModel().QueryReader("3mf")
    reader.SetStrictModeActive(True)
    reader.ReadFromFile(str(out))
    assert reader.GetWarningCount() == 0


def test_up_and_metres_come_from_the_run_and_then_from_the_scene(tmp_path: Path):
    turn = trimesh.transformations.rotation_matrix(np.pi, [1, 0, 0])
    scene = tmp_path / "scene"
    scene.mkdir()
    (scene / "frame.json").write_text('{"metres_per_unit": 0.04, "up": [0, 0, -1]}', encoding="utf-8")
    run_dir = write_run(tmp_path / "run", cone().apply_transform(turn), {"metres_per_unit": 0.05, "up": None})
    (run_dir / "config.json").write_text(json.dumps({"data": str(scene)}), encoding="utf-8")
    run(run_dir, "--format", "stl", "--out", tmp_path / "a.stl")
    mesh = read(tmp_path / "a.stl")
    assert mesh.extents[2] == pytest.approx(100, rel=1e-6)
    assert top_of(mesh, 2) > 0
    run(run_dir, "--format", "stl", "--up", "Z", "--out", tmp_path / "a.stl")
    assert top_of(read(tmp_path / "a.stl"), 2) < 0


def test_what_nobody_knows_is_said(run_dir: Path, capsys: pytest.CaptureFixture[str]):
    run(run_dir, "--format", "stl")
    assert "scene units, watertight" in (said := capsys.readouterr().out)
    assert "no real size is known" in said
    assert "z of the scene is taken for up" in said
    run(run_dir, "--format", "stl", "--size", "80mm", "--up", "Z")
    assert capsys.readouterr().out.splitlines()[1].endswith("80 mm, watertight")


def test_pieces_are_counted(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    both = trimesh.util.concatenate([cone(), cone().apply_translation([5, 0, 0])])
    run(write_run(tmp_path / "run", both), "--format", "stl", "--size", "80mm")
    assert "mm, watertight, 2 pieces\n" in capsys.readouterr().out


def test_coincident_vertices_of_a_run_are_parted(tmp_path: Path):
    shape = cone()
    face = shape.faces[20]
    shape.vertices[face[0]] = shape.vertices[face[1]]
    run_dir = write_run(tmp_path / "run", trimesh.Trimesh(shape.vertices, shape.faces, process=False))
    assert not trimesh.load_mesh(run_dir / "mesh.ply").is_watertight
    for kind in ("ply", "obj", "glb", "stl", "3mf"):
        run(run_dir, "--format", kind, "--size", "80mm", "--out", tmp_path / f"a.{kind}")
        assert check(read(tmp_path / f"a.{kind}")).faces == len(shape.faces)


@pytest.mark.parametrize(
    ("words", "error", "message"),
    [
        (("--size", "80km"), ConfigError, r"--size is '80km'; expected a length above 0 such as 80mm"),
        (("--size", "0mm"), ConfigError, r"--size is '0mm'"),
        (("--size", "1.2.3mm"), ConfigError, r"--size is '1\.2\.3mm'"),
        (("--up", "up"), ConfigError, r"--up is 'up'; expected X, Y, Z"),
        (("--up", "0 0 0"), ConfigError, r"--up is '0 0 0'"),
        (("--unit", "mm"), ConfigError, r"--unit mm: no real size of this scene is known; give one, as in --size 80mm"),
        (("--flat-base", "--size", "0.4mm"), DataError, r"--flat-base: the mesh is only .* high; give a larger --size"),
    ],
)
def test_mistakes_leave_nothing(words: tuple, error: type[Exception], message: str, run_dir: Path, tmp_path: Path):
    before = sorted(run_dir.iterdir())
    with pytest.raises(error, match=message):
        run(run_dir, "--format", "stl", *words)
    assert sorted(run_dir.iterdir()) == before


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("no JSON", "the JSON is not valid at line 1"),
        ("[]", "holds a list; expected an object with metres_per_unit and up"),
        ('{"metres_per_unit": 0}', "metres_per_unit is 0; expected more than 0, or null"),
        ('{"metres_per_unit": NaN}', "metres_per_unit is nan; expected a finite number"),
        ('{"metres_per_unit": true}', "metres_per_unit is a truth value; expected a number"),
        ('{"up": [0, 0, 0]}', r"up is \[0, 0, 0\]; expected three numbers that are not all 0, or null"),
        ('{"up": [1, 2]}', r"up is \[1, 2\]; expected three numbers"),
        ('{"up": "z"}', "up is z; expected three numbers"),
    ],
)
def test_a_frame_file_that_is_none(text: str, complaint: str, run_dir: Path):
    (run_dir / "frame.json").write_text(text, encoding="utf-8")
    with pytest.raises(DataError, match=rf"frame\.json: {complaint}"):
        run(run_dir, "--format", "stl")


def test_an_open_mesh_is_exported_and_said_to_be_open(run_dir: Path, capsys: pytest.CaptureFixture[str]):
    shape = cone()
    shape.update_faces(np.arange(len(shape.faces)) != 7)
    write_mesh_ply(run_dir / "mesh.ply", np.array(shape.vertices), np.array(shape.faces, np.int64))
    run(run_dir, "--format", "stl", "--size", "80mm")
    assert "not watertight: 3 edges with one face" in capsys.readouterr().out
    with pytest.raises(DataError, match="not closed"):
        run(run_dir, "--format", "stl", "--size", "80mm", "--flat-base")


@pytest.mark.parametrize("kind", ["stl", "ply"])
def test_a_mesh_that_is_none(kind: str, run_dir: Path):
    vertices, faces = np.array(cone().vertices), np.array(cone().faces, np.int64)
    write_mesh_ply(run_dir / "mesh.ply", np.where(vertices == vertices.max(), np.nan, vertices), faces)
    with pytest.raises(DataError, match=r"mesh\.ply is not a valid mesh: [0-9]+ vertices are not finite"):
        run(run_dir, "--format", kind, "--out", run_dir / f"a.{kind}")
    write_mesh_ply(run_dir / "mesh.ply", vertices, faces[:0])
    with pytest.raises(DataError, match=r"mesh\.ply"):
        run(run_dir, "--format", kind, "--out", run_dir / f"a.{kind}")
    assert [path.name for path in run_dir.iterdir()] == ["mesh.ply"]


def test_words():
    assert (parse_length("80mm").value, parse_length("80mm").unit) == (80, "mm")
    assert (parse_length(" 1e-1 m").value, parse_length("3.5").unit) == (0.1, None)
    assert tuple(parse_up("-y")) == (0, -1, 0)
    assert tuple(parse_up("1, 0 -2")) == (1, 0, -2)
