"""Digests of what a run reads, so that two runs can be shown to have read the same."""

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from sculpt_framework.errors import DataError
from sculpt_framework.threads import in_threads
from sculpt_framework.types import Scene, View


def input_digests(scene: Scene, reference: Path | None) -> Mapping[str, str]:
    """SHA-256, in hexadecimal, by kind of input.

    "train images" and "test images" are digests of the files' own digests, 64 letters a line in the order of the
    views, so that ``sha256sum`` of the files, its first column again through ``sha256sum``, gives the same. Of a view
    that comes from no file the pixels are digested in the file's place. "cameras" is of the numbers of all views as
    little-endian float64, "reference mesh" of its file. Raises DataError where a file is gone meanwhile.
    """
    out = {"train images": _images(scene.train)}
    if scene.test:
        out["test images"] = _images(scene.test)
    out["cameras"] = _cameras([*scene.train, *scene.test])
    if reference is not None:
        out["reference mesh"] = file_digest(reference)
    return out


def file_digest(path: Path) -> str:
    """SHA-256 of a file. Raises DataError if it cannot be read."""
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise DataError(f"{path}: cannot be read any more ({error.strerror}).") from error


def _images(views: Sequence[View]) -> str:
    lines = in_threads(_digest, views)
    return hashlib.sha256("".join(f"{line}\n" for line in lines).encode("ascii")).hexdigest()


def _digest(view: View) -> str:
    return _pixels(view) if view.source is None else file_digest(view.source)


def _pixels(view: View) -> str:
    digest = hashlib.sha256(np.ascontiguousarray(view.rgb.numpy(), dtype="<f4").tobytes())
    if view.alpha is not None:
        digest.update(np.ascontiguousarray(view.alpha.numpy(), dtype="<f4").tobytes())
    return digest.hexdigest()


def _cameras(views: Sequence[View]) -> str:
    digest = hashlib.sha256()
    for camera in (view.camera for view in views):
        lens = [camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height]
        digest.update(np.asarray(lens, dtype="<f8").tobytes())
        digest.update(np.ascontiguousarray(camera.world_to_camera.double().numpy(), dtype="<f8").tobytes())
    return digest.hexdigest()
