"""Stands in for sculpt-train in a batch: leaves a run directory as it does, in no time. The scene's name decides:

broken*    is refused with a line of error, exit code 2
killed*    leaves a checkpoint and is killed; finishes when it is resumed
crash*     ends with a traceback, every time
waits*     leaves a checkpoint and goes on until it is interrupted; finishes when it is resumed
others     finish
"""

import json
import os
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
    name = folder.name
    sys.stdout.write(f"threads {os.environ.get('OMP_NUM_THREADS')} devices {os.environ.get('CUDA_VISIBLE_DEVICES')}\n")
    sys.stdout.flush()
    (folder / "config.json").write_text(
        json.dumps({"method": "gaussian-sculpting-tiny", "data": name, "seed": 0}), encoding="utf-8"
    )
    if name.startswith("broken"):
        sys.stderr.write("error: the data are no good\n")
        sys.exit(2)
    if name.startswith("crash"):
        raise RuntimeError("a fault of ours")
    if name.startswith(("killed", "waits")) and not resumed:
        (folder / "checkpoints").mkdir()
        (folder / "checkpoints" / "latest.safetensors").touch()
        if name.startswith("killed"):
            os.kill(os.getpid(), signal.SIGKILL)
        wait_for_interrupt(folder)
    finish(folder, "finished")


def wait_for_interrupt(folder: Path) -> None:
    def stop(number: int, frame: object) -> None:
        finish(folder, "stopped")
        sys.exit(0)

    signal.signal(signal.SIGINT, stop)
    (folder / "ready").write_text(str(os.getpid()), encoding="utf-8")
    time.sleep(60)


def finish(folder: Path, status: str) -> None:
    final = {"chamfer_ps": 0.01, "psnr": 30.0, "fscore": 0.5, "faces": 1000, "outer": 7, "t_train_s": 3.0}
    (folder / "mesh.ply").touch()
    (folder / "curve.csv").write_text(
        CURVE + "3,4,5,7,28,1000,1000,32,100,30,0.9,0.95,0.01,0.5,0.99,0.1\n", encoding="utf-8"
    )
    (folder / "metrics.json").write_text(
        json.dumps({"status": status, "final": final, "scene": folder.name}), encoding="utf-8"
    )


if __name__ == "__main__":
    main()
