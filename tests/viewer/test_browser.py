"""The page in a real browser, against a real training run. Screenshots are kept in outputs/viewer-tests.

pytest -m browser tests/viewer
"""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from .chromium import Chromium, Page

pytestmark = pytest.mark.browser

PICTURES = Path(__file__).parents[2] / "outputs" / "viewer-tests"
STEPS = 100_000
"""More than any test waits for: a run ends when it is told to."""


def eventually(condition: Callable[[], bool], seconds: float = 180.0) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.1)


class Run:
    """A training process with a viewer on a port of its own."""

    def __init__(self, folder: Path, port: int, steps: int = STEPS):
        self.folder = folder / "run"
        self.address = f"http://127.0.0.1:{port}"
        self.log = folder / "log.txt"
        words = ["gaussian-sculpting-tiny", "--data", "demo", "--output", str(self.folder), "--threads", "1"]
        words += ["--viewer", "--observers.viser.port", str(port), "--observers.viser.seconds", "0.5"]
        words += ["--observers.recorder.step-seconds", "0", "--trainer.outer-steps", str(steps)]
        script = "from sculpt_framework.cli.train import main; main()"
        with open(self.log, "wb") as log:
            self.process = subprocess.Popen([sys.executable, "-c", script, *words], stdout=log, stderr=log)
        eventually(lambda: "viewer at" in self.log.read_text() or self.process.poll() is not None)
        assert self.process.poll() is None, self.log.read_text()

    @property
    def events(self) -> list[dict]:
        path = self.folder / "events.jsonl"
        text = path.read_text() if path.exists() else ""
        return [json.loads(line) for line in text[: text.rfind("\n") + 1].splitlines()]

    @property
    def steps(self) -> int:
        return max((event["outer"] for event in self.events if event["event"] == "outer_step"), default=0)

    @property
    def commands(self) -> list[dict]:
        return [event["data"]["command"] for event in self.events if "command" in event["data"]]

    def last_faces(self) -> int:
        return [event["data"]["faces"] for event in self.events if event["event"] == "outer_step"][-1]

    def kill(self) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGKILL)
        self.process.wait()


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


def colored_share(page: Page) -> float:
    """The share of the 3D canvas that is not grey or white, of what the browser has painted."""
    script = """
        (async () => {
            const image = new Image();
            image.src = 'data:image/png;base64,' + DATA;
            await image.decode();
            const canvas = document.createElement('canvas');
            canvas.width = 900; canvas.height = image.height;
            const context = canvas.getContext('2d');
            context.drawImage(image, 0, 0);
            const data = context.getImageData(0, 0, canvas.width, canvas.height).data;
            let found = 0;
            for (let at = 0; at < data.length; at += 4) {
                const low = Math.min(data[at], data[at + 1], data[at + 2]);
                if (Math.max(data[at], data[at + 1], data[at + 2]) - low > 30) found += 1;
            }
            return found / (data.length / 4);
        })()
    """
    data = page.call("Page.captureScreenshot", format="png")["data"]
    return page.evaluate(script.replace("DATA", json.dumps(data)))


def test_the_page_shows_a_surface_that_grows(run: Run, chromium: Chromium):
    page = chromium.open(run.address)
    page.wait_for("of training:")
    eventually(lambda: colored_share(page) > 0.02)
    first = page.text()
    page.screenshot(PICTURES / "mesh.png")
    before = run.steps
    eventually(lambda: run.steps > before + 3)
    eventually(lambda: page.text() != first)
    page.click("Gaussians")
    time.sleep(3)
    assert colored_share(page) > 0.02
    page.screenshot(PICTURES / "gaussians.png")
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
    page.screenshot(PICTURES / "plan.png")
    page.click("Steer")
    page.click("Go on")
    eventually(lambda: run.steps > before)
    page.close()


def test_a_refined_box_gets_more_triangles(run: Run, chromium: Chromium):
    page = chromium.open(run.address)
    page.wait_for("Steer")
    page.click("Steer")
    page.click("Place a box")
    page.wait_for("Refine here")
    time.sleep(2.0)
    page.screenshot(PICTURES / "box.png")
    before = run.last_faces()
    page.click("Refine here")
    eventually(lambda: any(command["do"] == "add-box" for command in run.commands))
    eventually(lambda: run.last_faces() > 1.05 * before)
    page.close()


def test_cameras_plots_and_an_export(run: Run, chromium: Chromium):
    page = chromium.open(run.address)
    page.wait_for("Cameras")
    page.click("Cameras")
    page.wait_for("views to learn from")
    page.click("Look from there")
    page.wait_for("mean difference")
    time.sleep(2.0)
    page.screenshot(PICTURES / "cameras.png")
    page.click("Plots")
    page.wait_for("Loss against training time")
    page.screenshot(PICTURES / "plots.png")
    page.click("Steer")
    page.click("Export the mesh")
    eventually(lambda: len(list((run.folder / "exports").glob("*.glb"))) == 1)
    page.close()


def test_a_browser_that_crashes_leaves_the_run_and_the_others_alone(run: Run, chromium: Chromium):
    page = chromium.open(run.address)
    page.wait_for("of training:")
    other = Chromium()
    second = other.open(run.address)
    second.wait_for("of training:")
    other.kill()
    second.forget()
    other.close()
    before = run.steps
    eventually(lambda: run.steps > before + 2)
    assert run.process.poll() is None
    eventually(lambda: f"Step {run.steps}" in page.text())
    page.close()


def test_stop_and_save_ends_the_run_with_a_mesh(run: Run, chromium: Chromium):
    page = chromium.open(run.address)
    page.wait_for("Steer")
    page.click("Steer")
    page.click("Stop and save")
    eventually(lambda: run.process.poll() is not None)
    assert run.process.returncode == 0, run.log.read_text()
    assert run.steps < STEPS
    assert json.loads((run.folder / "metrics.json").read_text())["status"] == "stopped"
    assert (run.folder / "mesh.ply").is_file()
    page.close()


def test_a_killed_run_can_be_looked_at(tmp_path: Path, chromium: Chromium):
    run = Run(tmp_path, 7032, steps=4000)
    eventually(lambda: run.steps >= 100)  # before that, nothing has a colour
    eventually(lambda: any((run.folder / "evolution").glob("*.npz")))
    run.kill()
    os.utime(run.folder / "events.jsonl", (1e9, 1e9))
    words = [sys.executable, "-m", "sculpt_framework.cli.view", str(run.folder), "--port", "7033"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as view:
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
