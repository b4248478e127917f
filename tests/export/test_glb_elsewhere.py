"""Our GLB files in other people's programs: Khronos' validator, and three.js in a browser.

pytest -m "slow or browser" tests/export; the screenshots are kept in outputs/export-tests.
"""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from elsewhere import page_of, served, validated
from small_scene import ball, color_at, views_of_ball

from sculpt_framework.demo_scenes.cameras import demo_cameras
from sculpt_framework.export.assets import TexturedMesh, write_textured_glb
from sculpt_framework.export.mesh_files import srgb_to_linear, write_mesh_glb
from sculpt_framework.export.pictures import paint
from sculpt_framework.export.texture import bake, unwrap
from tests.viewer.chromium import Chromium, Page

PICTURES = Path(__file__).parents[2] / "outputs" / "export-tests"
SIDE = 480


@pytest.fixture(scope="module")
def textured() -> TexturedMesh:
    pytest.importorskip("xatlas")
    vertices, faces = ball(3)
    atlas = unwrap(vertices, faces, 512)
    texture = bake(vertices, faces, atlas, views_of_ball(16, 128), np.full(vertices.shape, 0.5))
    return TexturedMesh(vertices=vertices, faces=faces, atlas=atlas, texture=texture)


@pytest.fixture(scope="module")
def folder(textured: TexturedMesh, tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("glb")
    vertices, faces = ball(3)
    write_textured_glb(root / "textured.glb", textured)
    write_mesh_glb(root / "colored.glb", vertices, faces, color_at(vertices))
    write_mesh_glb(root / "plain.glb", vertices, faces)
    return root


@pytest.mark.slow
@pytest.mark.parametrize("name", ["plain", "colored", "textured"])
def test_valid_to_the_validator_of_the_format(name: str, folder: Path):
    report = validated(folder, f"{name}.glb")
    assert report["info"]["version"] == "2.0"
    assert report["info"]["totalTriangleCount"] == len(ball(3)[1])
    found = [message for message in report["issues"]["messages"] if message["severity"] < 2]
    assert report["issues"]["numErrors"] == 0, found
    assert report["issues"]["numWarnings"] == 0, found


@pytest.fixture(scope="module")
def browser() -> Iterator[Chromium]:
    chromium = Chromium()
    yield chromium
    chromium.close()


@pytest.fixture(scope="module")
def site(folder: Path) -> Iterator[str]:
    with served(folder) as address:
        yield address


@pytest.mark.browser
@pytest.mark.parametrize("name", ["textured", "colored"])
def test_three_js_shows_what_we_draw(
    name: str, folder: Path, textured: TexturedMesh, site: str, browser: Chromium, request: pytest.FixtureRequest
):
    camera = demo_cameras(1, SIDE, offset=3)[0]
    (folder / f"{name}.html").write_text(page_of(camera, f"{name}.glb", SIDE), encoding="utf-8")
    page: Page = browser.open(f"{site}/{name}.html")
    request.addfinalizer(page.close)
    page.wait_for("drawn:")
    # Unlit where the photographs have the light in them.
    kind = "MeshBasicMaterial" if name == "textured" else "MeshStandardMaterial"
    assert page.text().strip().endswith(f"drawn: {kind}")
    data = page.screenshot(PICTURES / f"three-{name}.png")
    seen = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)[:SIDE, :SIDE, ::-1] / 255
    vertices, faces = ball(3)
    if name == "textured":
        ours = paint(vertices, faces, textured, camera)
    else:
        # glTF interpolates linear values.
        linear = paint(vertices, faces, srgb_to_linear(color_at(vertices)), camera)
        ours = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    error = np.abs(seen - ours).max(axis=2)
    object_ = (ours < 0.99).any(axis=2)
    assert 0.05 < object_.mean() < 0.5
    # All but the pixels of the outline, where two ways of antialiasing differ.
    assert np.quantile(error[object_], 0.95) < 0.03
    assert np.quantile(error, 0.99) < 0.03
