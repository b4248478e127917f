"""Malformed scenes: each is read with a note that says what was done, or refused by one line; nothing else."""

import json
import os
import re
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from layouts import make_shots, save_jpeg, write_colmap, write_nerfstudio
from PIL import Image
from plain_scenes import write_image

from sculpt_framework.errors import DataError
from sculpt_framework.types import Scene
from sculpt_plugins.datasets.auto.config import AutoDatasetConfig

Spoil = Callable[[Path], object]
SHOTS = make_shots(4, 24)
BOX = (-1.0, -1.0, -1.0, 1.0, 1.0, 1.0)
IMAGE, MASK = "images/r_01.png", "masks/r_01.png"
CAMERAS, IMAGES, POINTS = (f"sparse/0/{name}.txt" for name in ("cameras", "images", "points3D"))


def spoiled(name: str, change: Callable[[bytes], bytes]) -> Spoil:
    return lambda folder: (folder / name).write_bytes(change((folder / name).read_bytes()))


def content(name: str, data: bytes) -> Spoil:
    return lambda folder: (folder / name).write_bytes(data)


def document(**keys: Any) -> Spoil:
    return edited(lambda d: d.update(keys))


def frame(**keys: Any) -> Spoil:
    return edited(lambda d: d["frames"][1].update(keys))


def edited(change: Callable[[dict[str, Any]], object], name: str = "transforms.json") -> Spoil:
    def spoil(folder: Path) -> None:
        held = json.loads((folder / name).read_text(encoding="utf-8"))
        change(held)
        (folder / name).write_text(json.dumps(held), encoding="utf-8")

    return spoil


def raw(old: str, new: str, name: str = "transforms.json") -> Spoil:
    return spoiled(name, lambda data: data.replace(old.encode(), new.encode(), 1))


def saved(name: str, mode: str, kind: str = "png", **options: Any) -> Spoil:
    """The second image or mask again, by Pillow, with another kind of pixels."""

    def spoil(folder: Path) -> None:
        with Image.open(folder / name) as image:
            pixels = image.convert(mode)
        pixels.save(folder / name, format=kind, **options)

    return spoil


def pixels(name: str, image: np.ndarray, kind: str = ".png") -> Spoil:
    done, data = cv2.imencode(kind, image)
    assert done
    return content(name, data.tobytes())


def encoded(kind: str, part: float) -> Spoil:
    """The start of the second image in another format."""
    done, data = cv2.imencode(kind, SHOTS[1].image[..., :3])
    assert done
    return content(IMAGE, data.tobytes()[: int(part * len(data))])


def linked(name: str, target: str) -> Spoil:
    def spoil(folder: Path) -> None:
        (folder / name).unlink()
        (folder / name).symlink_to(target.format(folder.parent))

    return spoil


def renamed(old: str, new: str) -> Spoil:
    return lambda folder: (folder / old).rename(folder / new)


def both(*spoils: Spoil) -> Spoil:
    return lambda folder: [spoil(folder) for spoil in spoils]


def word(name: str, line: int, place: int, value: str) -> Spoil:
    def spoil(folder: Path) -> None:
        lines = (folder / name).read_text(encoding="utf-8").split("\n")
        words = lines[line].split()
        words[place] = value
        lines[line] = " ".join(words)
        (folder / name).write_text("\n".join(lines), encoding="utf-8")

    return spoil


def bits16(folder: Path) -> None:
    write_image(folder / IMAGE, SHOTS[1].image[..., :3].astype(np.uint16) * 257)


def png_of_size(width: int, height: int) -> bytes:
    import zlib

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"")) + chunk(b"IEND", b"")


NAN = [[float("nan")] * 4] * 4
READ, REFUSED = True, False
# What is spoiled, whether the scene is read all the same, and what is said.
NERFSTUDIO: dict[str, tuple[Spoil, bool, str]] = {
    "json of zeros": (content("transforms.json", b"\0" * 64), REFUSED, r"transforms.json: the JSON is not valid"),
    "json null": (content("transforms.json", b"null"), REFUSED, r"holds a null; expected an object"),
    "json empty object": (content("transforms.json", b"{}"), REFUSED, r"no 'frames'; found nothing"),
    "json in utf-16": (
        spoiled("transforms.json", lambda d: d.decode().encode("utf-16")),
        REFUSED,
        r"not text; expected",
    ),
    "json twice": (
        spoiled("transforms.json", lambda d: d + d),
        REFUSED,
        r"the JSON is not valid at line 1 \(Extra data",
    ),
    "json with byte order mark and CRLF": (
        spoiled("transforms.json", lambda d: b"\xef\xbb\xbf" + d.replace(b", ", b",\r\n")),
        READ,
        r"4 of 4 images have a mask",
    ),
    "json with a comment": (spoiled("transforms.json", lambda d: b"// mine\n" + d), REFUSED, r"is not valid at line 1"),
    "frames null": (document(frames=None), REFUSED, r"'frames' is not a list"),
    "frame null": (edited(lambda d: d["frames"].append(None)), REFUSED, r"frame 4 is not an object"),
    "frame list": (edited(lambda d: d["frames"].append([1])), REFUSED, r"frame 4 is not an object"),
    "pose nan": (frame(transform_matrix=NAN), REFUSED, r"transform_matrix\[0\]\[0\] is nan"),
    "pose null": (frame(transform_matrix=None), REFUSED, r"transform_matrix is not 4 rows of 4"),
    "pose of text": (frame(transform_matrix=[["1"] * 4] * 4), REFUSED, r"transform_matrix\[0\]\[0\] is a text"),
    "pose flat": (frame(transform_matrix=[1.0] * 16), REFUSED, r"transform_matrix is not 4 rows of 4"),
    "pose of a huge whole number": (
        raw('"transform_matrix": [[', '"transform_matrix": [[1' + "0" * 400 + ", "),
        REFUSED,
        r"not 4 rows of 4",
    ),
    "focal length of 400 digits": (
        raw('"fl_x": ', '"fl_x": 1' + "0" * 400),
        REFUSED,
        r"fl_x is .*expected a finite number",
    ),
    "focal length of 5000 digits": (
        raw('"fl_x": ', '"fl_x": 1' + "0" * 5000),
        REFUSED,
        r"fl_x is .*expected a finite number",
    ),
    "focal length true": (frame(fl_x=True), REFUSED, r"fl_x is a truth value"),
    "width zero": (frame(w=0), REFUSED, r"w is 0; expected pixels, more than 0"),
    "width of another shape": (frame(w=48), REFUSED, r"the image is 24x24 but w x h in the transforms is 48x24"),
    "width twice, height twice": (
        frame(w=48, h=48, fl_x=70.0, fl_y=70.0, cx=24, cy=24),
        READ,
        r"4 of 4 images have a mask",
    ),
    "camera model number": (document(camera_model=4), REFUSED, r"camera_model is 4; expected OPENCV"),
    "k1 list": (frame(k1=[0.1]), REFUSED, r"k1 is a list; expected a number"),
    "file_path null": (frame(file_path=None), REFUSED, r"frame 1: file_path is not a path"),
    "file_path of blanks": (frame(file_path="  "), REFUSED, r"frame 1: file_path is not a path"),
    "file_path with line breaks": (
        frame(file_path="a\nb\r.png"),
        READ,
        r"1 of 4 images are not there and are left out: a\?b\?",
    ),
    "file_path of dots": (
        frame(file_path="../../.."),
        READ,
        r"1 of 4 images are not there and are left out: ../../..\.",
    ),
    "mask_path list": (frame(mask_path=["a"]), REFUSED, r"mask_path is not a path"),
    "ply_file_path number": (document(ply_file_path=7), REFUSED, r"ply_file_path is not a path"),
    "ply that is none": (
        both(document(ply_file_path="a.ply"), content("a.ply", b"ply\nformat ascii")),
        REFUSED,
        r"a.ply: cannot be read as points",
    ),
    "ply outside": (document(ply_file_path="/etc/hostname"), READ, r"the points /etc/hostname that .* are not there"),
    "applied_transform nan": (document(applied_transform=NAN[:3]), REFUSED, r"applied_transform\[0\]\[0\] is nan"),
    "applied_scale zero": (document(applied_scale=0), REFUSED, r"applied_scale is 0; expected more than 0"),
    "train_filenames of numbers": (
        document(train_filenames=[1], test_filenames=["x"]),
        REFUSED,
        r"train_filenames is not a list of",
    ),
    "test_filenames of nobody": (
        document(test_filenames=["x.png"]),
        READ,
        r"4 train and 0 test views, .*; 1 of the names in them are of no frame \(x.png\)",
    ),
    "name in unicode": (
        both(
            renamed(IMAGE, "images/größe 日本.png"),
            renamed(MASK, "masks/größe 日本.png"),
            frame(file_path="images/größe 日本.png", mask_path="masks/größe 日本.png"),
        ),
        READ,
        r"4 of 4 images have a mask",
    ),
    "name in other unicode": (
        both(renamed(IMAGE, "images/gro\u0308\u00dfe.png"), frame(file_path="images/gr\u00f6\u00dfe.png")),
        READ,
        r"1 of 4 photographed images are found under a name in other case or encoding",
    ),
}
FILES: dict[str, tuple[Spoil, bool, str]] = {
    "image of no size": (content(IMAGE, png_of_size(0, 0)), REFUSED, r"r_01.png: not an image that can be decoded"),
    "image too large": (
        content(IMAGE, png_of_size(1 << 20, 1 << 20)),
        REFUSED,
        r"r_01.png: not an image that can be decoded",
    ),
    "image grey": (saved(IMAGE, "L"), READ, r"1 of 4 images are grey"),
    "image black and white": (saved(IMAGE, "1"), READ, r"1 of 4 images are grey"),
    "image with a palette": (saved(IMAGE, "P"), READ, r"4 of 4 images have a mask"),
    "image in cmyk": (saved(IMAGE, "CMYK", "jpeg"), READ, r"4 of 4 images have a mask"),
    "image of 16 bits": (bits16, READ, r"1 of 4 images have 16 bits"),
    "image of floats": (
        pixels(IMAGE, np.ones((24, 24, 3), np.float32), ".tiff"),
        REFUSED,
        r"pixels are float32; expected 8- or 16",
    ),
    "image of two channels": (saved(IMAGE, "LA"), READ, r"4 of 4 images have a mask"),
    "image of another size": (pixels(IMAGE, np.zeros((48, 48, 3), np.uint8)), READ, r"images come in 2 sizes"),
    "image of another shape": (pixels(IMAGE, np.zeros((24, 48, 3), np.uint8)), REFUSED, r"the image is 48x24"),
    "image is html": (content(IMAGE, b"<!DOCTYPE html>"), REFUSED, r"r_01.png: not an image that can be decoded"),
    "image is a pointer of git lfs": (
        content(IMAGE, b"version https://git-lfs.github.com/spec/v1\n"),
        REFUSED,
        r"a pointer of Git LFS",
    ),
    "webp cut": (encoded(".webp", 0.6), REFUSED, r"r_01.png: the image is damaged \(cut off"),
    "bmp cut": (encoded(".bmp", 0.6), REFUSED, r"r_01.png: the image is damaged \(cut off"),
    "tiff cut": (encoded(".tiff", 0.6), REFUSED, r"r_01.png: (the image is damaged|not an image)"),
    "avif cut": (encoded(".avif", 0.6), REFUSED, r"r_01.png: (the image is damaged|not an image)"),
    "jpeg of a head alone": (encoded(".jpg", 0.3), REFUSED, r"r_01.png: the image is damaged \(cut off"),
    "mask cut": (spoiled(MASK, lambda d: d[:-9]), REFUSED, r"masks/r_01.png: the image is damaged \(cut off"),
    "mask empty": (content(MASK, b""), REFUSED, r"masks/r_01.png: the image file is empty"),
    "mask of another shape": (
        pixels(MASK, np.zeros((24, 30), np.uint8)),
        REFUSED,
        r"the mask is 30x24, its image 24x24",
    ),
    "mask of one pixel": (pixels(MASK, np.full((1, 1), 255, np.uint8)), READ, r"4 of 4 images have a mask"),
    "mask with a palette": (saved(MASK, "P"), READ, r"4 of 4 images have a mask"),
    "mask of 16 bits": (
        pixels(MASK, SHOTS[1].image[..., 3].astype(np.uint16) * 257),
        READ,
        r"4 of 4 images have a mask",
    ),
    "mask black": (pixels(MASK, np.zeros((24, 24), np.uint8)), READ, r"1 of 4 train images are transparent"),
    "image linked to nothing": (
        linked(IMAGE, "{0}/nowhere.png"),
        READ,
        r"1 of 4 images are not there and are left out",
    ),
    "image linked to itself": (linked(IMAGE, "r_01.png"), READ, r"1 of 4 images are not there and are left out"),
    "image linked to a device": (linked(IMAGE, "/dev/zero"), READ, r"1 of 4 images are not there and are left out"),
    "two images of one name": (
        lambda f: save_jpeg(f / "images/r_01.jpg", SHOTS[1].image[..., :3]),
        READ,
        r"1 files in images/ .* not used \(r_01.jpg\)",
    ),
}
COLMAP: dict[str, tuple[Spoil, bool, str]] = {
    "model with byte order mark and CRLF": (
        spoiled(IMAGES, lambda d: b"\xef\xbb\xbf" + d.replace(b"\n", b"\r\n")),
        READ,
        r"4 of 4 images have a mask",
    ),
    "cameras empty": (content(CAMERAS, b""), REFUSED, r"names camera 1, which cameras.txt does not have"),
    "camera twice": (spoiled(CAMERAS, lambda d: d + d), REFUSED, r"cameras.txt: line 4: there is a camera 1 before"),
    "camera of no size": (word(CAMERAS, 1, 2, "0"), REFUSED, r"line 2: the size is 0x24"),
    "camera of a huge size": (word(CAMERAS, 1, 2, "9" * 30), REFUSED, r"line 2: the size is 9+x24"),
    "camera of 5000 digits": (word(CAMERAS, 1, 2, "9" * 5000), REFUSED, r"line 2: '9+' is no whole number"),
    "focal length nan": (word(CAMERAS, 1, 4, "nan"), REFUSED, r"line 2: a parameter is not finite"),
    "focal length negative": (word(CAMERAS, 1, 4, "-50"), REFUSED, r"camera 1: the focal length is -50"),
    "focal length huge": (word(CAMERAS, 1, 4, "1e300"), REFUSED, r"camera 1: the focal length is 1e\+300"),
    "principal point far": (word(CAMERAS, 1, 6, "1e12"), REFUSED, r"camera 1: the principal point is 1e\+12"),
    "camera of another shape": (
        word(CAMERAS, 1, 2, "48"),
        REFUSED,
        r"the image is 24x24, its camera in the model 48x24",
    ),
    "pose inf": (word(IMAGES, 1, 5, "inf"), REFUSED, r"line 2: the pose holds a number that is not finite"),
    "image number twice": (word(IMAGES, 3, 0, "1"), REFUSED, r"line 4: image 1 is r_01.png here and r_00.png before"),
    "image number text": (word(IMAGES, 1, 0, "a"), REFUSED, r"line 2: 'a' is no whole number"),
    "decimal commas": (spoiled(IMAGES, lambda d: d.replace(b".", b",")), REFUSED, r"line 2: '.*' is no number"),
    "binary called text": (
        content(IMAGES, struct.pack("<Qi7d", 1, 1, *[0.5] * 7)),
        REFUSED,
        r"images.txt: (not text|line 1)",
    ),
    "points nan": (
        content(POINTS, b"1 nan 0 0 1 2 3 0.5\n2 0 0 0 1 2 3 0.5\n"),
        READ,
        r"1 of 2 points in points3D.txt are nowhere",
    ),
    "points3D.txt is a folder": (
        lambda f: ((f / POINTS).unlink(), (f / POINTS).mkdir()),
        READ,
        r"there is no points3D.txt beside the cameras",
    ),
    "name of blanks": (
        spoiled(IMAGES, lambda d: d.replace(b"r_01.png", b"  ")),
        REFUSED,
        r"images.txt: line 4: expected IMAGE_ID",
    ),
}
LAYOUTS: dict[str, tuple[Callable[[Path], Path], dict[str, tuple[Spoil, bool, str]]]] = {
    "nerfstudio": (lambda folder: write_nerfstudio(folder, SHOTS), NERFSTUDIO),
    "files": (lambda folder: write_colmap(folder, SHOTS, text=True, points=np.ones((40, 3))), FILES),
    "COLMAP": (lambda folder: write_colmap(folder, SHOTS, text=True, points=np.ones((40, 3))), COLMAP),
}
CASES = [(layout, case) for layout, (_, cases) in LAYOUTS.items() for case in cases]


def read(folder: Path) -> Scene:
    return AutoDatasetConfig(box=BOX).build(str(folder)).load()


@pytest.mark.parametrize(("layout", "case"), CASES, ids=[f"{layout}: {case}" for layout, case in CASES])
def test_a_note_or_one_line(layout: str, case: str, tmp_path: Path):
    write, cases = LAYOUTS[layout]
    spoil, is_read, said = cases[case]
    folder = write(tmp_path / "scene")
    spoil(folder)
    before = sorted(os.walk(tmp_path))
    if is_read:
        scene = read(folder)
        assert 3 <= len(scene.train) <= len(SHOTS)
        assert all(np.isfinite(view.rgb.numpy()).all() for view in scene.train)
        (note, *_) = [note for note in scene.notes if re.search(said, note)]
        assert "\n" not in note
    else:
        with pytest.raises(DataError, match=said) as caught:
            read(folder)
        assert "\n" not in str(caught.value)
        assert len(str(caught.value)) < 800
        assert str(caught.value).endswith((".", "?"))
    assert sorted(os.walk(tmp_path)) == before


def test_there_are_sixty_of_them():
    assert len(CASES) >= 60
