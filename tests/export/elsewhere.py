"""GLB files in other people's programs: Khronos' validator, and three.js in a browser.

    python tests/export/elsewhere.py RUN_DIR=FILE.glb [RUN_DIR=FILE.glb ...] --out FOLDER

says of each file what the validator says, and leaves a screenshot of three.js from the run's first test camera, for
files that were written with --up Y, so that they are not turned.
"""

import functools
import json
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import numpy as np

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).parents[2]))

from npm import install

from sculpt_framework.engine.run import load_finished
from sculpt_framework.types import Camera
from tests.viewer.chromium import Chromium

VALIDATOR, THREE = ("gltf-validator", "2.0.0-dev.3.10"), ("three", "0.187.0")
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


def validated(folder: Path, name: str) -> dict[str, Any]:
    """The validator's report on a file in a folder, which its package is put into."""
    install(folder, *VALIDATOR)
    script = folder / "validate.cjs"
    script.write_text(_VALIDATE, encoding="utf-8")
    words = ["node", script, folder / name]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=120, check=True, encoding="utf-8")
    return json.loads(done.stdout)


@contextmanager
def served(folder: Path) -> Iterator[str]:
    """Address of a server of the folder, with three.js in it."""
    install(folder, *THREE)

    class Quiet(SimpleHTTPRequestHandler):
        def log_message(self, format: str, *args: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=str(folder)))
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def page_of(camera: Camera, file: str, side: int) -> str:
    """HTML that draws a file in the served folder as the camera sees it, and says when it has."""
    pose = np.linalg.inv(camera.world_to_camera.double().numpy()) @ np.diag([1.0, -1.0, -1.0, 1.0])
    field = np.degrees(2 * np.arctan(0.5 * camera.height / camera.fy))
    values = {"SIDE": side, "FIELD": field, "POSE": pose.ravel().tolist(), "FILE": f"/{file}"}
    text = _PAGE
    for name, value in values.items():
        text = text.replace(name, str(value))
    return text


def main() -> None:
    *pairs, option, out = sys.argv[1:]
    assert option == "--out", __doc__
    with tempfile.TemporaryDirectory() as name:
        folder, browser = Path(name), Chromium()
        with served(folder) as site:
            for pair in pairs:
                run, file = map(Path, pair.split("="))
                shutil.copy(file, folder)
                issues = validated(folder, file.name)["issues"]
                camera = load_finished(run).scene.test[0].camera
                (folder / "page.html").write_text(page_of(camera, file.name, 800), encoding="utf-8")
                page = browser.open(f"{site}/page.html")
                began = time.monotonic()
                page.wait_for("drawn:")
                picture = Path(out) / f"{file.stem}.png"
                page.screenshot(picture)
                sys.stdout.write(
                    f"{file}: {issues['numErrors']} errors, {issues['numWarnings']} warnings; "
                    f"drawn within {time.monotonic() - began:.0f} s, see {picture}\n"
                )
                page.close()
        browser.close()


if __name__ == "__main__":
    main()
