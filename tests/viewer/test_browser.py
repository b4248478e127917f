"""The page in a real browser, against a real training run. Screenshots are kept in outputs/viewer-tests.

pytest -m browser tests/viewer
"""

import json
import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from sculpt_framework.evaluation.geometry import MeasuredMesh
from sculpt_framework.evaluation.mesh import Mesh, load_mesh

from .chromium import Chromium, Page
from .training import STEPS, Run, eventually, train_words

pytestmark = pytest.mark.browser

PICTURES = Path(__file__).parents[2] / "outputs" / "viewer-tests"


@pytest.fixture(scope="module")
def chromium() -> Iterator[Chromium]:
    browser = Chromium()
    yield browser
    browser.close()


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory, chromium: Chromium) -> Iterator[Run]:
    run = Run(tmp_path_factory.mktemp("browser"), 7031)
    yield run
    run.kill()


@pytest.fixture(scope="module")
def joint(tmp_path_factory: pytest.TempPathFactory, chromium: Chromium) -> Iterator[Run]:
    """A run of one level: its steps tell of the constraints, which else work in the inner loop."""
    run = Run(tmp_path_factory.mktemp("joint"), 7032, "--trainer.no-gradient-isolation", steps=4000)
    yield run
    run.kill()


def exported(run: Run, page: Page) -> Mesh:
    """The mesh as it is now, by the button for it."""
    before = set((run.folder / "exports").glob("*.glb"))
    page.click("Export the mesh")
    eventually(lambda: len(set((run.folder / "exports").glob("*.glb")) - before) == 1)
    (path,) = set((run.folder / "exports").glob("*.glb")) - before
    return load_mesh(path.with_suffix(".ply"))


def gizmo_handle(page: Page) -> tuple[float, float]:
    """Where in the page one can take hold of the box: the middle of a red handle."""
    script = """
        let found = [];
        for (let y = 4; y < canvas.height - 4; y += 1) for (let x = 4; x < canvas.width - 4; x += 1) {
            let red = true;
            for (let dy = -3; dy <= 3 && red; dy += 3) for (let dx = -3; dx <= 3 && red; dx += 3) {
                const at = 4 * ((y + dy) * canvas.width + x + dx);
                red = data[at] > 235 && data[at + 1] < 90 && data[at + 2] > 60 && data[at + 2] < 140;
            }
            if (red) found.push([x, y]);
        }
        return found.length ? found[found.length >> 1] : null;
    """
    found = None
    deadline = time.monotonic() + 60.0
    while found is None:
        assert time.monotonic() < deadline, "there is no handle in the picture"
        found = of_picture(page, script)
    return found[0], found[1]


def of_picture(page: Page, script: str) -> Any:
    """What a script makes of the page as the browser has painted it, ``data`` in ``canvas``, without the panel."""
    around = """
        (async () => {
            const image = new Image();
            image.src = 'data:image/png;base64,' + DATA;
            await image.decode();
            const canvas = document.createElement('canvas');
            canvas.width = 1080; canvas.height = image.height;
            const context = canvas.getContext('2d');
            context.drawImage(image, 0, 0);
            const data = context.getImageData(0, 0, canvas.width, canvas.height).data;
            SCRIPT
        })()
    """
    picture = page.call("Page.captureScreenshot", format="png")["data"]
    return page.evaluate(around.replace("DATA", json.dumps(picture)).replace("SCRIPT", script))


def colored_share(page: Page) -> float:
    """The share of the 3D canvas that is not grey or white, of what the browser has painted."""
    script = """
        let found = 0;
        for (let at = 0; at < data.length; at += 4) {
            const low = Math.min(data[at], data[at + 1], data[at + 2]);
            if (Math.max(data[at], data[at + 1], data[at + 2]) - low > 30) found += 1;
        }
        return found / (data.length / 4);
    """
    return of_picture(page, script)


def test_the_page_shows_a_surface_that_grows(run: Run, chromium: Chromium):
    page = chromium.open(run.address)
    page.wait_for("of training:")
    eventually(lambda: colored_share(page) > 0.02)
    first = page.text()
    page.screenshot(PICTURES / "mesh.png")
    before = run.steps
    eventually(lambda: run.steps > before + 3)
    eventually(lambda: page.text() != first)
    for layer in ("Gaussians", "Wireframe", "Grid cells", "Reference mesh"):
        page.click(layer)
        eventually(lambda layer=layer: page.is_on(layer))
    time.sleep(3)
    page.screenshot(PICTURES / "layers.png")
    for layer in ("Mesh", "Wireframe", "Grid cells", "Reference mesh"):
        page.click(layer)
    eventually(lambda: not page.is_on("Mesh"))
    time.sleep(3)
    assert colored_share(page) > 0.02  # of the splats alone
    page.screenshot(PICTURES / "gaussians.png")
    page.click("Mesh")
    page.reload()
    page.wait_for("of training:")
    eventually(lambda: colored_share(page) > 0.02)
    outside = [url for url in page.requests if not url.startswith((run.address, "blob:", "data:"))]
    assert outside == []
    page.close()


def test_pausing_stops_steps_and_going_on_takes_them_up(run: Run, chromium: Chromium):
    page = chromium.open(run.address)
    page.wait_for("Steer")
    page.click("Steer")
    page.click("Pause")
    eventually(lambda: {"do": "pause"} in run.commands)
    time.sleep(1.0)
    before = run.steps
    time.sleep(5.0)
    assert run.steps == before
    page.click("Plan")
    page.wait_for("action: paused")
    page.click("Steer")
    page.click("Go on")
    eventually(lambda: run.steps > before)
    page.close()


def test_weights_and_rates_have_their_effect(run: Run, chromium: Chromium):
    page = chromium.open(run.address)
    page.wait_for("Steer")
    page.click("Steer")
    assert run.wait_for_steps(1)[0]["terms"]["eikonal"] > 0
    page.unfold("Weights", "eikonal")
    page.fill("eikonal", 0)
    run.wait_for_command(do="set-weight", slot="losses", name="eikonal", weight=0.0)
    assert all(step["terms"]["eikonal"] == 0 for step in run.wait_for_steps(2))
    page.unfold("Learning rates", "Of the gaussians, times")
    page.fill("Of the gaussians, times", 0.5)
    run.wait_for_command(do="set-rate", part="gaussians", factor=0.5)
    page.fill("Of the surface, times", 0)
    run.wait_for_command(do="set-rate", part="surface", factor=0.0)
    run.wait_for_steps(1)
    first = exported(run, page)
    run.wait_for_steps(2)
    np.testing.assert_array_equal(exported(run, page).vertices, first.vertices)
    page.fill("Of the surface, times", 1)
    run.wait_for_command(do="set-rate", part="surface", factor=1.0)
    run.wait_for_steps(2)
    assert not np.array_equal(exported(run, page).vertices, first.vertices)
    page.screenshot(PICTURES / "weights.png")
    page.close()


def test_a_box_that_is_dragged_refines_freezes_and_ignores(run: Run, chromium: Chromium):
    page = chromium.open(run.address)
    page.wait_for("Steer")
    if not page.is_on("Gaussians"):
        page.click("Gaussians")
    page.click("Steer")
    page.click("Place a box")
    page.wait_for("Refine here")
    page.click("Scene")
    eventually(lambda: not page.is_on("Gaussians"))  # they would be painted over its handles
    page.click("Steer")
    run.wait_for_steps(1)
    page.screenshot(PICTURES / "box.png")
    before = run.last_faces()
    page.click("Refine here")
    placed = run.wait_for_command(do="add-box", kind="refine")
    eventually(lambda: run.last_faces() > 1.05 * before)
    page.click("Take all boxes back")
    run.wait_for_command(do="clear-boxes")
    eventually(lambda: run.last_faces() < 1.02 * before)

    page.drag(*gizmo_handle(page), right=60, down=-40)
    page.fill("Sides", 5, 6, 7)  # more than the whole object
    page.click("Freeze here")
    frozen = run.wait_for_command(do="add-box", kind="freeze")
    sides, moved = [np.subtract(frozen["maximum"], frozen["minimum"]), middle(frozen) - middle(placed)]
    np.testing.assert_allclose(sides, [5, 6, 7])
    assert np.abs(moved).max() > 0.02
    run.wait_for_steps(1)
    first = exported(run, page)
    run.wait_for_steps(3)
    distance = np.sqrt(MeasuredMesh(first, samples=1).squared_distances(exported(run, page).vertices)[0])
    assert distance.max() < 1e-4 * run.cell
    page.click("Ignore here")
    run.wait_for_command(do="add-box", kind="ignore", minimum=frozen["minimum"], maximum=frozen["maximum"])
    page.click("Take all boxes back")
    page.click("Plan")
    page.wait_for("action: ignore in the box")
    page.screenshot(PICTURES / "plan.png")
    page.close()


def middle(box: dict) -> np.ndarray:
    return 0.5 * np.add(box["minimum"], box["maximum"])


def test_cameras_and_plots(run: Run, chromium: Chromium):
    page = chromium.open(run.address)
    page.wait_for("Cameras")
    page.click("Cameras")
    page.wait_for("views to learn from")
    eventually(lambda: colored_share(page) > 0.02)
    page.click("Look from there")
    page.wait_for("mean difference")
    time.sleep(2.0)
    page.screenshot(PICTURES / "cameras.png")
    page.click("Plots")
    page.wait_for("Loss against training time")
    page.screenshot(PICTURES / "plots.png")
    page.close()


def test_a_camera_that_is_clicked_is_looked_from(run: Run, chromium: Chromium):
    page = chromium.open(run.address)
    page.click("Cameras")
    page.wait_for("train/r_0: mean difference")
    page.click("Show cameras")
    for _ in range(5):
        page.turn_wheel(540, 475, 300)
        time.sleep(0.2)
    time.sleep(3.0)
    page.screenshot(PICTURES / "frustums.png")
    # Wherever in the picture there is one: around the object, out from the middle.
    places = [(540 + dx, 475 + dy) for dx in range(-500, 501, 25) for dy in range(-400, 401, 25)]
    for x, y in sorted(places, key=lambda place: abs(np.hypot(place[0] - 540, place[1] - 475) - 250)):
        page.press(x, y)
        time.sleep(0.1)
        if re.search(r"train/r_[1-9]\d*:", page.text()):
            break
    eventually(lambda: re.search(r"train/r_[1-9]\d*: mean difference", page.text()) is not None)
    page.close()


def test_two_browsers_show_the_same_and_one_that_crashes_leaves_the_other_alone(run: Run, chromium: Chromium):
    page = chromium.open(run.address)
    page.wait_for("of training:")
    other = Chromium()
    second = other.open(run.address)
    second.wait_for("of training:")
    eventually(lambda: colored_share(second) > 0.02)
    second.click("Wireframe")
    eventually(lambda: page.is_on("Wireframe"))
    assert colored_share(page) > 0.02
    other.kill()
    second.forget()
    other.close()
    before = run.steps
    eventually(lambda: run.steps > before + 2)
    assert run.process.poll() is None
    eventually(lambda: f"Step {run.steps}" in page.text())
    page.close()


def test_a_port_that_is_taken_is_one_line(run: Run, tmp_path: Path):
    words = train_words(tmp_path / "run", port=7031)
    done = subprocess.run(words, capture_output=True, text=True, timeout=300, check=False, encoding="utf-8")
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1
    assert "cannot listen on 127.0.0.1:7031" in done.stderr
    assert "choose another --observers.viser.port" in done.stderr


def test_stop_and_save_ends_the_run_with_a_mesh(run: Run, chromium: Chromium):
    page = chromium.open(run.address)
    page.wait_for("Steer")
    page.click("Steer")
    page.click("Stop and save")
    eventually(lambda: run.process.poll() is not None)
    assert run.process.returncode == 0, run.log.read_text(encoding="utf-8")
    assert run.steps < STEPS
    assert json.loads((run.folder / "metrics.json").read_text(encoding="utf-8"))["status"] == "stopped"
    assert (run.folder / "mesh.ply").is_file()
    page.close()


def test_a_constraint_can_be_left_out_and_taken_in_again(joint: Run, chromium: Chromium):
    page = chromium.open(joint.address)
    page.wait_for("Steer")
    page.click("Steer")
    page.unfold("Constraints", "mee-scale")
    assert "mee-scale" in joint.wait_for_steps(1)[0]["terms"]
    for on in (False, True):
        page.click("mee-scale")
        joint.wait_for_command(do="switch-constraint", name="mee-scale", on=on)
        assert all(("mee-scale" in step["terms"]) is on for step in joint.wait_for_steps(2))
    page.close()


def test_a_killed_run_can_be_looked_at(joint: Run, chromium: Chromium):
    run = joint
    eventually(lambda: run.steps >= 100)  # before that, nothing has a colour
    eventually(lambda: any((run.folder / "evolution").glob("*.npz")))
    run.kill()
    os.utime(run.folder / "events.jsonl", (1e9, 1e9))
    words = [sys.executable, "-m", "sculpt_framework.cli.view", str(run.folder), "--port", "7033"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True, encoding="utf-8") as view:
        try:
            assert view.stdout is not None
            assert view.stdout.readline().strip() == "http://127.0.0.1:7033"
            page = chromium.open("http://127.0.0.1:7033")
            page.wait_for("killed")
            eventually(lambda: colored_share(page) > 0.02)
            page.screenshot(PICTURES / "killed.png")
            assert "Steer" not in page.text()
            page.close()
        finally:
            view.terminate()


def test_a_page_in_one_file_plays(tmp_path: Path, chromium: Chromium):
    from sculpt_framework.viewing.html import write_html

    from .runs import make_run

    out = tmp_path / "evolution.html"
    write_html(make_run(tmp_path), out)
    page = chromium.open(out.as_uri())
    eventually(lambda: colored_share(page) > 0.01)
    page.screenshot(PICTURES / "html.png")
    assert [url for url in page.requests if url.startswith(("http", "ws"))] == []
    page.close()
