"""Everything that can be wrong with photographs and their cameras gets one line, in every layout."""

import json
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from layouts import make_shots, write_colmap, write_idr, write_nerfstudio
from plain_scenes import write_image

from sculpt_framework.errors import DataError
from sculpt_plugins.datasets.auto.config import AutoDatasetConfig
from sculpt_plugins.datasets.colmap.config import ColmapConfig
from sculpt_plugins.datasets.idr.config import IdrConfig
from sculpt_plugins.datasets.nerfstudio.config import NerfstudioConfig

Spoil = Callable[[Path], object]
SHOTS = make_shots(3, 24)


def _bytes(name: str, change: Callable[[bytes], bytes]) -> Spoil:
    return lambda folder: (folder / name).write_bytes(change((folder / name).read_bytes()))


def _lines(name: str, number: int, change: Callable[[list[str]], Sequence[str]]) -> Spoil:
    """Change the words of a line, counted from 0, comments too."""

    def spoil(folder: Path) -> None:
        lines = (folder / name).read_text(encoding="utf-8").split("\n")
        lines[number] = " ".join(change(lines[number].split()))
        (folder / name).write_text("\n".join(lines), encoding="utf-8")

    return spoil


def _word(name: str, number: int, place: int, value: str) -> Spoil:
    return _lines(name, number, lambda words: [*words[:place], value, *words[place + 1 :]])


def _pack(name: str, offset: int, layout: str, value: float) -> Spoil:
    def change(data: bytes) -> bytes:
        return data[:offset] + struct.pack(layout, value) + data[offset + struct.calcsize(layout) :]

    return _bytes(name, change)


def _key(key: str, value: object) -> Spoil:
    def spoil(folder: Path) -> None:
        document = json.loads((folder / "transforms.json").read_text(encoding="utf-8"))
        document[key] = value
        (folder / "transforms.json").write_text(json.dumps(document), encoding="utf-8")

    return spoil


def _frame(key: str, value: object) -> Spoil:
    def spoil(folder: Path) -> None:
        document = json.loads((folder / "transforms.json").read_text(encoding="utf-8"))
        document["frames"][1][key] = value
        (folder / "transforms.json").write_text(json.dumps(document), encoding="utf-8")

    return spoil


def _drop(key: str) -> Spoil:
    def spoil(folder: Path) -> None:
        document = json.loads((folder / "transforms.json").read_text(encoding="utf-8"))
        del document["frames"][1][key]
        (folder / "transforms.json").write_text(json.dumps(document), encoding="utf-8")

    return spoil


def _arrays(change: Callable[[dict[str, np.ndarray]], object]) -> Spoil:
    def spoil(folder: Path) -> None:
        arrays = dict(np.load(folder / "cameras.npz"))
        change(arrays)
        np.savez(folder / "cameras.npz", **arrays)

    return spoil


def _both(*spoils: Spoil) -> Spoil:
    return lambda folder: [spoil(folder) for spoil in spoils]


def _remove(name: str) -> Spoil:
    return lambda folder: (folder / name).unlink()


def _rename(old: str, new: str) -> Spoil:
    return lambda folder: (folder / old).rename(folder / new)


def _edited(matrix: np.ndarray, place: tuple[int, int], value: float) -> np.ndarray:
    out = matrix.copy()
    out[place] = value
    return out


IMAGE, MASK = "images/r_01.png", "masks/r_01.png"
EYE = np.eye(4).tolist()
SPARSE = "sparse/0"

NERFSTUDIO: dict[str, tuple[Spoil, str]] = {
    "empty": (_bytes("transforms.json", lambda d: b""), r"transforms.json: the file is empty"),
    "cut": (_bytes("transforms.json", lambda d: d[: len(d) // 2]), r"the JSON is cut off at line 1"),
    "no frames": (_key("frames", []), r"'frames' is empty"),
    "no focal length": (_drop("fl_x"), r"frame 1 .*: no focal length"),
    "focal length text": (_frame("fl_x", "70"), r"fl_x is a text"),
    "no matrix": (_drop("transform_matrix"), r"frame 1 .*no 'transform_matrix'"),
    "matrix mirrored": (_frame("transform_matrix", np.diag([-1.0, 1, 1, 1]).tolist()), r"transform_matrix mirrors"),
    "matrix nan": (_frame("transform_matrix", [[float("nan")] * 4] * 4), r"\[0\]\[0\] is nan"),
    "no file_path": (_drop("file_path"), r"frame 1: no 'file_path'"),
    "path up": (
        _frame("file_path", "../x.png"),
        r"1 of 3 images are not there \(../x.png\), which leaves 2; expected 3",
    ),
    "image missing": (_remove(IMAGE), r"1 of 3 images are not there \(images/r_01.png\), which leaves 2"),
    "image cut": (_bytes(IMAGE, lambda d: d[:-20]), r"r_01.png: the image is damaged"),
    "image empty": (_bytes(IMAGE, lambda d: b""), r"r_01.png: the image file is empty"),
    "image of another shape": (
        lambda f: write_image(f / IMAGE, np.zeros((24, 48, 3), np.uint8)),
        r"the image is 48x24 but w x h in the transforms is 24x24",
    ),
    "mask missing": (_remove(MASK), r"frame 1 .*there is no mask .*r_01.png in .*; leave mask_path out"),
    "mask number": (_frame("mask_path", 3), r"mask_path is not a path"),
    "mask outside": (_frame("mask_path", "/etc/passwd"), r"there is no mask /etc/passwd in .*scene; leave mask_path"),
    "mask cut": (_bytes(MASK, lambda d: d[:-20]), r"masks/r_01.png: the image is damaged"),
    "mask of another shape": (
        lambda f: write_image(f / MASK, np.zeros((24, 48), np.uint8)),
        r"the mask is 48x24, its image 24x24; expected the same shape",
    ),
    "masks all black": (
        lambda f: [write_image(f / "masks" / f"{shot.name}.png", np.zeros((24, 24), np.uint8)) for shot in SHOTS],
        r"all 3 train images are transparent",
    ),
    "k1 text": (_key("k1", "a"), r"k1 is a text; expected a number"),
    "k1 nan": (_key("k1", float("nan")), r"k1 is nan; expected a finite number"),
    "k1 folds": (_key("k1", -9.0), r"r_0\d.png: the calibration diverged: .* \(k1 -9, focal length"),
    "k4 of a perspective lens": (_key("k4", 0.1), r"k4 is not 0; it is read for camera_model OPENCV_FISHEYE only"),
    "p1 of a fisheye": (_both(_key("camera_model", "OPENCV_FISHEYE"), _key("p1", 0.1)), r"p1 and p2 are not 0"),
    "panorama": (_key("camera_model", "EQUIRECTANGULAR"), r"camera_model is 'EQUIRECTANGULAR'; expected OPENCV"),
    "applied_transform": (_key("applied_transform", [[1, 2], [3, 4]]), r"applied_transform is not 4 rows"),
    "applied_transform scales": (_key("applied_transform", np.diag([2.0, 2, 2, 1]).tolist()), r"scales by 2"),
    "applied_scale": (_key("applied_scale", 0), r"applied_scale is 0; expected more than 0"),
    "points no path": (_key("ply_file_path", 3), r"ply_file_path is not a path"),
    "points damaged": (
        _both(_key("ply_file_path", "p.ply"), lambda f: (f / "p.ply").write_bytes(b"ply\nwhat")),
        r"p.ply: cannot be read as points",
    ),
    "list of names": (_key("test_filenames", "r_01.png"), r"test_filenames is not a list of file names"),
    "list of others": (
        _both(_key("train_filenames", ["x"]), _key("test_filenames", ["images/r_01.png"])),
        r"train_filenames names none of the 3 frames",
    ),
}
COLMAP_BINARY: dict[str, tuple[Spoil, str]] = {
    "no photographs": (
        _rename("images", "photos"),
        r"no folder images/ of photographs; found masks/, photos/, sparse/",
    ),
    "other photographs": (
        lambda f: [(f / "images" / f"{shot.name}.png").rename(f / "images" / f"x{shot.name}.png") for shot in SHOTS],
        r"none of the 3 images of .* is here, such as r_00.png",
    ),
    "cameras empty": (_bytes(f"{SPARSE}/cameras.bin", lambda d: b""), r"cameras.bin: the file is cut off at byte 0"),
    "cameras cut": (_bytes(f"{SPARSE}/cameras.bin", lambda d: d[:-1]), r"cameras.bin: the file is cut off"),
    "cameras too long": (_bytes(f"{SPARSE}/cameras.bin", lambda d: d + b"x"), r"cameras.bin: 1 bytes too many"),
    "many cameras": (_pack(f"{SPARSE}/cameras.bin", 0, "<Q", 10**15), r"announces 1000000000000000 cameras"),
    "unknown model": (_pack(f"{SPARSE}/cameras.bin", 12, "<i", 77), r"camera 1: camera model 77 is not known"),
    "FOV model": (_pack(f"{SPARSE}/cameras.bin", 12, "<i", 7), r"camera model FOV is not read; run COLMAP with one of"),
    "no width": (_pack(f"{SPARSE}/cameras.bin", 16, "<Q", 0), r"camera 1: the size is 0x24"),
    "another shape": (
        _pack(f"{SPARSE}/cameras.bin", 16, "<Q", 48),
        r"the image is 24x24, its camera in the model 48x24",
    ),
    "focal length 0": (_pack(f"{SPARSE}/cameras.bin", 32, "<d", 0.0), r"the focal length is 0; expected pixels"),
    "focal length nan": (_pack(f"{SPARSE}/cameras.bin", 32, "<d", float("nan")), r"a parameter is not finite"),
    "images cut": (_bytes(f"{SPARSE}/images.bin", lambda d: d[:-5]), r"images.bin: .*the file is cut off"),
    "no images": (_bytes(f"{SPARSE}/images.bin", lambda d: bytes(8)), r"images.bin: holds no image"),
    "quaternion": (_pack(f"{SPARSE}/images.bin", 12, "<d", 7.0), r"r_00.png: the quaternion has length"),
    "position nan": (_pack(f"{SPARSE}/images.bin", 44, "<d", float("nan")), r"the pose holds a number that is not"),
    "position far": (_pack(f"{SPARSE}/images.bin", 44, "<d", 1e12), r"the position holds 1e\+12"),
    "camera not there": (_pack(f"{SPARSE}/images.bin", 68, "<i", 9), r"r_00.png names camera 9, which cameras.bin"),
    "name no text": (_bytes(f"{SPARSE}/images.bin", lambda d: d.replace(b"r_00", b"\xff\xfe\xff\xff")), r"is not text"),
    "name without end": (
        _bytes(f"{SPARSE}/images.bin", lambda d: d[:72] + b"x" * 9000),
        r"the name of an image has no end",
    ),
    "name outside": (
        _both(
            _bytes(f"{SPARSE}/images.bin", lambda d: d.replace(b"r_00.png", b"../1.png")),
            lambda f: write_image(f / "1.png", np.zeros((24, 24, 3), np.uint8)),
        ),
        r"1 of 3 images are not there \(../1.png\), which leaves 2",
    ),
    "points cut": (_bytes(f"{SPARSE}/points3D.bin", lambda d: d[:-3]), r"points3D.bin: .*the file is cut off"),
    "many points": (_pack(f"{SPARSE}/points3D.bin", 0, "<Q", 10**9), r"announces 1000000000 points"),
    "image damaged": (_bytes(IMAGE, lambda d: d[:60] + b"\0" + d[61:]), r"r_01.png: the image is damaged"),
    "image empty": (_bytes(IMAGE, lambda d: b""), r"r_01.png: the image file is empty"),
    "masks of other names": (
        lambda f: [(f / "masks" / f"{shot.name}.png").rename(f / "masks" / f"x{shot.name}.png") for shot in SHOTS],
        r"masks: holds 3 masks \(xr_00.png, ...\), none named after an image; expected names such as r_00.png",
    ),
}
CAMERAS, IMAGES, POINTS = (f"{SPARSE}/{name}.txt" for name in ("cameras", "images", "points3D"))
COLMAP_TEXT: dict[str, tuple[Spoil, str]] = {
    "no text": (_bytes(CAMERAS, lambda d: b"\xff\xfe\x00"), r"cameras.txt: not text"),
    "camera short": (_lines(CAMERAS, 1, lambda w: w[:4]), r"cameras.txt: line 2: expected CAMERA_ID MODEL WIDTH"),
    "model": (_word(CAMERAS, 1, 1, "PINHOLL"), r"line 2: camera model 'PINHOLL' is not known; expected one of SIMPLE"),
    "parameters": (_lines(CAMERAS, 1, lambda w: w[:-1]), r"line 2: PINHOLE has 4 parameters; found 3"),
    "width": (_word(CAMERAS, 1, 2, "wide"), r"line 2: 'wide' is no whole number"),
    "focal length": (_word(CAMERAS, 1, 4, "f"), r"line 2: 'f' is no number"),
    "image short": (_lines(IMAGES, 1, lambda w: w[:6]), r"images.txt: line 2: expected IMAGE_ID QW"),
    "quaternion": (_word(IMAGES, 1, 1, "x"), r"images.txt: line 2: 'x' is no number"),
    "quaternion 0": (
        _lines(IMAGES, 1, lambda w: [w[0], "0", "0", "0", "0", *w[5:]]),
        r"line 2: the quaternion has length 0; expected 1",
    ),
    "camera": (_word(IMAGES, 1, 8, "one"), r"line 2: 'one' is no whole number"),
    "camera not there": (_word(IMAGES, 1, 8, "5"), r"r_00.png names camera 5, which cameras.txt does not have"),
    "observations twice": (
        _bytes(IMAGES, lambda d: d.replace(b"1.0 2.0 -1\n", b"1.0 2.0 -1\n1.0 2.0 -1\n")),
        r"images.txt: line 6: expected IMAGE_ID QW .* NAME, or behind it the image's observations",
    ),
    "observations cut": (
        _bytes(IMAGES, lambda d: d.replace(b"1.0 2.0 -1\n", b"1.0 2.0\n")),
        r"images.txt: line 5: expected IMAGE_ID QW .* or behind it the image's observations",
    ),
    "no images": (_bytes(IMAGES, lambda d: b"# nothing\n"), r"images.txt: holds no image"),
    "point short": (_bytes(POINTS, lambda d: b"1 2 3\n"), r"points3D.txt: line 1: expected POINT3D_ID X Y Z"),
    "point text": (_bytes(POINTS, lambda d: b"1 2 3 z 0 0 0 0\n"), r"points3D.txt: line 1: 'z' is no number"),
}
IDR: dict[str, tuple[Spoil, str]] = {
    "no archive": (_bytes("cameras.npz", lambda d: b"hello"), r"cameras.npz: (not an archive|the archive)"),
    "empty": (_bytes("cameras.npz", lambda d: b""), r"cameras.npz: (not an archive|the archive|cannot be read)"),
    "cut": (_bytes("cameras.npz", lambda d: d[: len(d) // 2]), r"cameras.npz: not an archive of arrays"),
    "pickled": (_arrays(lambda a: a.update(world_mat_0=np.array([{}]))), r"cameras.npz: not an archive of arrays"),
    "no matrices": (_arrays(lambda a: [a.pop(k) for k in list(a)]), r"no world_mat_0"),
    "too few": (_arrays(lambda a: a.pop("world_mat_2")), r"3 images need as many matrices world_mat_I, found 2"),
    "shape": (_arrays(lambda a: a.update(world_mat_1=np.eye(3))), r"world_mat_1 has shape \(3, 3\); expected 4 x 4"),
    "nan": (
        _arrays(lambda a: a.update(world_mat_1=_edited(a["world_mat_1"], (0, 0), np.nan))),
        r"world_mat_1 holds a number that is not finite",
    ),
    "far": (
        _arrays(lambda a: a.update(world_mat_1=_edited(a["world_mat_1"], (0, 3), 1e13))),
        r"world_mat_1 holds 1e\+13",
    ),
    "singular": (_arrays(lambda a: a.update(world_mat_1=np.zeros((4, 4)))), r"world_mat_1 is singular"),
    "sheared": (
        _arrays(
            lambda a: a.update(world_mat_0=np.array([[50, 9, 12, 0], [0, 50, 12, 0], [0, 0, 1, 4], [0, 0, 0, 1.0]]))
        ),
        r"world_mat_0 has pixels that are sheared by 0.18",
    ),
    "scale singular": (_arrays(lambda a: a.update(scale_mat_0=np.zeros((4, 4)))), r"scale_mat_0 is singular"),
    "no images": (_rename("image", "other"), r"no folder image/ of images; found cameras.npz"),
    "empty folder": (
        lambda f: [p.unlink() for p in (f / "image").iterdir()],
        r"image: no images in it; found an empty",
    ),
    "image empty": (_bytes("image/r_01.png", lambda d: b""), r"r_01.png: the image file is empty"),
    "image no image": (_bytes("image/r_01.png", lambda d: b"what"), r"r_01.png: not an image that can be decoded"),
    "mask of another shape": (
        lambda f: write_image(f / "mask/r_01.png", np.zeros((30, 24), np.uint8)),
        r"the mask is 24x30, its image 24x24",
    ),
}
LAYOUTS: dict[str, tuple[Callable[[Path], Path], dict[str, tuple[Spoil, str]]]] = {
    "nerfstudio": (lambda folder: write_nerfstudio(folder, SHOTS), NERFSTUDIO),
    "COLMAP binary": (lambda folder: write_colmap(folder, SHOTS, points=np.ones((2, 3))), COLMAP_BINARY),
    "COLMAP text": (lambda folder: write_colmap(folder, SHOTS, text=True, points=np.ones((2, 3))), COLMAP_TEXT),
    "IDR": (lambda folder: write_idr(folder, SHOTS), IDR),
}
CASES = [(layout, case) for layout, (_, cases) in LAYOUTS.items() for case in cases]


@pytest.mark.parametrize(("layout", "case"), CASES, ids=[f"{layout}: {case}" for layout, case in CASES])
def test_one_clear_line(layout: str, case: str, tmp_path: Path):
    write, cases = LAYOUTS[layout]
    spoil, message = cases[case]
    folder = write(tmp_path / "scene")
    spoil(folder)
    before = sorted(path for path in tmp_path.rglob("*"))
    with pytest.raises(DataError, match=message) as caught:
        AutoDatasetConfig().build(str(folder)).load()
    assert "\n" not in str(caught.value)
    assert str(caught.value).endswith((".", "?"))
    assert sorted(path for path in tmp_path.rglob("*")) == before


def test_there_are_enough_cases():
    assert len(CASES) >= 60


@pytest.mark.parametrize(
    ("config", "message"),
    [
        (NerfstudioConfig(), r"no transforms.json; found sparse/"),
        (ColmapConfig(), r"no sparse model in sparse/0, .*; found sparse/"),
        (IdrConfig(), r"no cameras_sphere.npz or cameras.npz; found sparse/"),
        (ColmapConfig(model="sparse/7"), r"sparse/7: no sparse model"),
    ],
)
def test_another_layout_than_was_named(config: Any, message: str, tmp_path: Path):
    (tmp_path / "sparse").mkdir()
    with pytest.raises(DataError, match=message):
        config.build(str(tmp_path)).load()
