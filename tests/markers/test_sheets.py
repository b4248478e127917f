"""Sheets to print: what is on them, and how large it is on the paper."""

import io
import re
import struct
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from sculpt_framework.cli.data import data
from sculpt_framework.errors import ConfigError, OutputError
from sculpt_framework.markers.boards import board_of
from sculpt_framework.markers.detection import find_board


def _tiff(width: int, height: int, data: bytes) -> bytes:
    """A page as fax data, as the PDF holds it, in the file that an image library reads."""
    tags = [(256, width), (257, height), (258, 1), (259, 4), (262, 1), (273, 8 + 2 + 12 * 8 + 4), (278, height)]
    tags.append((279, len(data)))
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags)
    return b"II*\0" + struct.pack("<IH", 8, len(tags)) + entries + struct.pack("<I", 0) + data


def _page(path: Path) -> tuple[np.ndarray, tuple[float, float]]:
    """The image in a PDF of one page, and millimetres to its pixels."""
    raw = path.read_bytes()
    box = re.search(rb"/MediaBox \[ ?([\d. ]+)\]", raw)
    assert box is not None
    left, low, right, high = (float(value) for value in box[1].split())
    image = next(part for part in raw.split(b"endobj") if b"/Image" in part and b"stream" in part)
    width, height = (int(re.search(rb"/%s (\d+)" % key, image)[1]) for key in (b"Width", b"Height"))  # type: ignore[index]
    assert b"CCITTFaxDecode" in image
    stream = image[image.index(b"stream") + len(b"stream") :].lstrip(b"\r\n").partition(b"endstream")[0]
    pixels = np.array(Image.open(io.BytesIO(_tiff(width, height, stream))).convert("L"))
    inch = 25.4 / 72
    return pixels, ((right - left) * inch / width, (high - low) * inch / height)


@pytest.mark.parametrize(
    ("name", "paper"), [("charuco-7x9-26", "letter"), ("ring-5x6-30", "a4"), ("charuco-6x8-40-30@7", "a3")]
)
def test_a_printed_board_has_its_size(name: str, paper: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "new" / "board.pdf"
    words = ["markers", "--board", name, "--paper", paper, "--out", str(path)]
    monkeypatch.setattr(sys, "argv", ["sculpt-data", *words])
    data()
    pixels, millimetres = _page(path)
    assert pixels.shape[1] * millimetres[0] == pytest.approx({"a4": 210, "letter": 215.9, "a3": 297}[paper], abs=0.05)
    board = board_of(name)
    small = cv2.resize(pixels, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_AREA)
    found = find_board(small, board)
    assert found.points.tolist() == list(range(len(board.points())))
    assert found.markers == len(board.ids)
    places = found.pixels * 4 * millimetres * (1, -1)
    away = places - places.mean(axis=0) - 1000 * board.points()[:, :2]
    assert np.abs(away - away.mean(axis=0)).max() < 0.05


def test_the_ruler_is_a_hundred_millimetres_long(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "one.pdf"
    monkeypatch.setattr(sys, "argv", ["sculpt-data", "markers", "--board", "single-2-50", "--out", str(path)])
    data()
    pixels, millimetres = _page(path)
    runs = [np.flatnonzero(np.diff((row == 0).astype(int), prepend=0, append=0)) for row in pixels]
    longest = max(int((run[1::2] - run[::2]).max(initial=0)) for run in runs)
    assert longest * millimetres[0] == pytest.approx(100, abs=0.3)


def test_markers_of_a_ring_leave_the_free_place_free():
    board = board_of("ring-5x6-30")
    assert board.free is not None
    inside = np.abs(board.points()[:, :2] * 1000) < np.array(board.free) / 2
    assert not inside.all(axis=1).any()


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("chess-7x9-26", "expected charuco-COLUMNSxROWS-SIDE"),
        ("ring-5-30", "expected charuco-COLUMNSxROWS-SIDE"),
        ("single-3x3-30", "expected charuco-COLUMNSxROWS-SIDE"),
        ("charuco-7x9-26-30", "a marker's below its square's"),
        ("ring-5x6-30-20", "only a ChArUco board has markers of a size of their own"),
        ("charuco-2x9-26", "2x9 is too few"),
        ("charuco-30x30-8", "needs markers 0 to 449; 5x5_100 has 0 to 99"),
        ("ring-5x6-30-7x7_9", "no dictionary 7x7_9; expected one of"),
    ],
)
def test_a_board_that_cannot_be_is_told(name: str, said: str):
    with pytest.raises(ConfigError, match=said):
        board_of(name)


def test_a_board_that_does_not_fit_on_the_paper_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    words = ["markers", "--board", "ring-5x9-30", "--out", str(tmp_path / "a.pdf")]
    monkeypatch.setattr(sys, "argv", ["sculpt-data", *words])
    with pytest.raises(ConfigError, match="190 x 350 mm do not fit on a4"):
        data()
    monkeypatch.setattr(sys, "argv", ["sculpt-data", "markers", "--out", str(tmp_path / "a.png")])
    with pytest.raises(OutputError, match=r"ends in \.pdf"):
        data()
    assert list(tmp_path.iterdir()) == []
