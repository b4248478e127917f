"""Stands in for sculpt-train: leaves a run directory as it does, in no time. The seed says what becomes of the run.

0 to 9    finishes; the Chamfer distance follows from the words
10        is refused with a line of error, exit code 2
11        ends with a traceback
12        is killed
13        leaves a checkpoint and goes on until it is interrupted; finishes when it is resumed
14        finishes if another run of this seed is there at the same time
15        leaves a checkpoint and is killed; refuses to be resumed, and finishes when it starts a second time
16        finishes, but keeps no record of it

Data with a file ``refused`` in their folder are; of data with ``result.ply`` that is the mesh.
"""

import json
import os
import shutil
import signal
import sys
import time
from pathlib import Path

CURVE = (
    "t_train_s,t_wall_s,t_cpu_s,outer,inner,faces,gaussians,grid,rss_mb,psnr,ssim,iou,chamfer_ps,fscore,"
    "normal_consistency,under10_pct\n"
)


def main() -> None:
    words = sys.argv[1:]
    resumed = "--resume" in words
    folder = Path(words[words.index("--resume" if resumed else "--output") + 1])
    folder.mkdir(parents=True, exist_ok=True)
    root = next(above for above in folder.parents if (above / "matrix.json").exists())
    with open(root / "started.txt", "a", encoding="utf-8") as started:
        started.write(" ".join(words) + "\n")
    if resumed:
        words = json.loads((folder / "config.json").read_text(encoding="utf-8"))["words"]
    seed = int(words[words.index("--seed") + 1]) if "--seed" in words else 0
    config = {"method": words[0], "data": words[2], "seed": seed, "words": words}
    (folder / "config.json").write_text(json.dumps(config), encoding="utf-8")
    act(10 if Path(words[2], "refused").exists() else seed, folder, root, resumed)
    if Path(words[2], "result.ply").exists():
        shutil.copy(Path(words[2], "result.ply"), folder / "mesh.ply")
    finish(folder, "finished", words)


def act(seed: int, folder: Path, root: Path, resumed: bool) -> None:
    if seed == 10:
        sys.stderr.write("warming to the task\nerror: the data are no good\n")
        sys.exit(2)
    if seed == 11:
        raise RuntimeError("a fault of ours")
    if seed == 12:
        os.kill(os.getpid(), signal.SIGKILL)
    if seed == 13 and not resumed:
        checkpoint(folder)
        wait_for_interrupt(folder)
    if seed == 16:
        sys.exit(0)
    if seed == 14:
        meet(folder, root)
    if seed == 17 and resumed:
        sys.stderr.write("error: --device cuda: there is none here today\n")
        sys.exit(2)
    if seed == 17:
        checkpoint(folder)
        os.kill(os.getpid(), signal.SIGKILL)
    if seed == 15 and resumed:
        sys.stderr.write("error: the checkpoint is damaged\n")
        sys.exit(2)
    if seed == 15 and not list(folder.parent.glob("*.aside-*")):
        checkpoint(folder)
        os.kill(os.getpid(), signal.SIGKILL)


def checkpoint(folder: Path) -> None:
    (folder / "checkpoints").mkdir()
    (folder / "checkpoints" / "latest.safetensors").touch()


def wait_for_interrupt(folder: Path) -> None:
    def stop(number: int, frame: object) -> None:
        finish(folder, "stopped", ["x"])
        sys.exit(0)

    signal.signal(signal.SIGINT, stop)
    (folder / "ready").touch()
    time.sleep(60)


def meet(folder: Path, root: Path) -> None:
    (folder / "here").touch()
    deadline = time.monotonic() + 20
    while len(list(root.glob("runs/**/here"))) < 2:
        if time.monotonic() > deadline:
            sys.stderr.write("error: alone\n")
            sys.exit(2)
        time.sleep(0.02)


def finish(folder: Path, status: str, words: list[str]) -> None:
    chamfer = chamfer_of(words)
    final = {"chamfer_ps": chamfer, "psnr": 30.0, "fscore": 0.5, "faces": 1000, "outer": 7, "t_train_s": 3.0}
    (folder / "curve.csv").write_text(
        CURVE + f"3,4,5,7,28,1000,1000,32,100,30,0.9,0.95,{chamfer},0.5,0.99,0.1\n", encoding="utf-8"
    )
    (folder / "metrics.json").write_text(json.dumps({"status": status, "final": final}), encoding="utf-8")


def chamfer_of(words: list[str]) -> float:
    """0.01 for the method as it is; each change has a factor, the seed adds a percent."""
    seed = int(words[words.index("--seed") + 1]) if "--seed" in words else 0
    factors = {"--constraints": 2.0, "--field": 3.0, "--trainer.no-gradient-isolation": 5.0, "learnable": 7.0}
    value = 0.01 * (1 + 0.01 * seed)
    for word, factor in factors.items():
        value *= factor if word in words else 1.0
    return value


if __name__ == "__main__":
    main()
