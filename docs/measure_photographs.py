"""What many large photographs cost: the peak of memory, and the seconds from the command to the first steps.

    python docs/measure_photographs.py [--photographs 300] [--width 4000 --height 3000] [--background paper|room]
                                       [--method M] [--steps N] [--folder DIR] [-- OPTIONS OF sculpt-train]

Photographs of a demo object are made, JPEGs with a sensor's noise and cameras in ``transforms.json``, into DIR if it
is given and else into a temporary folder; those that are there already are used. Then ``sculpt-train`` is run on them
for a few steps. Before a sheet of paper the background is keyed out; before a room the object is cut out.

The first step of the colours comes when the photographs are read and a surface to start from is made, the first of that
surface when its colours are warmed up. Memory is the resident set of the process at its largest, as the system counts
it. Compiled kernels are kept from run to run, so the first run on a machine takes longer.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from sculpt_framework.cores import usable_cores
from sculpt_framework.demo_scenes.cameras import demo_cameras
from sculpt_framework.demo_scenes.objects import DEFAULT, OBJECTS
from sculpt_framework.demo_scenes.tracing import render
from sculpt_framework.export.atomic import write_atomically
from sculpt_framework.types import Camera

RENDERED = 240
"""Rows that are rendered before a picture is enlarged: what matters here is how many pixels it has."""
NOISE = 8.0
"""Standard deviation, of 255; it makes the files as large as those of a camera."""
QUALITY = 92
PAPER = (214, 218, 216)
OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])


@dataclass(frozen=True, kw_only=True)
class Cost:
    first_inner: float
    """Seconds from the start of the process to the first step of the colours."""
    first_outer: float
    """The same to the end of the first step of the surface."""
    whole: float
    """Seconds, saving and measuring included."""
    peak_bytes: int


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--photographs", type=int, default=300)
    parser.add_argument("--width", type=int, default=4000)
    parser.add_argument("--height", type=int, default=3000)
    parser.add_argument("--background", choices=("paper", "room"), default="paper")
    parser.add_argument("--method", default="gaussian-sculpting")
    parser.add_argument("--steps", type=int, default=8, help="outer steps of the run")
    parser.add_argument("--folder", type=Path, help="where the photographs are kept")
    options, rest = parser.parse_known_args()
    with tempfile.TemporaryDirectory() as aside:
        folder = options.folder or Path(aside) / "photographs"
        take_photographs(folder, options.photographs, options.width, options.height, options.background)
        size = sum(path.stat().st_size for path in (folder / "images").iterdir())
        words = [options.method, "--data", str(folder), "--output", str(Path(aside) / "run")]
        words += ["--steps", str(options.steps), *(word for word in rest if word != "--")]
        cost = run(words, Path(aside) / "run")
    sys.stdout.write(
        f"{options.photographs} photographs of {options.width}x{options.height} before a {options.background}, "
        f"{size / 2**30:.2f} GiB on disk, {usable_cores()} cores: first step of "
        f"the colours after {cost.first_inner:.1f} s, of the surface after {cost.first_outer:.1f} s, {options.steps} "
        f"steps and saving {cost.whole:.1f} s, peak memory "
        f"{cost.peak_bytes / 2**30:.2f} GiB\n"
    )
    return 0


def take_photographs(folder: Path, count: int, width: int, height: int, background: str) -> None:
    """JPEGs and ``transforms.json`` in a folder; the file with the cameras comes last."""
    if (folder / "transforms.json").is_file():
        return
    (folder / "images").mkdir(parents=True, exist_ok=True)
    # Noise of a size that no two photographs have in the same place.
    noise = np.random.default_rng(0).normal(0, NOISE, (height + 97, width + 89, 3)).astype(np.int16)
    small = [_wide(camera, width, height) for camera in demo_cameras(count, RENDERED)]
    with ThreadPoolExecutor(max_workers=usable_cores()) as pool:
        work = [
            pool.submit(_take, folder / "images" / f"photo_{index:04d}.jpg", camera, (width, height), background, noise)
            for index, camera in enumerate(small)
        ]
        for job in work:
            job.result()
    frames = []
    for index, camera in enumerate(small):
        full = camera.resized(width, height)
        frames.append(
            {
                "file_path": f"images/photo_{index:04d}.jpg",
                "transform_matrix": (np.linalg.inv(camera.world_to_camera.numpy()) @ OPENGL).tolist(),
                **{"fl_x": full.fx, "fl_y": full.fy, "cx": full.cx, "cy": full.cy, "w": width, "h": height},
            }
        )
    write_atomically(folder / "transforms.json", json.dumps({"frames": frames}).encode())


def _wide(camera: Camera, width: int, height: int) -> Camera:
    """The same view in the shape of a photograph."""
    columns = round(camera.height * width / height)
    return replace(camera, width=columns, cx=columns / 2)


def _take(path: Path, camera: Camera, size: tuple[int, int], background: str, noise: np.ndarray) -> None:
    if path.is_file():
        return
    seed = np.random.default_rng(int(path.stem.rpartition("_")[2]))
    rgb, alpha = render(OBJECTS[DEFAULT], camera)
    behind = np.full(rgb.shape, PAPER, np.float32)
    if background == "room":
        # A cold wall with darker and lighter patches, another part of it in each photograph.
        patches = seed.integers(30, 130, (5, 7, 1)).astype(np.float32) + np.array([0, 20, 60], np.float32)
        behind = cv2.resize(patches, rgb.shape[1::-1], interpolation=cv2.INTER_LINEAR)
    mixed = 255 * rgb * alpha[..., None] + behind * (1 - alpha[..., None])
    large = cv2.resize(np.rint(mixed[..., ::-1]).astype(np.uint8), size, interpolation=cv2.INTER_LINEAR)
    row, column = seed.integers(0, 97), seed.integers(0, 89)
    pixels = cv2.add(large, noise[row : row + size[1], column : column + size[0]], dtype=cv2.CV_8U)
    done, data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    if not done:
        raise ValueError("the picture cannot be encoded")
    write_atomically(path, data.tobytes())


def run(words: list[str], output: Path) -> Cost:
    """``sculpt-train`` with these words, watched until it ends. Raises RuntimeError where it fails."""
    started = time.monotonic()
    process = subprocess.Popen([sys.executable, "-m", "sculpt_framework.cli.train", *words])
    _, status, usage = os.wait4(process.pid, 0)
    whole = time.monotonic() - started
    if os.waitstatus_to_exitcode(status) != 0:
        raise RuntimeError(f"sculpt-train {' '.join(words)} did not get to its end")
    unit = 1 if sys.platform == "darwin" else 1024
    # Wall seconds count from the start of the process.
    events = [json.loads(line) for line in (output / "events.jsonl").read_text(encoding="utf-8").splitlines()]
    stage, step = (
        next(event["t_wall"] for event in events if event["event"] == kind) for kind in ("stage", "outer_step")
    )
    return Cost(first_inner=stage, first_outer=step, whole=whole, peak_bytes=usage.ru_maxrss * unit)


if __name__ == "__main__":
    sys.exit(main())
