"""Textures baked from photographs: the colours of the object, also where something stands before it."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import torch
import trimesh
from small_scene import ball, color_at, view_of_ball, views_of_ball

from sculpt_framework.demo_scenes.cameras import demo_cameras
from sculpt_framework.errors import ComponentImportError, ConfigError, OutputError
from sculpt_framework.export.assets import TexturedMesh, write_textured_glb, write_textured_obj
from sculpt_framework.export.pictures import paint
from sculpt_framework.export.texture import Atlas, bake, unwrap
from sculpt_framework.types import Camera, View

pytest.importorskip("xatlas")
SIZE = 256


@pytest.fixture(scope="module")
def atlas() -> Atlas:
    return unwrap(*ball(3), SIZE)


@pytest.fixture(scope="module")
def textured(atlas: Atlas) -> TexturedMesh:
    vertices, faces = ball(3)
    texture = bake(vertices, faces, atlas, views_of_ball(24), np.full(vertices.shape, 0.5))
    return TexturedMesh(vertices=vertices, faces=faces, atlas=atlas, texture=texture)


def _difference(mesh: TexturedMesh, camera_index: int = 40) -> float:
    """Largest error, but for few pixels, in a view that the texture was not baked from, away from the outline."""
    camera = demo_cameras(1, 96, offset=camera_index)[0]
    truth = view_of_ball("new", camera)
    assert truth.alpha is not None
    inside = cv2.erode(truth.alpha.numpy(), np.ones((5, 5), np.uint8)) > 0
    error = np.abs(paint(mesh.vertices, mesh.faces, mesh, camera) - truth.rgb.numpy())[inside]
    return float(np.quantile(error, 0.99))


def test_charts_hold_every_face_once_and_apart(atlas: Atlas):
    _, faces = ball(3)
    assert (atlas.source[atlas.faces] == faces).all()
    assert atlas.uv.min() >= 0
    assert atlas.uv.max() <= 1
    corners = atlas.uv[atlas.faces]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    areas = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2
    # No face is squeezed flat, and together they fit into the square, as charts that overlap would not.
    assert areas.min() > 0.1 * np.median(areas)
    assert 0.3 < areas.sum() < 1


def test_new_views_look_right(textured: TexturedMesh):
    assert textured.texture.seen_share > 0.95
    assert _difference(textured) < 0.04


def test_seams_are_padded(textured: TexturedMesh):
    """A quarter of the size, as a viewer far away takes it, still shows no foreign colour at the seams."""
    atlas = textured.atlas
    small = cv2.resize(textured.texture.rgb, (atlas.width // 4, atlas.height // 4), interpolation=cv2.INTER_AREA)
    large = cv2.resize(small, (atlas.width, atlas.height), interpolation=cv2.INTER_LINEAR)
    shrunk = replace(textured, texture=replace(textured.texture, rgb=large))
    assert _difference(shrunk) < 0.15


def test_what_no_view_sees_keeps_the_mesh_colours(atlas: Atlas):
    vertices, faces = ball(3)
    views = views_of_ball(6, only_above=True)
    texture = bake(vertices, faces, atlas, views, np.tile([1.0, 0.0, 1.0], (len(vertices), 1)))
    assert 0.4 < texture.seen_share < 0.9
    mesh = TexturedMesh(vertices=vertices, faces=faces, atlas=atlas, texture=texture)
    below = paint(vertices, faces, mesh, _from_below())
    np.testing.assert_allclose(below[48, 48], [1, 0, 1], atol=0.02)


def _from_below() -> Camera:
    camera = demo_cameras(1, 96)[0]
    pose = np.diag([1.0, 1.0, 1.0, 1.0])
    pose[2, 3] = 4.0
    return replace(camera, world_to_camera=torch.from_numpy(pose))


def test_a_hand_before_the_object_is_outvoted(atlas: Atlas):
    """A black bar in three of many views, that no mask excludes."""
    vertices, faces = ball(3)
    views = views_of_ball(24)
    spoilt = []
    for index, view in enumerate(views):
        rgb = view.rgb.clone()
        if index in (3, 9, 15):
            rgb[40:60] = 0
        spoilt.append(replace(view, rgb=rgb))
    texture = bake(vertices, faces, atlas, spoilt, np.full(vertices.shape, 0.5))
    mesh = TexturedMesh(vertices=vertices, faces=faces, atlas=atlas, texture=texture)
    assert _difference(mesh) < 0.12


def test_hidden_surface_takes_no_colour_from_what_hides_it():
    """A plate before a wall: the wall's texture is the wall's colour, although most views see the plate there."""
    wall = trimesh.creation.box(extents=(2, 0.2, 2)).subdivide().subdivide()
    plate = trimesh.creation.box(extents=(0.7, 0.1, 0.7)).subdivide()
    plate.apply_translation([0, -0.6, 0])
    both = trimesh.util.concatenate([wall, plate])
    vertices, faces = np.array(both.vertices, np.float64), np.array(both.faces, np.int64)
    red, green = np.array([0.9, 0.1, 0.1]), np.array([0.1, 0.8, 0.2])
    colors = np.where(np.arange(len(vertices))[:, None] < len(wall.vertices), red, green)
    views = []
    for index, camera in enumerate(demo_cameras(30, 120)):
        rgb = paint(vertices, faces, colors, camera)
        alpha = (paint(vertices, faces, np.zeros_like(colors), camera).max(axis=2) < 0.01).astype(np.float32)
        views.append(
            View(name=str(index), camera=camera, rgb=torch.from_numpy(rgb).float(), alpha=torch.from_numpy(alpha))
        )
    atlas = unwrap(vertices, faces, SIZE)
    texture = bake(vertices, faces, atlas, views, colors)
    mesh = TexturedMesh(vertices=vertices, faces=faces, atlas=atlas, texture=texture)
    camera = demo_cameras(1, 120, offset=50)[0]
    truth = paint(vertices, faces, colors, camera)
    assert np.abs(paint(vertices, faces, mesh, camera) - truth).mean() < 0.01


@pytest.mark.parametrize("kind", ["glb", "obj"])
def test_another_library_reads_it_back(kind: str, textured: TexturedMesh, tmp_path: Path):
    path = tmp_path / f"ball.{kind}"
    if kind == "glb":
        write_textured_glb(path, textured)
    else:
        assert [p.name for p in write_textured_obj(path, textured)] == ["ball.obj", "ball.mtl", "ball.png"]
    mesh = next(iter(trimesh.load_scene(path, process=False).geometry.values()))
    assert len(mesh.faces) == len(textured.faces)
    material = mesh.visual.material
    image = np.asarray(material.baseColorTexture if kind == "glb" else material.image)[..., :3] / 255
    np.testing.assert_allclose(image, textured.texture.rgb.clip(0, 1), atol=0.5 / 255 + 1e-6)
    # trimesh has coordinates from the lower left, whatever the file has.
    uv = np.asarray(mesh.visual.uv)
    corners = np.asarray(mesh.vertices)[mesh.faces].mean(axis=1)
    places = uv[mesh.faces].mean(axis=1)
    columns = (places[:, 0] * image.shape[1]).astype(int).clip(0, image.shape[1] - 1)
    rows = ((1 - places[:, 1]) * image.shape[0]).astype(int).clip(0, image.shape[0] - 1)
    error = np.abs(image[rows, columns] - color_at(corners * 0.8 / np.linalg.norm(corners, axis=1, keepdims=True)))
    assert np.median(error) < 0.01
    # Faces that no photograph shows, at the very bottom, are the only ones that may differ.
    assert np.quantile(error.max(axis=1), 0.9) < 0.05


def test_obj_stays_closed(textured: TexturedMesh, tmp_path: Path):
    write_textured_obj(tmp_path / "a.obj", textured)
    lines = (tmp_path / "a.obj").read_text(encoding="utf-8").splitlines()
    assert sum(line.startswith("v ") for line in lines) == len(textured.vertices)
    with pytest.raises(ConfigError, match=r"my ball.obj: OBJ cannot name a material file with spaces"):
        write_textured_obj(tmp_path / "my ball.obj", textured)
    # Its own files are written again, but those of others stay.
    write_textured_obj(tmp_path / "a.obj", textured)
    (tmp_path / "photo.png").write_bytes(b"mine")
    with pytest.raises(OutputError, match=r"photo.png exists, and would be overwritten beside photo.obj"):
        write_textured_obj(tmp_path / "photo.obj", textured)
    assert (tmp_path / "photo.png").read_bytes() == b"mine"


def test_sizes_and_a_missing_library(monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(ConfigError, match=r"--texture-size is 3; expected 64 to 16384"):
        unwrap(*ball(1), 3)
    monkeypatch.setitem(__import__("sys").modules, "xatlas", None)
    with pytest.raises(ComponentImportError, match=r"pip install 'gaussian-sculpting\[texture\]'"):
        unwrap(*ball(1), SIZE)
