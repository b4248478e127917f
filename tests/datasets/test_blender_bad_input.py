"""Everything that can be wrong with a folder gets one line that names the file and says what was expected."""

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from plain_scenes import ball, edit_transforms, load, make_scene, write_image, write_transforms

from sculpt_framework.errors import DataError

Spoil = Callable[[Path], object]


def _text(change: Callable[[str], str]) -> Spoil:
    def spoil(folder: Path) -> None:
        path = folder / "transforms_train.json"
        path.write_text(change(path.read_text(encoding="utf-8")), encoding="utf-8")

    return spoil


def _document(key: str, value: object) -> Spoil:
    return lambda folder: edit_transforms(folder, lambda document: document.update({key: value}))


def _renamed(old: str, new: str) -> Spoil:
    return _text(lambda text: text.replace(f'"{old}"', f'"{new}"'))


def _frame(key: str, value: object) -> Spoil:
    return lambda folder: edit_transforms(folder, lambda document: document["frames"][1].update({key: value}))


def _matrix(change: Callable[[np.ndarray], object]) -> Spoil:
    def edit(document: dict) -> None:
        matrix = np.array(document["frames"][1]["transform_matrix"])
        change(matrix)
        document["frames"][1]["transform_matrix"] = matrix.tolist()

    return lambda folder: edit_transforms(folder, edit)


def _image_bytes(change: Callable[[bytes], bytes]) -> Spoil:
    def spoil(folder: Path) -> None:
        path = folder / "train" / "r_1.png"
        path.write_bytes(change(path.read_bytes()))

    return spoil


def _set(where: tuple[int, int], value: float) -> Callable[[np.ndarray], object]:
    return lambda matrix: matrix.__setitem__(where, value)


def _without(document: dict, key: str) -> None:
    del document[key]


def _transparent(folder: Path) -> None:
    for path in (folder / "train").iterdir():
        image = ball()
        image[..., 3] = 0
        write_image(path, image)


CASES: dict[str, tuple[Spoil, str]] = {
    "no transforms": (lambda f: (f / "transforms_train.json").unlink(), r"no transforms_train.json; found train/"),
    "empty json": (_text(lambda text: ""), r"transforms_train.json: the file is empty"),
    "cut json": (_text(lambda text: text[: len(text) // 2]), r"the JSON is cut off at line 1"),
    "wrong json": (_text(lambda text: text.replace(":", ";", 1)), r"the JSON is not valid at line 1"),
    "binary json": (lambda f: (f / "transforms_train.json").write_bytes(b"\xff\xfe\x00{"), r"not text; expected JSON"),
    "deep json": (_text(lambda text: "[" * 100_000), r"the JSON cannot be read"),
    "json list": (lambda f: write_transforms(f, [1]), r"holds a list; expected an object"),
    "no angle": (
        lambda f: edit_transforms(f, lambda d: _without(d, "camera_angle_x")),
        r"frame 0 \(./train/r_0\): no focal length; expected camera_angle_x in radians or fl_x in pixels\.",
    ),
    "misspelt angle": (_renamed("camera_angle_x", "camera_angel_x"), r"no focal length.*by 'camera_angel_x'"),
    "angle zero": (_document("camera_angle_x", 0), r"camera_angle_x is 0; expected radians between 0 and pi"),
    "angle degrees": (_document("camera_angle_x", 40.0), r"camera_angle_x is 40;.*\(40 degrees are 0.6981\)"),
    "angle negative": (_document("camera_angle_x", -0.7), r"camera_angle_x is -0.7; expected radians"),
    "angle text": (_document("camera_angle_x", "0.7"), r"camera_angle_x is a text; expected a number"),
    "angle nan": (_document("camera_angle_x", math.nan), r"camera_angle_x is nan; expected a finite number"),
    "angle huge": (_text(lambda t: re.sub(r'x": [\d.]+', 'x": 1' + "0" * 400, t)), r"camera_angle_x is inf; expected"),
    "focal zero": (_document("fl_x", 0), r"fl_x is 0; expected pixels, more than 0"),
    "width negative": (_document("w", -40), r"w is -40; expected pixels"),
    "size of another shape": (lambda f: (_document("w", 80)(f), _document("h", 40)(f)), r"is 40x40 but .* is 80x40"),
    "distortion": (_document("k1", 0.1), r"k1 is not 0; this layout has pinhole cameras only"),
    "no frames key": (
        lambda f: edit_transforms(f, lambda d: _without(d, "frames")),
        r"no 'frames'; found camera_angle",
    ),
    "misspelt frames": (_renamed("frames", "frame"), r"no 'frames'; did you mean it by 'frame'\?"),
    "frames empty": (_document("frames", []), r"'frames' is empty; expected one object per image"),
    "frames no list": (_document("frames", {"a": 1}), r"'frames' is not a list"),
    "frame no object": (_document("frames", [3]), r"frame 0 is not an object; expected file_path"),
    "no file_path": (_renamed("file_path", "path"), r"frame 0: no 'file_path'"),
    "file_path number": (_frame("file_path", 7), r"frame 1: file_path is not a path"),
    "misspelt matrix": (_renamed("transform_matrix", "transform-matrx"), r"did you mean it by 'transform-matrx'\?"),
    "matrix missing": (_renamed("transform_matrix", "pose"), r"frame 0 .*no 'transform_matrix'; found file_path, pose"),
    "matrix 2x2": (_frame("transform_matrix", [[1, 0], [0, 1]]), r"frame 1.*not 4 rows of 4 numbers"),
    "matrix text": (_frame("transform_matrix", "eye"), r"frame 1.*not 4 rows of 4 numbers"),
    "matrix null": (_frame("transform_matrix", [[None] * 4] * 4), r"transform_matrix\[0\]\[0\] is a null; expected"),
    "matrix nan": (_matrix(_set((0, 3), math.nan)), r"transform_matrix\[0\]\[3\] is nan; expected a finite number"),
    "matrix inf": (_matrix(_set((1, 1), math.inf)), r"transform_matrix\[1\]\[1\] is inf; expected a finite number"),
    "matrix zero": (_matrix(lambda m: m[:3].fill(0)), r"transform_matrix is singular"),
    "matrix singular": (_matrix(lambda m: m[:, 0].fill(0)), r"transform_matrix is singular"),
    "matrix mirrored": (_matrix(lambda m: m.__imul__([-1, 1, 1, 1])), r"transform_matrix mirrors"),
    "matrix stretched": (_matrix(lambda m: m.__imul__([1, 2, 1, 1])), r"stretches its axes by 2, 1, 1"),
    "matrix last row": (_matrix(_set((3, 0), 1.0)), r"the last row of transform_matrix is \[1.0"),
    "matrix far": (_matrix(_set((0, 3), 1e12)), r"transform_matrix holds 1e\+12"),
    "image empty": (_image_bytes(lambda data: b""), r"r_1.png: the image file is empty"),
    "image truncated": (_image_bytes(lambda data: data[: len(data) // 2]), r"r_1.png: the image is damaged \(cut off"),
    "image cut at its end": (_image_bytes(lambda data: data[:-8]), r"r_1.png: the image is damaged \(cut off"),
    "image flipped byte": (
        _image_bytes(lambda data: data[:60] + bytes([data[60] ^ 1]) + data[61:]),
        r"r_1.png: the image is damaged \(a checksum does not match\)",
    ),
    "image is text": (_image_bytes(lambda data: b"not found"), r"r_1.png: not an image that can be decoded"),
    "all transparent": (_transparent, r"all 6 train images are transparent \(such as .*r_0.png"),
}


LEFT_OUT: dict[str, tuple[Spoil, str]] = {
    "image missing": (lambda f: (f / "train" / "r_1.png").unlink(), "./train/r_1"),
    "image folder missing": (_frame("file_path", "./trian/r_7"), "./trian/r_7"),
    "image misspelt": (_frame("file_path", "./train/r_l1.png"), "./train/r_l1.png"),
    "image is a folder": (
        lambda f: ((f / "train" / "r_1.png").unlink(), (f / "train" / "r_1.png").mkdir()),
        "./train/r_1",
    ),
    "path up": (_frame("file_path", "../../etc/passwd"), "../../etc/passwd"),
    "path up inside": (_frame("file_path", "./train/../../x.png"), "./train/../../x.png"),
    "path absolute": (_frame("file_path", "/etc/passwd"), "/etc/passwd"),
    "path drive": (_frame("file_path", "C:\\x.png"), "C:\\x.png"),
    "path zero byte": (_frame("file_path", "./train/\0"), "./train/?"),
    "path is the folder": (_frame("file_path", "./"), "./"),
    "path too long": (_frame("file_path", "./" + "x" * 5000), "xxx...xxx"),
}


@pytest.mark.parametrize(("spoil", "name"), LEFT_OUT.values(), ids=LEFT_OUT.keys())
def test_frames_without_an_image_are_left_out(scene: Path, spoil: Spoil, name: str) -> None:
    spoil(scene)
    loaded = load(scene)
    assert [view.name for view in loaded.train] == [f"train/r_{index}" for index in (0, 2, 3, 4, 5)]
    (note,) = [note for note in loaded.notes if note.startswith("1 of 6 images are not there and are left out: ")]
    assert name in note
    assert len(note) < 400


@pytest.mark.parametrize(("spoil", "message"), CASES.values(), ids=CASES.keys())
def test_one_clear_line(scene: Path, spoil: Spoil, message: str) -> None:
    spoil(scene)
    with pytest.raises(DataError, match=message) as caught:
        load(scene)
    assert "\n" not in str(caught.value)
    assert str(caught.value).endswith((".", "?"))


def test_poses_of_another_convention_are_named(scene: Path) -> None:
    """OpenCV axes in place of OpenGL's: all cameras look away from the object."""

    def flip(document: dict) -> None:
        for frame in document["frames"]:
            frame["transform_matrix"] = (np.array(frame["transform_matrix"]) * [1, -1, -1, 1]).tolist()

    edit_transforms(scene, flip)
    with pytest.raises(DataError, match=r"poses and images do not fit together.*OpenGL axes"):
        load(scene)


def test_no_such_folder(tmp_path: Path) -> None:
    with pytest.raises(DataError, match=r"nowhere: no such folder; expected a scene folder, or demo"):
        load(tmp_path / "nowhere")


def test_file_in_place_of_a_folder(scene: Path) -> None:
    with pytest.raises(DataError, match=r"transforms_train.json: is a file; give the folder it is in"):
        load(scene / "transforms_train.json")


def test_folder_of_scenes_names_them(tmp_path: Path) -> None:
    make_scene(tmp_path / "one", views=1)
    make_scene(tmp_path / "two", views=1)
    with pytest.raises(DataError, match=r"found scenes inside it \(one, two\): give one of them"):
        load(tmp_path)


def test_cheap_checks_come_before_decoding(scene: Path) -> None:
    """A mistake in the last frame is found although the first image is no image."""
    (scene / "train" / "r_0.png").write_bytes(b"garbage")
    edit_transforms(scene, lambda document: document["frames"][-1].pop("transform_matrix"))
    with pytest.raises(DataError, match=r"frame 5.*no 'transform_matrix'"):
        load(scene)


def test_test_split_is_checked_too(scene: Path) -> None:
    write_transforms(scene, {"camera_angle_x": 0.7, "frames": []}, "test")
    with pytest.raises(DataError, match=r"transforms_test.json: 'frames' is empty"):
        load(scene)
