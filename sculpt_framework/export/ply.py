"""Binary PLY, the part of it that meshes and Gaussians need: little endian, rows of numbers, one list of three."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sculpt_framework.errors import DataError

TRIANGLE = np.dtype([("count", "u1"), ("vertex_indices", "<i4", (3,))])
"""A row of a face element: PLY stores a polygon as its number of corners and then the corners."""

_NAME_OF_TYPE = {"<f4": "float", "<f8": "double", "<i4": "int", "|u1": "uchar"}
_TYPE_OF_NAME = {name: type_ for type_, name in _NAME_OF_TYPE.items()} | {
    "float32": "<f4",
    "float64": "<f8",
    "int32": "<i4",
    "uint8": "|u1",
}


def encode_ply(elements: Sequence[tuple[str, np.ndarray]]) -> bytes:
    """A PLY file of named elements, each a structured array with one row per item."""
    lines = ["ply", "format binary_little_endian 1.0"]
    for name, rows in elements:
        lines.append(f"element {name} {len(rows)}")
        if rows.dtype == TRIANGLE:
            lines.append("property list uchar int vertex_indices")
        else:
            fields = rows.dtype.fields or {}
            lines += [f"property {_NAME_OF_TYPE[fields[field][0].str]} {field}" for field in fields]
    header = "\n".join([*lines, "end_header", ""]).encode("ascii")
    return header + b"".join(rows.tobytes() for _, rows in elements)


def read_vertex_rows(path: Path) -> np.ndarray:
    """The rows of the first element, "vertex", of a binary little-endian PLY file as a structured array.

    Raises DataError where the file is missing, is of another kind or ends too early.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise DataError(f"cannot read {path} ({error.strerror}); expected a PLY file") from error
    header, found, body = content.partition(b"end_header\n")
    lines = header.decode("ascii", errors="replace").splitlines()
    if not found or lines[:2] != ["ply", "format binary_little_endian 1.0"]:
        raise DataError(f"{path} is not a binary little-endian PLY file")
    count, properties = 0, []
    try:
        for words in (line.split() for line in lines[2:]):
            if words[:1] == ["element"]:
                if properties or words[1] != "vertex":
                    break
                count = int(words[2])
            elif words[:1] == ["property"]:
                if len(words) != 3 or words[1] not in _TYPE_OF_NAME:
                    raise DataError(f"{path} has a vertex property that is not read here: {' '.join(words)}")
                properties.append((words[2], _TYPE_OF_NAME[words[1]]))
        row = np.dtype(properties)
    except (ValueError, IndexError) as error:
        raise DataError(f"{path} has a header that is no PLY header ({error})") from error
    if count < 0 or row.itemsize == 0:
        raise DataError(f"{path} has no vertices with properties")
    if len(body) < count * row.itemsize:
        raise DataError(f"{path} is cut: {count} rows of {row.itemsize} bytes announced, {len(body)} bytes found")
    return np.frombuffer(body, dtype=row, count=count)
