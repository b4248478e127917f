"""Scenes as other programs and phones leave them: read, with a note on what was done, in every layout that has it."""

import json
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from layouts import (
    WRITERS,
    make_shots,
    opengl,
    save_jpeg,
    write_blender,
    write_colmap,
    write_idr,
    write_nerfstudio,
)
from PIL import Image
from plain_scenes import write_image

from sculpt_framework.errors import DataError
from sculpt_framework.types import Scene
from sculpt_plugins.datasets.auto.config import AutoDatasetConfig
from sculpt_plugins.datasets.colmap.config import ColmapConfig

Write = Callable[..., Path]
SHOTS = make_shots(6, 32)
BOX = (-1.0, -1.0, -1.0, 1.0, 1.0, 1.0)


def read(folder: Path, **options: Any) -> Scene:
    """With the box given, which takes most of the time to find, where the layout has the option."""
    if not (folder / "transforms_train.json").is_file() and not (folder / "render").is_dir():
        options.setdefault("box", BOX)
    return AutoDatasetConfig(**options).build(str(folder)).load()


def noted(scene: Scene, text: str) -> bool:
    return any(text in note for note in scene.notes)


def edit(folder: Path, change: Callable[[dict[str, Any]], object], name: str = "transforms.json") -> None:
    document = json.loads((folder / name).read_text())
    change(document)
    (folder / name).write_text(json.dumps(document))


def text_model(folder: Path, **options: Any) -> Path:
    return write_colmap(folder, SHOTS, text=True, **options)


def binary_model(folder: Path, **options: Any) -> Path:
    return write_colmap(folder, SHOTS, **options)


def transforms(folder: Path) -> Path:
    """Without masks that are named, so that they are looked for."""
    write_nerfstudio(folder, SHOTS)
    edit(folder, lambda d: [frame.pop("mask_path") for frame in d["frames"]])
    return folder


def synthetic(folder: Path) -> Path:
    """NeRF-Synthetic with masks in files."""
    write_blender(folder, SHOTS)
    (folder / "masks").mkdir()
    for shot in SHOTS:
        write_image(folder / "train" / f"{shot.name}.png", shot.image[..., :3])
        write_image(folder / "masks" / f"{shot.name}.png", shot.image[..., 3])
    return folder


def idr(folder: Path) -> Path:
    return write_idr(folder, SHOTS)


MASKED = {"COLMAP text": text_model, "COLMAP": binary_model, "nerfstudio": transforms, "Blender": synthetic, "IDR": idr}
every_layout = pytest.mark.parametrize("write", MASKED.values(), ids=MASKED.keys())


def mask_folder(folder: Path) -> Path:
    return folder / ("mask" if (folder / "mask").is_dir() else "masks")


def image_folder(folder: Path) -> Path:
    return next(folder / name for name in ("images", "image", "train") if (folder / name).is_dir())


def has_the_masks(scene: Scene) -> bool:
    truths = [shot.image[..., 3] > 0 for shot in SHOTS]
    return len(scene.train) == len(SHOTS) and all(
        view.alpha is not None and ((view.alpha.numpy() > 0.5) == truth).mean() > 0.98
        for view, truth in zip(scene.train, truths, strict=True)
    )


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
    kept = [line for line in model.read_text().split("\n") if line.endswith(".png")]
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


@pytest.mark.parametrize("name", ["nerfstudio", "Blender", "COLMAP text", "COLMAP"])
def test_the_same_image_twice(name: str, tmp_path: Path):
    folder = MASKED[name](tmp_path / "s")
    names = [path.name for path in folder.glob("transforms*.json")]
    if names:
        edit(folder, lambda d: d["frames"].append(d["frames"][2]), names[0])
    elif name == "COLMAP text":
        path = folder / "sparse/0/images.txt"
        line = path.read_text().split("\n")[5]
        path.write_text(path.read_text() + line.replace("3 ", "9 ", 1) + "\n\n")
    else:
        path = folder / "sparse/0/images.bin"
        path.write_bytes(path.read_bytes().replace(b"r_03.png", b"r_02.png"))
    scene = read(folder)
    assert len(scene.train) == (5 if name == "COLMAP" else 6)
    assert noted(scene, "name an image again (")
    assert any("r_02.png): it is used once, at its first pose." in note for note in scene.notes)


# Masks.


def rename_masks(folder: Path, name: str) -> None:
    """To the pattern, in the format of its extension, case aside."""
    masks = mask_folder(folder)
    for shot in SHOTS:
        (masks / f"{shot.name}.png").unlink()
        kind = {"jpg": "jpeg", "tif": "tiff"}.get(name.rpartition(".")[2].lower(), name.rpartition(".")[2].lower())
        mask = Image.fromarray(shot.image[..., 3])
        mask.save(masks / name.format(shot.name), format=kind, **({"lossless": True} if kind == "webp" else {}))


@pytest.mark.parametrize("name", ["{}.webp", "{}.tiff", "{}.TIF", "{}.mask.png", "{}_mask.png", "{}.png.mask.png"])
@every_layout
def test_masks_of_any_type_and_mark(write: Write, name: str, tmp_path: Path):
    folder = write(tmp_path / "s")
    rename_masks(folder, name)
    scene = read(folder)
    assert noted(scene, "6 of 6 images have a mask in a file of its own")
    assert has_the_masks(scene)


def test_masks_that_are_named_on_another_machine(tmp_path: Path):
    folder = write_nerfstudio(tmp_path / "s", SHOTS)
    edit(folder, lambda d: [f.update(mask_path=f"D:\\cut\\{f['mask_path'][6:]}") for f in d["frames"]])
    scene = read(folder)
    assert has_the_masks(scene)
    assert noted(scene, "6 of 6 masks are found by the end of their path (D:\\cut\\r_00.png is masks/r_00.png)")


def test_masks_matched_by_their_order(tmp_path: Path):
    """Beside files that are no masks, which are named."""
    folder = idr(tmp_path / "s")
    for index, shot in enumerate(SHOTS):
        (folder / "mask" / f"{shot.name}.png").rename(folder / "mask" / f"{index:06d}.png")
    (folder / "mask" / "list.txt").write_text("000000.png")
    scene = read(folder)
    assert has_the_masks(scene)
    assert noted(scene, "1 of 7 files of masks belong to no image and are not used (mask/list.txt).")


@pytest.mark.parametrize("mark", [".mask", "_mask"])
@every_layout
def test_masks_beside_their_images(write: Write, mark: str, tmp_path: Path):
    folder = write(tmp_path / "s")
    masks = mask_folder(folder)
    for shot in SHOTS:
        (masks / f"{shot.name}.png").rename(image_folder(folder) / f"{shot.name}{mark}.PNG")
    masks.rmdir()
    scene = read(folder)
    assert len(scene.train) == 6
    assert has_the_masks(scene)


@every_layout
def test_no_mask_file_is_ignored_in_silence(write: Write, tmp_path: Path):
    folder = write(tmp_path / "s")
    masks = mask_folder(folder)
    (masks / "r_99.Webp").write_bytes(b"no image has it, so that it is not read")
    (masks / "r_00.npy").write_bytes(b"")
    scene = read(folder)
    assert noted(scene, f"2 of 8 files of masks belong to no image and are not used ({masks.name}/r_00.npy, ")
    assert noted(scene, "r_99.Webp")


@every_layout
def test_masks_for_some_of_the_images(write: Write, tmp_path: Path):
    folder = write(tmp_path / "s")
    whole = {} if write is synthetic else {"box": None}
    for path in image_folder(folder).iterdir():
        # Noise, so that nothing could be keyed out.
        image = np.asarray(cv2.imread(str(path)))
        noise = np.random.default_rng(0).integers(0, 255, image.shape, dtype=np.uint8)
        write_image(path, np.where(image.max(axis=2, keepdims=True) > 0, image, noise))
    full = read(folder, **whole)
    for index in (0, 2, 4):
        (mask_folder(folder) / f"r_0{index}.png").unlink()
    scene = read(folder, **whole)
    assert [view.alpha is not None for view in scene.train] == [False, True] * 3
    assert noted(scene, "3 of 6 images have a mask in a file of its own")
    assert noted(scene, "fitted from 3 masks of 6 views")
    # Three masks leave more than six, and not much more.
    assert full.box.scale - 1e-9 <= scene.box.scale < 1.5 * full.box.scale
    assert (scene.box.center - full.box.center).abs().max() < 0.5


def test_a_box_that_comes_with_the_cameras_stays_where_few_images_have_a_mask(tmp_path: Path):
    """An image without a mask is all object, which does not make the ball too small."""
    folder = idr(tmp_path / "s")
    for index in (0, 2, 3, 4):
        (folder / "mask" / f"r_0{index}.png").unlink()
    arrays = dict(np.load(folder / "cameras.npz"))
    np.savez(folder / "cameras.npz", **arrays | {"scale_mat_0": np.diag([0.82, 0.82, 0.82, 1.0])})
    scene = read(folder, box=None)
    assert not noted(scene, "is not used")
    assert scene.box.scale <= 0.82 * 1.03


@every_layout
def test_inverted_masks_are_noticed(write: Write, tmp_path: Path):
    folder = write(tmp_path / "s")
    straight = read(folder)
    assert not noted(straight, "inverted")
    for shot in SHOTS:
        write_image(mask_folder(folder) / f"{shot.name}.png", 255 - shot.image[..., 3])
    scene = read(folder)
    assert noted(scene, "6 masks are inverted, black and white exchanged: they are white at their borders")
    assert has_the_masks(scene)


def test_whether_masks_are_inverted_can_be_said(tmp_path: Path):
    folder = text_model(tmp_path / "s")
    turned = read(folder, invert_masks="yes")
    assert noted(turned, "6 masks are inverted, black and white exchanged: as asked")
    assert not has_the_masks(turned)
    for shot in SHOTS:
        write_image(folder / "masks" / f"{shot.name}.png", 255 - shot.image[..., 3])
    kept = read(folder, invert_masks="no")
    assert not noted(kept, "inverted")
    assert not has_the_masks(kept)


def test_an_object_that_fills_its_masks_is_not_inverted(tmp_path: Path):
    """A close-up is white at its borders, too."""
    folder = text_model(tmp_path / "s")
    for shot in SHOTS:
        mask = np.full_like(shot.image[..., 3], 255)
        mask[:4, :4] = 0
        write_image(folder / "masks" / f"{shot.name}.png", mask)
    assert not noted(read(folder), "inverted")


def rig(folder: Path, *, binary: bool) -> Path:
    """cam1/0.png to cam2/2.png, as COLMAP names the images of a rig."""
    write_colmap(folder, SHOTS, text=not binary)
    for index, shot in enumerate(SHOTS):
        new = Path(f"cam{1 + index // 3}") / f"{index % 3}.png"
        for kind in ("images", "masks"):
            (folder / kind / new.parent).mkdir(exist_ok=True)
            (folder / kind / f"{shot.name}.png").rename(folder / kind / new)
        path = folder / "sparse/0" / ("images.bin" if binary else "images.txt")
        path.write_bytes(path.read_bytes().replace(f"{shot.name}.png".encode(), new.as_posix().encode()))
    return folder


@pytest.mark.parametrize("binary", [False, True])
def test_masks_of_a_rig_are_told_apart(binary: bool, tmp_path: Path):
    folder = rig(tmp_path / "s", binary=binary)
    scene = read(folder)
    assert noted(scene, "6 of 6 images have a mask in a file of its own")
    assert [view.name for view in scene.train] == [f"cam{c}/{i}" for c in (1, 2) for i in range(3)]
    for path in (folder / "masks/cam1").iterdir():
        path.rename(folder / "masks" / path.name)
    shutil.rmtree(folder / "masks/cam2")
    with pytest.raises(DataError, match=r"masks/0.png: may be the mask of images/cam1/0.png and of images/cam2/0.png"):
        read(folder)


def test_flat_masks_of_a_rig_in_transforms(tmp_path: Path):
    folder = rig(tmp_path / "s", binary=False)
    shutil.rmtree(folder / "sparse")
    frames = [
        {"file_path": f"cam{1 + i // 3}/{i % 3}.png", "transform_matrix": opengl(shot.camera)}
        for i, shot in enumerate(SHOTS)
    ]
    for name in ("cam1", "cam2"):
        (folder / "images" / name).rename(folder / name)
    (folder / "transforms.json").write_text(json.dumps({"fl_x": SHOTS[0].camera.fx, "frames": frames}))
    assert noted(read(folder), "6 of 6 images have a mask in a file of its own")
    for path in (folder / "masks/cam1").iterdir():
        path.rename(folder / "masks" / path.name)
    shutil.rmtree(folder / "masks/cam2")
    with pytest.raises(DataError, match=r"masks/0.png: may be the mask of cam1/0.png and of cam2/0.png"):
        read(folder)


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
        own.write_text(own.read_text().replace(" 0.5 ", " -1 "))
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
        path.write_text(path.read_text().replace("r_00.png", secret))
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
