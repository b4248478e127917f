"""A run one step at a time: watch it, change its mind, stop it when it is good enough, look at what it made.

python examples/2_step_by_step.py --data demo --enough 34
"""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import tyro

import sculpt_framework as sculpt


def main(
    data: str = "demo",
    out: Path = Path("outputs/steps"),
    method: str = "gaussian-sculpting",
    steps: int = 200,
    enough: float = 34,
) -> None:
    """``enough`` is the PSNR of held-out views, in dB, at which the run may stop."""
    scene = sculpt.load(data)
    config = replace(sculpt.methods[method](), steps=steps, seed=1)
    session = sculpt.Session(scene, config)
    for decision in session.plan.decisions if session.plan else ():
        print(f"{decision.item}: {decision.value}")
    measured = 0
    for report in session:
        if len(session.curve) > measured:
            measured = len(session.curve)
            row = session.curve[-1]
            print(f"step {report.step}: {row['psnr'] or 0:.1f} dB after {row['t_train_s']:.0f} s, {row['faces']} faces")
            if (row["psnr"] or 0) >= enough:
                session.stop()  # The loop ends, and the session finishes what there is.
    camera = scene.train[0].camera
    beside = np.hstack([scene.train[0].rgb.numpy(), session.render(camera).rgb.numpy()])
    out.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(out / "beside.png"), (255 * beside[..., ::-1].clip(0, 1)).round().astype(np.uint8))
    session.mesh().to_trimesh().export(out / "mesh.ply")
    print("saved:", out / "mesh.ply")


if __name__ == "__main__":
    tyro.cli(main)
