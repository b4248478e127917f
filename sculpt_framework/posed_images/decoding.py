"""One image file to sRGB floats. Damaged files are refused before a decoder can guess at what is missing."""

import re
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float

from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.heic import is_heic, read_heic

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
JPEG_START, JPEG_END = b"\xff\xd8\xff", b"\xff\xd9"
_LOSSLESS = (PNG_SIGNATURE, b"BM", b"II*", b"MM\0*")
_REDUCED = (
    (8, cv2.IMREAD_REDUCED_COLOR_8),
    (4, cv2.IMREAD_REDUCED_COLOR_4),
    (2, cv2.IMREAD_REDUCED_COLOR_2),
)
"""By how much JPEGs can be reduced as they are decoded."""
_LEFT = 1.5
_LFS = b"version https://git-lfs"
_CUT = "cut off before its end"
_JPEG_MARKER = re.compile(rb"\xff[^\x00\xd0-\xd7\xff]")
"""Not a byte 255 among the pixels' codes, which a zero follows, nor what parts them to restart the decoder."""


@dataclass(frozen=True, kw_only=True, eq=False)
class DecodedImage:
    """sRGB in [0, 1], straight alpha; ``alpha`` is None if the file has no such channel."""

    rgb: Float[np.ndarray, "h w 3"]
    alpha: Float[np.ndarray, "h w"] | None
    grey: bool
    bits: int
    """Bits per channel in the file: 8 or 16."""
    lossless: bool
    """False for JPEG, WebP, AVIF and HEIC, whose errors are largest around the object."""
    full_size: tuple[int, int]
    """Width and height of the image in the file, upright if it was asked for, before it was reduced."""


def read_image(path: Path, *, orientation: int = 1, divide: int = 1) -> DecodedImage:
    """Read an 8- or 16-bit image with 1, 3 or 4 channels.

    ``orientation`` is the EXIF one to undo; what the file says itself is not looked at. ``divide`` reads 1/divide of
    the pixels along each side, means over their areas; colours are weighted by alpha.

    Raises DataError, with the file's name, where it is missing, empty, damaged or of another pixel type.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror}).") from None
    if not data:
        raise DataError(f"{path}: the image file is empty; write it again.")
    if data.startswith(_LFS):
        raise DataError(f"{path}: is a pointer of Git LFS in place of the image; fetch it with 'git lfs pull'.")
    damage = find_damage(data)
    if damage:
        raise DataError(f"{path}: the image is damaged ({damage}); write or download it again.")
    jpeg = data.startswith(JPEG_START)
    pixels, full = read_heic(data, path) if is_heic(data) else _decode(data, divide if jpeg else 1)
    if pixels is None:
        raise DataError(f"{path}: not an image that can be decoded; expected PNG, JPEG, WebP, TIFF, AVIF or HEIC.")
    pixels = _upright(pixels, orientation)
    width, height = full[::-1] if orientation >= 5 else full
    bits = {"uint8": 8, "uint16": 16}.get(str(pixels.dtype))
    if bits is None:
        raise DataError(f"{path}: pixels are {pixels.dtype}; expected 8- or 16-bit integers.")
    if pixels.ndim == 2:
        pixels = pixels[:, :, None]
    if pixels.shape[2] not in (1, 3, 4):
        raise DataError(f"{path}: {pixels.shape[2]} channels; expected grey, RGB or RGBA.")
    grey = pixels.shape[2] == 1
    scale = np.float32(1 / (2**bits - 1))
    alpha = pixels[:, :, 3].astype(np.float32) * scale if pixels.shape[2] == 4 else None
    code = {1: cv2.COLOR_GRAY2RGB, 3: cv2.COLOR_BGR2RGB, 4: cv2.COLOR_BGRA2RGB}[pixels.shape[2]]
    rgb = np.multiply(cv2.cvtColor(pixels, code), scale, dtype=np.float32)
    if divide > 1:
        rgb, alpha = shrink(rgb, alpha, max(1, round(width / divide)), max(1, round(height / divide)))
    lossless = data.startswith(_LOSSLESS)
    return DecodedImage(rgb=rgb, alpha=alpha, grey=grey, bits=bits, lossless=lossless, full_size=(width, height))


def shrink(
    rgb: Float[np.ndarray, "h w 3"], alpha: Float[np.ndarray, "h w"] | None, width: int, height: int
) -> tuple[Float[np.ndarray, "h2 w2 3"], Float[np.ndarray, "h2 w2"] | None]:
    """Means over the area of each new pixel; with straight alpha, of the colours weighted by it."""
    if rgb.shape[:2] == (height, width):
        return rgb, alpha
    size = (width, height)
    if alpha is None:
        return cv2.resize(rgb, size, interpolation=cv2.INTER_AREA), None
    plain = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)
    small = cv2.resize(alpha, size, interpolation=cv2.INTER_AREA)
    weighted = cv2.resize(rgb * alpha[..., None], size, interpolation=cv2.INTER_AREA)
    # Where nothing covers a pixel its colour means nothing, but it must not be a division by zero.
    seen = small > 1e-4
    straight = np.where(seen[..., None], weighted / np.maximum(small, 1e-4)[..., None], plain)
    return straight.clip(0, 1).astype(np.float32), small


def _decode(data: bytes, divide: int) -> tuple[np.ndarray | None, tuple[int, int]]:
    """Stored pixels, None if they cannot be decoded, and the stored width and height.

    A JPEG is decoded small where that halves its sides exactly, which is several times faster and needs memory for the
    small image alone. What is left to reduce then is at least ``_LEFT``: means over areas come out as they should.
    """
    buffer = np.frombuffer(data, np.uint8)
    try:
        size = jpeg_size(data) if divide > 1 else None
        for step, flag in _REDUCED:
            if size is None or size[0] % step or size[1] % step:
                continue
            if step == divide or step * _LEFT <= divide:
                return cv2.imdecode(buffer, flag | cv2.IMREAD_IGNORE_ORIENTATION), size
        pixels = cv2.imdecode(buffer, cv2.IMREAD_UNCHANGED)
    except cv2.error:
        return None, (0, 0)
    return pixels, (0, 0) if pixels is None else (pixels.shape[1], pixels.shape[0])


def jpeg_size(data: bytes) -> tuple[int, int] | None:
    """Width and height in a JPEG's frame header; None where there is none, or where its one channel is grey."""
    at = 2
    while at + 10 <= len(data) and data[at] == 0xFF:
        kind, (length,) = data[at + 1], struct.unpack_from(">H", data, at + 2)
        if 0xC0 <= kind <= 0xCF and kind not in (0xC4, 0xC8, 0xCC):
            height, width, channels = struct.unpack_from(">HHB", data, at + 5)
            return (width, height) if channels == 3 else None
        at += 2 + length
    return None


def _upright(pixels: np.ndarray, orientation: int) -> np.ndarray:
    """Stored pixels as the EXIF orientation wants them shown."""
    if orientation >= 5:
        pixels = pixels.transpose(1, 0, *range(2, pixels.ndim))
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    return np.ascontiguousarray(pixels)


def find_damage(data: bytes) -> str | None:
    """What is visibly wrong with the bytes of a PNG, JPEG, WebP or BMP, or None; other formats are left to the decoder.

    Decoders fill a truncated image with grey or with zeros and say nothing about it, which would be learned as colour.
    """
    if data.startswith(PNG_SIGNATURE):
        return _png_damage(data)
    if data.startswith(JPEG_START):
        return _jpeg_damage(data)
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        return _CUT if len(data) < 8 + int.from_bytes(data[4:8], "little") else None
    if data[:2] == b"BM" and len(data) < int.from_bytes(data[2:6], "little"):
        return _CUT
    return None


def _jpeg_damage(data: bytes) -> str | None:
    """What follows the end marker is no part of the image: private bytes, a preview, a motion photograph's film."""
    at = 2
    while (marker := _JPEG_MARKER.search(data, at)) is not None:
        if marker[0] == JPEG_END:
            return None
        # Segments say how long they are, so that a preview in one does not end the image. Pixels follow the last one.
        length = int.from_bytes(data[marker.end() : marker.end() + 2], "big")
        at = marker.end() + max(2, length)
    return _CUT


def _png_damage(data: bytes) -> str | None:
    at = len(PNG_SIGNATURE)
    while at + 12 <= len(data):
        (length,) = struct.unpack_from(">I", data, at)
        kind = data[at + 4 : at + 8]
        end = at + 12 + length
        if end > len(data):
            return _CUT
        (checksum,) = struct.unpack_from(">I", data, end - 4)
        if zlib.crc32(data[at + 4 : end - 4]) != checksum:
            return "a checksum does not match"
        if kind == b"IEND":
            return None
        at = end
    return _CUT
