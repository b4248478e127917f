"""Masks as other programs leave them: found by whatever name, inverted, for some of the images, of a rig."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from layouts import (
    opengl,
    write_colmap,
    write_nerfstudio,
)
from messy_scenes import (
    SHOTS,
    Write,
    edit,
    every_layout,
    has_the_masks,
    idr,
    image_folder,
    mask_folder,
    noted,
    read,
    synthetic,
    text_model,
)
from PIL import Image
from plain_scenes import write_image

from sculpt_framework.errors import DataError


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
    (folder / "mask" / "list.txt").write_text("000000.png", encoding="utf-8")
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
    (folder / "transforms.json").write_text(
        json.dumps({"fl_x": SHOTS[0].camera.fx, "frames": frames}), encoding="utf-8"
    )
    assert noted(read(folder), "6 of 6 images have a mask in a file of its own")
    for path in (folder / "masks/cam1").iterdir():
        path.rename(folder / "masks" / path.name)
    shutil.rmtree(folder / "masks/cam2")
    with pytest.raises(DataError, match=r"masks/0.png: may be the mask of cam1/0.png and of cam2/0.png"):
        read(folder)
