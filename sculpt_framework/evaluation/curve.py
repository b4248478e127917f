"""``curve.csv``: error against run time, one row per evaluation, a blank where a value is not known."""

import csv
import io
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

from sculpt_framework.errors import DataError

CURVE_COLUMNS: Mapping[str, str] = {
    "t_train_s": "seconds of training alone: without evaluation, saving, viewing",
    "t_wall_s": "seconds since the process started",
    "t_cpu_s": "CPU seconds of the process, all threads",
    "outer": "outer steps so far",
    "inner": "inner steps so far",
    "faces": "triangles of the surface",
    "gaussians": "Gaussians on it",
    "grid": "cells of the extraction grid along its longest side",
    "rss_mb": "peak resident memory of the process, MiB",
    "psnr": "held-out views: peak signal-to-noise ratio, dB",
    "ssim": "held-out views: structural similarity",
    "iou": "held-out views: intersection over union of the masks",
    "chamfer_ps": "point-to-surface Chamfer distance to the reference, scene units",
    "fscore": "F-score at 0.2 % of the diagonal of the reference's bounding box",
    "normal_consistency": "mean |cosine| between normals of result and reference",
    "under10_pct": "percent of triangles with an angle below 10 degrees",
    "psnr_fitted": "held-out views: PSNR after one gain and offset per image and channel, dB",
    "residual_px": "median displacement left between neighbouring views, pixels of the views",
    "residual_p90_px": "its 90th percentile, pixels of the views",
    "residual_depth": "median distance of the surface from where the images say it is, scene units",
    "judged": "share of the masks' pixels the residual is of",
    "roughness": "mean angle between normals and their mean around, over what is seen, degrees",
    "plain_roughness": "the same where the images have no texture, degrees",
}
"""Columns in order, with what they hold."""

_LATER = ("psnr_fitted", "residual_px", "residual_p90_px", "residual_depth", "judged", "roughness", "plain_roughness")
"""Columns that curves of older versions do not have: nothing is known in them."""

CurveRow = Mapping[str, float | None]


def header_line() -> str:
    return _line(list(CURVE_COLUMNS))


def row_line(row: Mapping[str, object]) -> str:
    """One line of the file. Values that are missing, None or not finite are left blank; other keys are ignored."""
    return _line([_cell(row.get(column)) for column in CURVE_COLUMNS])


def read_curve(path: Path) -> list[CurveRow]:
    """The rows of a curve.csv, without a last line that was cut. Columns beyond the known ones are ignored; those
    that an older version did not write yet hold None.

    Raises DataError where there is no such file or it is something else.
    """
    try:
        text = path.read_text(encoding="ascii")
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(f"cannot read {path} ({error}); expected the curve.csv of a run") from error
    return parse_curve(text, path)


def parse_curve(text: str, path: Path) -> list[CurveRow]:
    """As ``read_curve``; ``path`` is for the error's text."""
    whole = text[: text.rfind("\n") + 1]
    reader = csv.DictReader(io.StringIO(whole))
    missing = [column for column in CURVE_COLUMNS if column not in (*(reader.fieldnames or ()), *_LATER)]
    if missing:
        raise DataError(f"{path} is not a curve of a run: it has no column {', '.join(missing)}")
    try:
        return [{column: float(row[column]) if row.get(column) else None for column in CURVE_COLUMNS} for row in reader]
    except ValueError as error:
        raise DataError(f"{path}, line {reader.line_num}: {error}") from error


def _line(cells: Sequence[str]) -> str:
    return ",".join(cells) + "\n"


def _cell(value: object) -> str:
    if value is None:
        return ""
    number = float(value)  # pyright: ignore[reportArgumentType]
    if not math.isfinite(number):
        return ""
    return str(int(number)) if number == int(number) and abs(number) < 1e15 else f"{number:.6g}"
