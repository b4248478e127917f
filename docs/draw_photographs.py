"""A picture of photographs of which meshes can be made, and of some of which they cannot.

    python docs/draw_photographs.py CAPTURE --out PICTURE

Above, four photographs of CAPTURE/images, spread over all. Below, what would spoil the same four: the camera moved
while the shutter was open, the exposure was too long, the object is cut off, the object has too few pixels.
"""

import argparse
import sys
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

from sculpt_framework.spread import spread

Picture = UInt8[np.ndarray, "h w 3"]
_WIDTH, _QUALITY = 300, 85


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    paths = [path for path in sorted((options.capture / "images").iterdir()) if path.is_file()]
    good = [small(np.asarray(cv2.imread(str(path)), np.uint8)) for path in spread(paths, 5)[:4]]
    bad = [spoil(photograph) for spoil, photograph in zip((shaken, burnt_out, cut_off, too_small), good, strict=True)]
    picture = np.concatenate([np.concatenate(row, axis=1) for row in (good, bad)])
    cv2.imwrite(str(options.out), picture, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])


def small(photograph: Picture) -> Picture:
    height, width = photograph.shape[:2]
    size = (_WIDTH, height * _WIDTH // width)
    return np.asarray(cv2.resize(photograph, size, interpolation=cv2.INTER_AREA), np.uint8)


def shaken(photograph: Picture) -> Picture:
    path = np.zeros((9, 9), np.float32)
    cv2.line(path, (0, 2), (8, 6), 1.0)
    return np.asarray(cv2.filter2D(photograph, -1, path / path.sum()), np.uint8)


def burnt_out(photograph: Picture) -> Picture:
    return (2.4 * photograph.astype(np.float32) + 20).clip(0, 255).astype(np.uint8)


def cut_off(photograph: Picture) -> Picture:
    height, width = photograph.shape[:2]
    part = photograph[height // 3 : height // 3 + height // 2, width // 3 : width // 3 + width // 2]
    return np.asarray(cv2.resize(part, (width, height), interpolation=cv2.INTER_LINEAR), np.uint8)


def too_small(photograph: Picture) -> Picture:
    """As few pixels as an object has that is eight times as far away."""
    height, width = photograph.shape[:2]
    tiny = cv2.resize(photograph, (width // 8, height // 8), interpolation=cv2.INTER_AREA)
    return np.asarray(cv2.resize(tiny, (width, height), interpolation=cv2.INTER_NEAREST), np.uint8)


if __name__ == "__main__":
    sys.exit(main())
