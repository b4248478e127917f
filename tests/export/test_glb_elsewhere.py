"""Our GLB files in other people's programs: Khronos' validator, and three.js in a browser.

pytest -m "slow or browser" tests/export; the screenshots are kept in outputs/export-tests.
"""

import functools
import json
import subprocess
import threading
from collections.abc import Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import cv2
import numpy as np
import pytest
from npm import install
from small_scene import ball, color_at, views_of_ball

from sculpt_framework.demo_scenes.cameras import demo_cameras
from sculpt_framework.export.assets import TexturedMesh, write_textured_glb
from sculpt_framework.export.mesh_files import srgb_to_linear, write_mesh_glb
from sculpt_framework.export.pictures import paint
from sculpt_framework.export.texture import bake, unwrap
from sculpt_framework.types import Camera
from tests.viewer.chromium import Chromium, Page

PICTURES = Path(__file__).parents[2] / "outputs" / "export-tests"
SIDE = 480
_VALIDATE = """
    const bytes = new Uint8Array(require('fs').readFileSync(process.argv[2]));
    require('gltf-validator').validateBytes(bytes).then(report => console.log(JSON.stringify(report)));
"""
_PAGE = """<!doctype html>
<style>body { margin: 0; background: #fff } canvas { display: block }</style>
<script type="importmap">{"imports": {
    "three": "/node_modules/three/build/three.module.js", "three/addons/": "/node_modules/three/examples/jsm/"
}}</script>
<script type="module">
    import * as THREE from 'three';
    import { GLTFLoader } from 'three/addons/loaders/GLTFLoader.js';
    const renderer = new THREE.WebGLRenderer({ antialias: true });
    renderer.setSize(SIDE, SIDE);
    renderer.setClearColor(0xffffff);
    document.body.append(renderer.domElement);
    const camera = new THREE.PerspectiveCamera(FIELD, 1, 0.1, 100);
    camera.matrixAutoUpdate = false;
    camera.matrix.set(...POSE);
    camera.updateMatrixWorld(true);
    const scene = new THREE.Scene();
    // Light from everywhere: what is not unlit then shows its own colour, too.
    scene.add(new THREE.AmbientLight(0xffffff, Math.PI));
    new GLTFLoader().load('FILE', asset => {
        scene.add(asset.scene);
        renderer.render(scene, camera);
        const kinds = [];
        asset.scene.traverse(each => { if (each.isMesh) kinds.push(each.material.type); });
        document.body.append('drawn: ' + kinds.join(', '));
    }, undefined, error => document.body.append('drawn: nothing, ' + error));
</script>
"""


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
    install(folder, "gltf-validator", "2.0.0-dev.3.10")
    script = folder / "validate.cjs"
    script.write_text(_VALIDATE)
    words = ["node", script, folder / f"{name}.glb"]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=120, check=True)
    report = json.loads(done.stdout)
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
    """Address of a server of the folder, with three.js in it."""
    install(folder, "three", "0.187.0")

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, format: str, *args: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(folder)))
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    thread.join()
    server.server_close()


def _page(camera: Camera, file: str) -> str:
    pose = np.linalg.inv(camera.world_to_camera.double().numpy()) @ np.diag([1.0, -1.0, -1.0, 1.0])
    field = np.degrees(2 * np.arctan(0.5 * camera.height / camera.fy))
    values = {"SIDE": SIDE, "FIELD": field, "POSE": pose.ravel().tolist(), "FILE": f"/{file}"}
    text = _PAGE
    for name, value in values.items():
        text = text.replace(name, str(value))
    return text


@pytest.mark.browser
@pytest.mark.parametrize("name", ["textured", "colored"])
def test_three_js_shows_what_we_draw(
    name: str, folder: Path, textured: TexturedMesh, site: str, browser: Chromium, request: pytest.FixtureRequest
):
    camera = demo_cameras(1, SIDE, offset=3)[0]
    (folder / f"{name}.html").write_text(_page(camera, f"{name}.glb"))
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
