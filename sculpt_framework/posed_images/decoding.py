"""One image file to sRGB floats. Damaged files are refused before a decoder can guess at what is missing."""

import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float

from sculpt_framework.errors import DataError

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
JPEG_START, JPEG_END = b"\xff\xd8\xff", b"\xff\xd9"
_JPEG_TRAILER = 4096  # Cameras append private bytes behind the end marker; more than this is not an image's tail.


@dataclass(frozen=True, kw_only=True, eq=False)
class DecodedImage:
    """sRGB in [0, 1], straight alpha; ``alpha`` is None if the file has no such channel."""

    rgb: Float[np.ndarray, "h w 3"]
    alpha: Float[np.ndarray, "h w"] | None
    grey: bool
    bits: int
    """Bits per channel in the file: 8 or 16."""
    lossless: bool
    """False for JPEG."""


def read_image(path: Path) -> DecodedImage:
    """Read an 8- or 16-bit image with 1, 3 or 4 channels. The EXIF orientation is not applied.

    Raises DataError, with the file's name, where it is missing, empty, damaged or of another pixel type.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror}).") from None
    if not data:
        raise DataError(f"{path}: the image file is empty; write it again.")
    damage = find_damage(data)
    if damage:
        raise DataError(f"{path}: the image is damaged ({damage}); write or download it again.")
    try:
        pixels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        pixels = None
    if pixels is None:
        raise DataError(f"{path}: not an image that can be decoded; expected PNG or JPEG.")
    bits = {"uint8": 8, "uint16": 16}.get(str(pixels.dtype))
    if bits is None:
        raise DataError(f"{path}: pixels are {pixels.dtype}; expected 8- or 16-bit integers.")
    if pixels.ndim == 2:
        pixels = pixels[:, :, None]
    if pixels.shape[2] not in (1, 3, 4):
        raise DataError(f"{path}: {pixels.shape[2]} channels; expected grey, RGB or RGBA.")
    grey = pixels.shape[2] == 1
    scale = np.float32(1 / (2**bits - 1))
    bgr = np.repeat(pixels, 3, axis=2) if grey else pixels[:, :, :3]
    alpha = pixels[:, :, 3].astype(np.float32) * scale if pixels.shape[2] == 4 else None
    rgb = np.ascontiguousarray(bgr[:, :, ::-1]).astype(np.float32) * scale
    return DecodedImage(rgb=rgb, alpha=alpha, grey=grey, bits=bits, lossless=not data.startswith(JPEG_START))


def find_damage(data: bytes) -> str | None:
    """What is visibly wrong with the bytes of a PNG or JPEG, or None; other formats are left to the decoder.

    Decoders fill a truncated image with grey or with zeros and say nothing about it, which would be learned as colour.
    """
    if data.startswith(PNG_SIGNATURE):
        return _png_damage(data)
    if data.startswith(JPEG_START) and JPEG_END not in data[-_JPEG_TRAILER:]:
        return "cut off before its end"
    return None


def _png_damage(data: bytes) -> str | None:
    at = len(PNG_SIGNATURE)
    while at + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        kind = data[at + 4 : at + 8]
        end = at + 12 + length
        if end > len(data):
            return "cut off before its end"
        (checksum,) = struct.unpack_from(">I", data, end - 4)
        if zlib.crc32(data[at + 4 : end - 4]) != checksum:
            return "a checksum does not match"
        if kind == b"IEND":
            return None
        at = end
    return "cut off before its end"
