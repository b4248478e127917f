"""The pictures that Blender writes without compression: all passes in one file, in linear light."""

import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float32

TYPES = (np.dtype("<u4"), np.dtype("<f2"), np.dtype("<f4"))


def read_passes(path: Path) -> dict[str, Float32[np.ndarray, "h w"]]:
    """Every channel by its name, such as ``ViewLayer.Combined.R``.

    Raises ValueError for a file of several parts, one that is compressed, or one that is none.
    """
    content = path.read_bytes()
    magic, version = struct.unpack_from("<II", content)
    if magic != 20000630 or version & 0x1200:
        raise ValueError(f"{path}: not an OpenEXR file of one part in scan lines")
    attributes, at = _attributes(content, 8)
    if attributes["compression"] != b"\0":
        raise ValueError(f"{path}: compressed")
    left, top, right, bottom = struct.unpack("<4i", attributes["dataWindow"])
    width, height = right - left + 1, bottom - top + 1
    line = np.dtype([("row", "<i4"), ("bytes", "<i4"), *((name, kind, width) for name, kind in _channels(attributes))])
    # Between the header and the lines stands where each line begins; written whole, they follow each other.
    lines = np.frombuffer(content, line, height, at + 8 * height)
    return {name: lines[name].astype(np.float32) for name, _ in _channels(attributes)}


def _attributes(content: bytes, at: int) -> tuple[dict[str, bytes], int]:
    """Name and value of each, and where the header ends."""
    found = {}
    while content[at]:
        end = content.index(b"\0", at)
        name, at = content[at:end].decode(), content.index(b"\0", end + 1) + 1
        (size,) = struct.unpack_from("<i", content, at)
        found[name], at = content[at + 4 : at + 4 + size], at + 4 + size
    return found, at + 1


def _channels(attributes: Mapping[str, bytes]) -> list[tuple[str, np.dtype]]:
    listed, at, found = attributes["channels"], 0, []
    while listed[at]:
        end = listed.index(b"\0", at)
        (kind,) = struct.unpack_from("<i", listed, end + 1)
        found.append((listed[at:end].decode(), TYPES[kind]))
        at = end + 17
    return found
