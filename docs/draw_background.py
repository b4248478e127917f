"""Pictures of a run that has learned what is around the object.

    python docs/draw_background.py RUN:VIEW ... --out PICTURE

RUN is a finished run with ``--background gaussians``, VIEW the number of one of its photographs. For each, a row: the
photograph; the Gaussians on the object in front of those around it; the latter alone.
"""

import argparse
import sys
from pathlib import Path

import cv2
import numpy as np
import torch
from jaxtyping import Float

from sculpt_framework.engine.run import read_config
from sculpt_framework.export.gaussian_files import read_gaussians_ply
from sculpt_framework.export.saved_gaussians import BACKGROUND_NAME, GAUSSIANS_NAME
from sculpt_framework.sculpting.config import of_sculpting
from sculpt_framework.types import Gaussians, Rendering

_WIDTH, _QUALITY = 1200, 85


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("views", nargs="+", metavar="RUN:VIEW")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    rows = [row(*view.rsplit(":", 1)) for view in options.views]
    width = min(each.shape[1] for each in rows)
    fitted = [cv2.resize(each, (width, each.shape[0] * width // each.shape[1])) for each in rows]
    picture = np.concatenate(fitted)
    scale = min(1.0, _WIDTH / width)
    small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(options.out), (255 * small[..., ::-1]).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])


@torch.no_grad()
def row(folder: str, number: str) -> Float[np.ndarray, "h w 3"]:
    run = Path(folder)
    config = of_sculpting(read_config(run))
    view = config.dataset.build(config.data).load().train[int(number)]
    camera, device = view.camera.to(torch.device("cpu"), torch.float32), torch.device("cpu")
    rasterizer = config.rasterizer.build(device)

    def drawn(gaussians: Gaussians) -> Rendering:
        return rasterizer.render(gaussians, camera, torch.zeros(3), low_pass_px2=config.trainer.low_pass_px2)

    front, behind = (drawn(read_gaussians_ply(run / name)) for name in (GAUSSIANS_NAME, BACKGROUND_NAME))
    both = front.rgb + (1 - front.alpha)[..., None] * behind.rgb
    return torch.cat([view.rgb, both, behind.rgb], dim=1).clamp(0, 1).numpy()


if __name__ == "__main__":
    sys.exit(main())
