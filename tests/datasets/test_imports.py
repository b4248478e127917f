"""Scenes as other programs and phones leave them: read, with a note on what was done, in every layout that has it."""

import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import torch
from layouts import (
    WRITERS,
    save_jpeg,
    write_colmap,
)
from messy_scenes import (
    MASKED,
    SHOTS,
    Write,
    binary_model,
    edit,
    every_layout,
    has_the_masks,
    idr,
    image_folder,
    noted,
    read,
    synthetic,
    text_model,
    transforms,
)
from PIL import Image

from sculpt_framework.errors import DataError
from sculpt_framework.types import Scene
from sculpt_plugins.datasets.colmap.config import ColmapConfig

# Files of images.


@pytest.mark.parametrize("behind", [b"\0" * 100_000, b"\0\0\0\x18ftypmp42" + b"film" * 5000 + b"\xff\xd8\xff\xe1"])
@every_layout
def test_bytes_behind_the_end_of_a_jpeg(write: Write, behind: bytes, tmp_path: Path):
    """A motion photograph has a film there; what counts is the image's own end."""
    folder = write(tmp_path / "s")
    path = image_folder(folder) / "r_01.png"
    save_jpeg(path, SHOTS[1].image[..., :3])
    whole = path.read_bytes()
    path.write_bytes(whole + behind)
    view = next(view for view in read(folder).train if view.name.endswith("r_01"))
    assert np.abs(view.rgb.numpy()[..., ::-1] - SHOTS[1].image[..., :3] / 255).mean() < 0.05
    path.write_bytes(whole[: len(whole) // 2] + behind)
    with pytest.raises(DataError, match=r"r_01.png: the image is damaged \(cut off"):
        read(folder)


@pytest.mark.parametrize("extension", [".heic", ".avif", ".webp", ".tiff", ".JPG", ".bmp", ""])
def test_a_name_without_extension_whatever_the_type(extension: str, tmp_path: Path):
    folder = transforms(tmp_path / "s")
    edit(folder, lambda d: [frame.update(file_path=frame["file_path"][:-4]) for frame in d["frames"]])
    for shot in SHOTS:
        (folder / "images" / f"{shot.name}.png").unlink()
        path, rgb = folder / "images" / f"{shot.name}{extension}", shot.image[..., 2::-1]
        image = Image.fromarray(np.ascontiguousarray(rgb))
        if extension == ".heic":
            heif = pytest.importorskip("pillow_heif")
            heif.from_pillow(image).save(path, quality=95)
        else:
            image.save(path, format={".JPG": "jpeg", "": "avif", ".tiff": "tiff"}.get(extension, extension[1:]))
    scene = read(folder)
    assert [view.name for view in scene.train] == [f"images/{shot.name}" for shot in SHOTS]
    for view, shot in zip(scene.train, SHOTS, strict=True):
        assert np.abs(view.rgb.numpy() - shot.image[..., 2::-1] / 255).mean() < 0.06


def test_heic_without_its_reader_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    folder = text_model(tmp_path / "s")
    (folder / "images" / "r_01.png").write_bytes(b"\0\0\0\x18ftypheic\0\0\0\0mif1heic")
    with pytest.raises(DataError, match=r"r_01.png: not an image that can be decoded; expected PNG, JPEG, .* or HEIC"):
        read(folder)
    monkeypatch.setitem(sys.modules, "pillow_heif", None)
    with pytest.raises(DataError, match=r"r_01.png: HEIC is read with the extra heic: pip install"):
        read(folder)


# Names of images.


def rename_in_model(folder: Path, change: Callable[[str], str]) -> Path:
    """The names in whatever the layout has for a model; binary names keep their length or are padded by a folder."""
    if (folder / "transforms.json").is_file() or (folder / "transforms_train.json").is_file():
        name = "transforms.json" if (folder / "transforms.json").is_file() else "transforms_train.json"
        edit(
            folder,
            lambda d: [f.update(file_path=change(f"{Path(f['file_path']).stem}.png")) for f in d["frames"]],
            name,
        )
        return folder
    for name in ("images.txt", "images.bin"):
        path = folder / "sparse/0" / name
        if path.is_file():
            data = path.read_bytes()
            for shot in SHOTS:
                data = data.replace(f"{shot.name}.png".encode(), change(f"{shot.name}.png").encode())
            path.write_bytes(data)
    return folder


NAMED = {"COLMAP text": text_model, "COLMAP": binary_model, "nerfstudio": transforms, "Blender": synthetic}
every_name = pytest.mark.parametrize("write", NAMED.values(), ids=NAMED.keys())


@pytest.mark.parametrize(
    ("change", "note"),
    [
        (lambda name: f"C:\\shots\\images\\{name}", "by the end of their path (C:\\shots\\images\\r_00.png is "),
        (lambda name: f"/home/a/b/images/{name}", "by the end of their path (/home/a/b/images/r_00.png is "),
        (lambda name: f"..\\..\\{name}", "by the end of their path (..\\..\\r_00.png is "),
        (lambda name: f"R{name[1:-4]}.PNG", "under a name in other case or encoding (R_00.PNG is "),
    ],
    ids=["drive", "absolute", "up", "case"],
)
@every_name
def test_names_of_another_machine(write: Write, change: Callable[[str], str], note: str, tmp_path: Path):
    """The end of a path is looked for in the folder itself and in images/; COLMAP's names are of files in images/."""
    folder = rename_in_model(write(tmp_path / "s"), change)
    if "case" in note and write in (transforms, synthetic):
        for path in image_folder(folder).iterdir():
            path.rename(folder / path.name)
    elif write is synthetic:
        (folder / "train").rename(folder / "images")
    scene = read(folder)
    assert len(scene.train) == len(SHOTS)
    assert any(f" of 6 {kind}" in n and note in n for n in scene.notes for kind in ("images", "photographed", "train"))


@pytest.mark.parametrize(
    ("asked", "there"),
    [
        ("frame_0361.png{}.png", "{}.png"),
        ("frame_0361.png{}.png", "frame_0361.png{}.png"),
        ("{}.png", "frame_0361.png{}.png"),
        ("{}.png.png", "{}.png"),
        ("{}.png", "{}.png.png"),
    ],
)
@every_name
def test_what_blender_puts_behind_names(write: Write, asked: str, there: str, tmp_path: Path):
    folder = write(tmp_path / "s")
    for shot in SHOTS:
        path, number = image_folder(folder) / f"{shot.name}.png", f"00{shot.name[2:]}"
        path.rename(path.with_name(there.format(number)))
        mask = folder / "masks" / f"{shot.name}.png"
        mask.rename(mask.with_name(there.format(number)))
    inside = "" if write in (text_model, binary_model) else f"{image_folder(folder).name}/"
    rename_in_model(folder, lambda name: inside + asked.format(f"00{name[2:4]}"))
    scene = read(folder)
    assert len(scene.train) == len(SHOTS)
    assert has_the_masks(scene)
    assert noted(scene, "without the number or the second extension") == (asked != there and there != "{}.png.png")


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("lines", ["blank", "none", "observations"])
def test_names_with_spaces_and_lines_without_observations(lines: str, end: str, tmp_path: Path):
    folder = text_model(tmp_path / "s")
    model = folder / "sparse/0/images.txt"
    kept = [line for line in model.read_text(encoding="utf-8").split("\n") if line.endswith(".png")]
    out = []
    for index, line in enumerate(kept):
        # As many words as three observations, which is what they must not be taken for.
        out.append(line.replace("r_", "my photo no "))
        out += {"blank": [""], "none": [], "observations": ["1.5 2.5 -1 3.5 4.5 17"] if index % 2 else [""]}[lines]
    model.write_bytes(end.join(["# comment", *out, ""]).encode())
    for shot in SHOTS:
        for kind in ("images", "masks"):
            path = folder / kind / f"{shot.name}.png"
            path.rename(path.with_name(path.name.replace("r_", "my photo no ")))
    assert [view.name for view in read(folder).train] == [f"my photo no 0{index}" for index in range(6)]


@pytest.mark.parametrize("write", [text_model, binary_model])
def test_images_beside_the_model_in_one_flat_folder(write: Write, tmp_path: Path):
    folder = write(tmp_path / "s", place=".")
    for kind, end in (("images", ".png"), ("masks", ".mask.png")):
        for shot in SHOTS:
            (folder / kind / f"{shot.name}.png").rename(folder / f"{shot.name}{end}")
        (folder / kind).rmdir()
    scene = read(folder)
    assert [view.name for view in scene.train] == [shot.name for shot in SHOTS]
    assert has_the_masks(scene)
    assert not noted(scene, "no camera")


@pytest.mark.parametrize("name", ["nerfstudio", "Blender", "COLMAP text", "COLMAP"])
def test_frames_whose_image_is_not_there(name: str, tmp_path: Path):
    folder = MASKED[name](tmp_path / "s")
    for index in (1, 4):
        (image_folder(folder) / f"r_0{index}.png").unlink()
    scene = read(folder)
    assert len(scene.train) == 4
    assert noted(scene, "2 of 6 images are not there and are left out: ")
    assert any("r_01" in note and "r_04" in note for note in scene.notes)
    for index in (0, 2):
        (image_folder(folder) / f"r_0{index}.png").unlink()
    with pytest.raises(
        DataError, match=r"4 of 6 images are not there \(.*r_00.*\), which leaves 2; expected 3 or more"
    ):
        read(folder)


def test_images_of_matrices_that_are_not_there(tmp_path: Path):
    """Matched by their order, the wrong ones would be; the numbers in their names tell."""
    folder = idr(tmp_path / "s")
    for kind in ("image", "mask"):
        (folder / kind / "r_02.png").unlink()
    with pytest.raises(DataError, match=r"5 images need as many matrices world_mat_I, found 6; or images named by"):
        read(folder)
    for kind in ("image", "mask"):
        for path in (folder / kind).iterdir():
            path.rename(path.with_name(path.name[2:]))
    scene = read(folder)
    assert noted(scene, "1 of 6 images are not there and are left out: 2.")
    torch.testing.assert_close(scene.train[2].camera.world_to_camera, SHOTS[3].camera.world_to_camera)


def test_images_and_matrices_are_paired_by_numbers_not_by_the_alphabet(tmp_path: Path):
    folder = idr(tmp_path / "s")
    for kind in ("image", "mask"):
        for path in sorted((folder / kind).iterdir()):
            # 1 comes after 05, as 10 comes before 2.
            number = path.stem.removeprefix("r_")
            path.rename(path.with_name(f"{'1' if number == '01' else number}.png"))
    scene = read(folder)
    assert noted(scene, "paired by their numbers")
    assert scene.train[-1].name == "1"
    torch.testing.assert_close(scene.train[-1].camera.world_to_camera, SHOTS[1].camera.world_to_camera)


@pytest.mark.parametrize("name", ["nerfstudio", "Blender", "COLMAP text", "COLMAP"])
def test_the_same_image_twice(name: str, tmp_path: Path):
    folder = MASKED[name](tmp_path / "s")
    names = [path.name for path in folder.glob("transforms*.json")]
    if names:
        edit(folder, lambda d: d["frames"].append(d["frames"][2]), names[0])
    elif name == "COLMAP text":
        path = folder / "sparse/0/images.txt"
        line = path.read_text(encoding="utf-8").split("\n")[5]
        path.write_text(path.read_text(encoding="utf-8") + line.replace("3 ", "9 ", 1) + "\n\n", encoding="utf-8")
    else:
        path = folder / "sparse/0/images.bin"
        path.write_bytes(path.read_bytes().replace(b"r_03.png", b"r_02.png"))
    scene = read(folder)
    assert len(scene.train) == (5 if name == "COLMAP" else 6)
    assert noted(scene, "name an image again (")
    assert any("r_02.png): it is used once, at its first pose." in note for note in scene.notes)


# What the model says.


@pytest.mark.parametrize("text", [False, True])
def test_a_calibration_that_diverged(text: bool, tmp_path: Path):
    camera = SHOTS[0].camera
    values = (camera.fx, camera.cx, camera.cy, -45.0, 1017.0)
    folder = write_colmap(tmp_path / "s", SHOTS, text=text, model=(3, "RADIAL"), values=values)
    with pytest.raises(DataError, match=r"calibration diverged: .* \(k1 -45, k2 1017, focal length .* calibrate again"):
        read(folder)
    other = transforms(tmp_path / "t")
    edit(other, lambda d: d.update(k1=-45.0, k2=1017.0))
    with pytest.raises(DataError, match=r"calibration diverged: .* \(k1 -45, k2 1017, focal length"):
        read(other)


def cloud() -> np.ndarray:
    points = np.random.default_rng(0).normal(size=(200, 3))
    return 0.8 * points / np.linalg.norm(points, axis=1, keepdims=True)


def bare_box(folder: Path) -> Scene:
    return ColmapConfig(masks="none", background="none").build(str(folder)).load()


@pytest.mark.parametrize("text", [False, True])
def test_sparse_points_are_used_or_missed_aloud(text: bool, tmp_path: Path):
    folder = write_colmap(tmp_path / "s", SHOTS, text=text, points=cloud(), masks=False)
    own = folder / "sparse/0" / ("points3D.txt" if text else "points3D.bin")
    if text:
        own.write_text(own.read_text(encoding="utf-8").replace(" 0.5 ", " -1 "), encoding="utf-8")
    else:
        own.write_bytes(own.read_bytes().replace(np.float64(0.5).tobytes(), np.float64(-1).tobytes()))
    assert noted(bare_box(folder), "of 200 sparse points; there are no masks")
    for content in (b"", b"# nothing\n" if text else bytes(8)):
        own.write_bytes(content)
        assert noted(bare_box(folder), f"{own.name} holds no point.")
    own.unlink()
    assert noted(bare_box(folder), f"there is no {own.name} beside the cameras: no sparse points say where")
    import trimesh

    trimesh.PointCloud(cloud()).export(folder / "sparse/0/points3D.ply")
    scene = bare_box(folder)
    assert noted(scene, "the sparse points are those of points3D.ply.")
    assert noted(scene, "of 200 sparse points; there are no masks")


# Nothing outside the data folder is opened.


@pytest.fixture(scope="module")
def opened() -> Iterator[list[str]]:
    """What this process opens or lists; hooks cannot be taken off again, so that there is one."""
    watched: list[str] | None = []

    def watch(event: str, arguments: tuple) -> None:
        if watched is not None and event in ("open", "os.listdir", "os.scandir"):
            watched.append(str(arguments[0]))

    sys.addaudithook(watch)
    yield watched
    watched = None


@pytest.mark.parametrize(
    "name", ["/{0}/r_00.png", "../other/r_00.png", "..\\other\\r_00.png", "images/../../other/r_00.png"]
)
@pytest.mark.parametrize("layout", ["nerfstudio", "Blender", "COLMAP text"])
def test_nothing_outside_the_folder_is_opened(layout: str, name: str, opened: list[str], tmp_path: Path):
    folder = MASKED[layout](tmp_path / "s")
    outside = tmp_path / "other"
    outside.mkdir()
    shutil.copy(image_folder(folder) / "r_00.png", outside / "secret.png")
    secret = name.format(outside.as_posix().lstrip("/")).replace("r_00", "secret")
    names = [path.name for path in folder.glob("transforms*.json")]
    if names:
        edit(folder, lambda d: d["frames"][0].update(file_path=secret), names[0])
        edit(folder, lambda d: d.update(ply_file_path=secret), names[0])
    else:
        path = folder / "sparse/0/images.txt"
        path.write_text(path.read_text(encoding="utf-8").replace("r_00.png", secret), encoding="utf-8")
    opened.clear()
    scene = read(folder)
    assert len(scene.train) == 5
    assert noted(scene, "1 of 6 images are not there and are left out: ")
    assert any(str(folder) in each for each in opened)
    assert not [each for each in opened if "secret" in each or str(outside) in each]


@pytest.mark.parametrize("layout", WRITERS)
def test_what_is_as_usual_has_no_remark(layout: str, tmp_path: Path):
    scene = read(WRITERS[layout](tmp_path / "s", SHOTS))
    for words in (" are found ", "left out", "again", "not used", "inverted"):
        assert not noted(scene, words)
