"""Pixels as they are in the file, or an error; never a guess."""

import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest
from plain_scenes import ball, write_image

from sculpt_framework.errors import DataError
from sculpt_framework.posed_images.decoding import PNG_SIGNATURE, find_damage, read_image
from sculpt_framework.posed_images.keying import common_background, given_background, key_out


def _chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


@pytest.mark.parametrize(("dtype", "top"), [(np.uint8, 255), (np.uint16, 65535)])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_png_is_exact(tmp_path: Path, dtype: type, top: int, channels: int) -> None:
    pixels = np.random.default_rng(0).integers(0, top, (7, 5, channels), endpoint=True).astype(dtype)
    write_image(tmp_path / "a.png", pixels)
    image = read_image(tmp_path / "a.png")
    rgb = np.repeat(pixels, 3, axis=2) if channels == 1 else pixels[..., 2::-1]
    np.testing.assert_allclose(image.rgb, rgb / top, atol=1e-7)
    assert image.grey == (channels == 1)
    assert image.bits == (8 if top == 255 else 16)
    assert image.lossless
    if channels == 4:
        assert image.alpha is not None
        np.testing.assert_allclose(image.alpha, pixels[..., 3] / top, atol=1e-7)
    else:
        assert image.alpha is None


def test_grey_with_alpha(tmp_path: Path) -> None:
    """PNG colour type 4, which the encoder at hand does not write."""
    header = struct.pack(">IIBBBBB", 2, 1, 8, 4, 0, 0, 0)
    data = zlib.compress(bytes([0, 100, 255, 200, 51]))
    path = tmp_path / "a.png"
    path.write_bytes(PNG_SIGNATURE + _chunk(b"IHDR", header) + _chunk(b"IDAT", data) + _chunk(b"IEND", b""))
    image = read_image(path)
    assert image.alpha is not None
    np.testing.assert_allclose(image.alpha, [[1.0, 0.2]], atol=1e-6)
    np.testing.assert_allclose(image.rgb[0, :, 0], [100 / 255, 200 / 255], atol=1e-6)


def test_truncation_anywhere_is_seen() -> None:
    for extension in (".png", ".jpg"):
        done, encoded = cv2.imencode(extension, ball()[..., :3])
        assert done
        data = encoded.tobytes()
        assert find_damage(data) is None
        assert find_damage(data + b"trailing bytes") is None
        for cut in (8, len(data) // 3, len(data) - 10, len(data) - 1):
            assert find_damage(data[:cut]) is not None


def test_floating_point_images_are_refused(tmp_path: Path) -> None:
    write_image(tmp_path / "a.tiff", np.ones((4, 4, 3), np.float32))
    with pytest.raises(DataError, match=r"a.tiff: pixels are float32; expected 8- or 16-bit integers"):
        read_image(tmp_path / "a.tiff")


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"a.png: cannot be read \(No such file"):
        read_image(tmp_path / "a.png")


def _disc(side: int, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Coverage of a disc, antialiased, and its colour over white."""
    fine = (np.indices((8 * side, 8 * side)) + 0.5) / 8 - side / 2
    coverage = (np.hypot(*fine) < radius).reshape(side, 8, side, 8).mean(axis=(1, 3))
    color = np.array([0.2, 0.5, 0.8])
    return coverage, coverage[..., None] * color + (1 - coverage[..., None])


def test_keying_finds_partial_coverage() -> None:
    coverage, image = _disc(48, 15.3)
    behind = common_background([image], lossless=True)
    assert behind is not None
    np.testing.assert_allclose(behind.color, 1.0)
    alpha = key_out(image, behind)
    assert np.abs(alpha - coverage).max() < 0.02
    # Straight colour: the rim is as blue as the middle.
    straight = image[alpha > 0.1]
    np.testing.assert_allclose(straight, np.broadcast_to([0.2, 0.5, 0.8], straight.shape), atol=0.02)


def test_keying_opens_holes_and_keeps_specks() -> None:
    _, image = _disc(48, 20)
    hole, speck = (slice(18, 26), slice(18, 26)), (slice(32, 33), slice(24, 26))
    image[hole], image[speck] = 1.0, 1.0
    alpha = key_out(image, given_background(np.ones(3), [image], lossless=True))
    assert (alpha[19:25, 19:25] == 0).all()
    assert (alpha[speck] > 0).all()


def test_keying_an_image_of_nothing() -> None:
    image = np.ones((20, 20, 3))
    alpha = key_out(image, given_background(np.ones(3), [image], lossless=False))
    assert (alpha == 0).all()


def test_no_common_background() -> None:
    red, green = np.zeros((20, 20, 3)), np.zeros((20, 20, 3))
    red[..., 0], green[..., 1] = 1, 1
    assert common_background([red, green], lossless=True) is None
