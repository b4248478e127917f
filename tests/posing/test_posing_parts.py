"""What posing decides by itself: what is posed, which frames, which pairs, which lenses, why one is left out."""

import os
import sys
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from measure_poses import pose_errors, similarity
from PIL import Image
from PIL.TiffImagePlugin import IFDRational
from scipy.spatial.transform import Rotation

from sculpt_framework.errors import ComponentImportError, ConfigError, DataError, OutputError
from sculpt_framework.posing import colmap
from sculpt_framework.posing.announcer import Announcer
from sculpt_framework.posing.colmap import Matched
from sculpt_framework.posing.lenses import sort_by_lens
from sculpt_framework.posing.likely_pairs import likely_pairs
from sculpt_framework.posing.options import PosingOptions
from sculpt_framework.posing.outcome import Outcome, nothing_placed, read_outcome, reasons
from sculpt_framework.posing.pairs import EXHAUSTIVE_UP_TO, choose_pairs
from sculpt_framework.posing.pose import pose
from sculpt_framework.posing.source import find_photographs, holds_photographs
from sculpt_framework.posing.upright import centers, looked_at, upright_frame
from sculpt_framework.posing.video import Footage, choose_frames, look_through, write_frames
from sculpt_plugins.datasets.auto.config import AutoDatasetConfig


class Silent(Announcer):
    def step(self, name: str, done: int, total: int) -> None:
        pass

    def say(self, line: str) -> None:
        pass


def _photograph(path: Path, size: tuple[int, int] = (32, 24), focal: object = None) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    exif = Image.Exif()
    if focal is not None:
        exif.get_ifd(0x8769)[0x920A] = focal
    Image.new("RGB", size, (90, 120, 30)).save(path, exif=exif)


def _ring(count: int) -> np.ndarray:
    """Cameras on a ring of radius 3, 1 above the plane, looking at the origin; world to camera."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    for index, angle in enumerate(np.linspace(0, 2 * np.pi, count, endpoint=False)):
        place = np.array([3 * np.cos(angle), 3 * np.sin(angle), 1.0])
        ahead = -place / np.linalg.norm(place)
        right = np.cross(ahead, [0, 0, 1.0])
        right /= np.linalg.norm(right)
        poses[index, :3, :3] = np.stack([right, np.cross(ahead, right), ahead])
        poses[index, :3, 3] = -poses[index, :3, :3] @ place
    return poses


def _moved(poses: np.ndarray, rotation: np.ndarray, shift: np.ndarray, scale: float) -> np.ndarray:
    """The same cameras in a world that has been turned, scaled and shifted."""
    out = poses.copy()
    places = scale * centers(poses) @ rotation.T + shift
    out[:, :3, :3] = poses[:, :3, :3] @ rotation.T
    out[:, :3, 3] = -np.einsum("nij,nj->ni", out[:, :3, :3], places)
    return out


# -- what is there ---------------------------------------------------------------------------------------------------


def test_photographs_are_found_below_images_with_their_masks(tmp_path: Path):
    for name in ("a/1.jpg", "a/2.JPG", "b/1.png"):
        _photograph(tmp_path / "images" / name)
    _photograph(tmp_path / "masks" / "a" / "1.png")
    _photograph(tmp_path / "images" / ".thumbnails" / "1.jpg")
    found = find_photographs(tmp_path)
    assert found.names == ("a/1.jpg", "a/2.JPG", "b/1.png")
    assert found.masks == (tmp_path / "masks/a/1.png", None, None)
    assert find_photographs(tmp_path / "images") == found


def test_masks_inside_the_folder_are_no_photographs(tmp_path: Path):
    for index in range(3):
        _photograph(tmp_path / f"{index}.jpg")
        _photograph(tmp_path / "masks" / f"{index}.png")
    found = find_photographs(tmp_path)
    assert found.names == ("0.jpg", "1.jpg", "2.jpg")
    assert found.masks[2] == tmp_path / "masks" / "2.png"


def test_names_of_folders_may_be_in_capitals(tmp_path: Path):
    for index in range(3):
        _photograph(tmp_path / "Images" / f"{index}.jpg")
        _photograph(tmp_path / "Images" / "Masks" / f"{index}.png")
    assert holds_photographs(tmp_path)
    found = find_photographs(tmp_path)
    assert found.names == ("0.jpg", "1.jpg", "2.jpg")
    assert found.masks[2] == tmp_path / "Images" / "Masks" / "2.png"


def test_the_scene_inside_of_the_photographs_is_no_input(tmp_path: Path):
    for index in range(3):
        _photograph(tmp_path / f"{index}.jpg")
        _photograph(tmp_path / "scene" / "images" / f"{index}.jpg")
    assert find_photographs(tmp_path, besides=tmp_path / "scene").names == ("0.jpg", "1.jpg", "2.jpg")
    assert len(find_photographs(tmp_path).names) == 6
    # Its own photographs are, where they are all there is.
    assert find_photographs(tmp_path / "scene", besides=tmp_path / "scene").names == ("0.jpg", "1.jpg", "2.jpg")


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such names")
def test_a_name_that_is_not_utf_8_is_told(tmp_path: Path):
    for index in range(3):
        _photograph(tmp_path / f"{index}.jpg")
    (tmp_path / "0.jpg").rename(os.fsdecode(os.fsencode(tmp_path) + b"/M\xfcller.jpg"))
    with pytest.raises(DataError, match=r"the name of the file 'M\\udcfcller.jpg' is not UTF-8; rename it"):
        find_photographs(tmp_path)


@pytest.mark.parametrize(
    ("names", "message"),
    [
        ((), "no photographs; expected .jpg"),
        (("1.jpg", "2.jpg"), "2 photographs; expected 3 or more"),
        (("1.jpg", "2.NEF", "3.nef"), "1 photographs that can be read, and 2 .nef, which cannot; convert"),
    ],
)
def test_too_few_photographs_are_refused(tmp_path: Path, names: tuple[str, ...], message: str):
    for name in names:
        (tmp_path / name).write_bytes(b"")
    with pytest.raises(DataError, match=message):
        pose(tmp_path, tmp_path / "out", PosingOptions(), Silent())
    assert not (tmp_path / "out").exists()


def test_heic_photographs_become_jpegs_of_the_scene(tmp_path: Path):
    heif = pytest.importorskip("pillow_heif")
    exif = Image.Exif()
    exif.get_ifd(0x8769)[0x920A] = 4.2
    for number in range(3):
        picture = Image.new("RGB", (64, 48), (90, 40 * number, 30))
        heif.from_pillow(picture).save(tmp_path / f"{number}.HEIC", exif=exif.tobytes())
    # Plain pictures have nothing to be placed by.
    with pytest.raises(DataError):
        pose(tmp_path, tmp_path / "out", PosingOptions(), Silent())
    made = sorted((tmp_path / "out" / "images").iterdir())
    assert [path.name for path in made] == ["0.HEIC.jpg", "1.HEIC.jpg", "2.HEIC.jpg"]
    with Image.open(made[1]) as image:
        assert image.size == (64, 48)
        assert np.abs(np.asarray(image).mean(axis=(0, 1)) - (90, 40, 30)).max() < 4
        assert float(image.getexif().get_ifd(0x8769)[0x920A]) == pytest.approx(4.2)


def test_webp_photographs_become_jpegs_of_the_scene(tmp_path: Path):
    for number in range(3):
        exif = Image.Exif()
        exif.get_ifd(0x8769)[0x920A] = 4.2
        Image.new("RGB", (64, 48), (90, 40 * number, 30)).save(tmp_path / f"{number}.webp", lossless=True, exif=exif)
    with pytest.raises(DataError):
        pose(tmp_path, tmp_path / "out", PosingOptions(), Silent())
    made = sorted((tmp_path / "out" / "images").iterdir())
    assert [path.name for path in made] == ["0.webp.jpg", "1.webp.jpg", "2.webp.jpg"]
    with Image.open(made[1]) as image:
        assert np.abs(np.asarray(image).mean(axis=(0, 1)) - (90, 40, 30)).max() < 4
        assert float(image.getexif().get_ifd(0x8769)[0x920A]) == pytest.approx(4.2)
    cut_out = Image.new("RGBA", (64, 48), (90, 40, 30, 0))
    cut_out.save(tmp_path / "2.webp", lossless=True)
    with pytest.raises(DataError):
        pose(tmp_path, tmp_path / "with alpha", PosingOptions(), Silent())
    with Image.open(tmp_path / "with alpha" / "images" / "2.webp.png") as image:
        assert np.asarray(image)[..., 3].max() == 0
    (tmp_path / "1.webp").write_bytes(b"RIFF....WEBP")
    with pytest.raises(DataError, match=r"1\.webp: cannot be read as an image"):
        pose(tmp_path, tmp_path / "again", PosingOptions(), Silent())


def test_files_that_are_no_photographs_are_named(tmp_path: Path):
    for index in range(3):
        (tmp_path / f"{index}.jpg").write_bytes(b"\xff\xd8\xff not an image")
    with pytest.raises(DataError, match="0 of 3 photographs can be read"):
        pose(tmp_path, tmp_path.with_name("out"), PosingOptions(), Silent())


def test_a_folder_with_something_else_is_not_written_to(tmp_path: Path):
    for index in range(3):
        _photograph(tmp_path / "in" / f"{index}.jpg")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "letter.txt").write_text("dear", encoding="utf-8")
    with pytest.raises(OutputError, match="exists and is not empty"):
        pose(tmp_path / "in", tmp_path / "out", PosingOptions(), Silent())


def test_options_out_of_range_are_refused():
    with pytest.raises(ConfigError, match="--frames 2: expected 3 to 10000"):
        PosingOptions(frames=2)


def test_without_pycolmap_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    for index in range(3):
        _photograph(tmp_path / "in" / f"{index}.jpg")
    assert holds_photographs(tmp_path / "in")
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    dataset = AutoDatasetConfig().build(str(tmp_path / "in"))
    with pytest.raises(ComponentImportError, match=r"pip install 'gaussian-sculpting\[pose\]'"):
        dataset.load()


# -- video -----------------------------------------------------------------------------------------------------------


def test_the_sharpest_frame_of_each_stretch_of_the_way_is_taken():
    # Ten frames of standing still, then ten that move alike: five parts of the way are two frames each.
    motion = np.array([0.0] * 10 + [1.0] * 10)
    sharpness = np.full(20, 0.5)
    sharpness[[4, 12, 13, 17]] = 1.0
    chosen = choose_frames(Footage(sharpness=sharpness, motion=motion), 5)
    # Frames 0 to 10 have gone 0 or 1 of 10, 11 and 12 have gone 2 and 3, and so on; the last joins the last part.
    assert chosen.tolist() == [4, 12, 13, 15, 17]


def test_where_nothing_moves_time_decides():
    chosen = choose_frames(Footage(sharpness=np.ones(9), motion=np.zeros(9)), 3)
    assert chosen.tolist() == [0, 3, 6]


def test_sharp_frames_of_a_video_are_chosen_and_written(tmp_path: Path):
    generator = np.random.default_rng(0)
    wall = cv2.GaussianBlur(generator.integers(0, 255, (160, 900, 3), dtype=np.uint8), (0, 0), 1.5)
    video = cv2.VideoWriter(str(tmp_path / "walk.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 30, (200, 160))
    frames = 40
    for index in range(frames):
        frame = wall[:, 8 * index : 8 * index + 200]
        # One of four is sharp, as of a camera that shakes.
        video.write(frame if index % 4 == 2 else cv2.blur(frame, (9, 9)))
    video.release()
    footage = look_through(tmp_path / "walk.avi", lambda done, total: None)
    assert footage.motion[1:] == pytest.approx(8 / 200, rel=0.15)
    chosen = choose_frames(footage, 8)
    assert len(chosen) == 8
    assert (chosen % 4 == 2).all()
    names = write_frames(tmp_path / "walk.avi", chosen, tmp_path / "images", lambda done, total: None)
    assert names[0] == "frame_000002.jpg"
    middle = cv2.imread(str(tmp_path / "images" / names[4]))
    assert middle is not None
    expected = wall[:, 8 * chosen[4] : 8 * chosen[4] + 200]
    assert np.abs(middle.astype(float) - expected).mean() < 6


def test_what_is_no_video_is_refused(tmp_path: Path):
    (tmp_path / "walk.mp4").write_bytes(b"nothing")
    with pytest.raises(DataError, match=r"walk.mp4: cannot be opened as a video"):
        look_through(tmp_path / "walk.mp4", lambda done, total: None)


# -- pairs and lenses ------------------------------------------------------------------------------------------------


def test_few_photographs_are_all_compared_and_many_are_not():
    pairs, _ = choose_pairs(30, in_order=False)
    assert len(set(pairs)) == 30 * 29 // 2
    count = EXHAUSTIVE_UP_TO + 50
    pairs, _ = choose_pairs(count, in_order=False)
    assert len(pairs) < count * (count - 1) / 6
    assert all((index, index + step) in pairs for index in range(count - 10) for step in range(1, 11))
    assert (0, count - 5) in pairs  # Where a ring closes.


def test_a_video_is_compared_in_its_order():
    assert len(choose_pairs(80, in_order=True)[0]) < 80 * 79 / 2


def test_lenses_go_by_size_focal_length_and_folder(tmp_path: Path):
    _photograph(tmp_path / "a" / "1.jpg", focal=24)
    _photograph(tmp_path / "a" / "2 of 2.jpg", focal=24)
    _photograph(tmp_path / "a" / "3.jpg", focal=70)
    _photograph(tmp_path / "b" / "1.jpg", size=(24, 32), focal=24)
    _photograph(tmp_path / "b" / "2.jpg", focal=24)
    found = find_photographs(tmp_path)

    def lens_of_each(cameras) -> list[str]:
        names = sort_by_lens(found, cameras).names
        assert not any(" " in name for name in names)
        lens = {original: name.split("/")[0] for name, original in names.items()}
        return [lens[name] for name in found.names]

    assert lens_of_each("one") == ["0", "0", "1", "2", "0"]
    assert lens_of_each("per-folder") == ["0", "0", "1", "2", "3"]
    assert len(set(lens_of_each("per-image"))) == 1  # Which COLMAP gives a camera each.


@pytest.mark.parametrize("focal", [IFDRational(0, 0), "50.0 mm", (24.0, 35.0), -1.0])
def test_a_focal_length_that_is_no_length_is_none(tmp_path: Path, focal: object):
    for index in range(3):
        _photograph(tmp_path / f"{index}.jpg", focal=focal)
    lenses = sort_by_lens(find_photographs(tmp_path), "one")
    assert len(lenses.names) == 3
    assert lenses.notes == ()


def test_photographs_of_200_megapixels_have_a_size(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    # Pillow refuses more than twice its limit.
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 100)
    for index in range(3):
        _photograph(tmp_path / f"{index}.jpg")
    assert set(sort_by_lens(find_photographs(tmp_path), "one").sizes.values()) == {(32, 24)}
    assert Image.MAX_IMAGE_PIXELS == 100


def test_threads_and_seed_have_ranges():
    with pytest.raises(ConfigError, match="--threads 0: expected 1 to"):
        PosingOptions(threads=0)
    for seed in (-1, 2**31):
        with pytest.raises(ConfigError, match=f"--seed {seed}: expected 0 to"):
            PosingOptions(seed=seed)


# -- what came of it -------------------------------------------------------------------------------------------------


def test_each_photograph_left_out_has_its_reason():
    features = {"placed": 900, "also": 900, "elsewhere": 900, "blank": 3, "alone": 900, "weak": 900}
    partners = {"placed": 5, "also": 5, "elsewhere": 2, "blank": 0, "alone": 0, "weak": 2}
    why = reasons(
        Matched(features=features, partners=partners, best=partners), [["placed", "also"], ["elsewhere", "also"]]
    )
    assert set(why) == {"elsewhere", "blank", "alone", "weak"}
    assert "piece 2" in why["elsewhere"]
    assert "blurred" in why["blank"]
    assert "no matches" in why["alone"]
    assert "too few matches" in why["weak"]


def test_what_would_help_follows_what_was_seen():
    blank = Matched(features=dict.fromkeys("abc", 4), partners=dict.fromkeys("abc", 0), best={})
    apart = Matched(features=dict.fromkeys("abc", 4000), partners=dict.fromkeys("abc", 0), best={})
    assert "sharper" in str(nothing_placed(Path("p"), blank, 0, False))
    assert "more overlap" in str(nothing_placed(Path("p"), apart, 0, False))
    assert "--ignore-masks" in str(nothing_placed(Path("p"), apart, 0, True))


def test_an_outcome_is_read_back(tmp_path: Path):
    outcome = Outcome(
        photographs=9,
        registered=5,
        error_px=0.5,
        points=1000,
        cameras=("SIMPLE_RADIAL 640x480",),
        compared="every photograph with every other",
        models=(5, 3),
        left_out={"x.jpg": "no matches with any other"},
        notes=("a note",),
        seconds=12.0,
    )
    (tmp_path / "posing.json").write_text(outcome.to_json(), encoding="utf-8")
    assert read_outcome(tmp_path) == outcome
    said = "\n".join(outcome.lines(tmp_path))
    assert "5 of 9 photographs" in said
    assert "2 that could not be joined, of 5, 3 photographs" in said
    assert "no matches with any other (x.jpg)" in said


# -- frames of reference ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("cameras", [range(12), range(4)])
def test_the_frame_is_upright_and_its_origin_is_looked_at(cameras: range):
    turn = Rotation.from_euler("xyz", (0.4, 1.1, -2.0)).as_matrix()
    moved = _moved(_ring(12)[cameras], turn, np.array([4.0, -2.0, 7.0]), 2.5)
    frame = upright_frame(moved)
    assert frame[:, :3] @ frame[:, :3].T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(frame[:, :3]) == pytest.approx(1)
    placed = centers(moved) @ frame[:, :3].T + frame[:, 3]
    assert placed[:, 2] == pytest.approx(np.full(len(moved), 2.5), abs=1e-9)
    assert np.linalg.norm(placed[:, :2], axis=1) == pytest.approx(np.full(len(moved), 7.5))


def test_cameras_that_lie_on_their_side_are_set_upright():
    sideways = _ring(12)
    quarter = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    sideways[:, :3] = quarter @ sideways[:, :3]
    moved = _moved(sideways, Rotation.from_euler("x", 1.3).as_matrix(), np.zeros(3), 1.0)
    placed = centers(moved) @ upright_frame(moved)[:, :3].T
    assert placed[:, 2] == pytest.approx(np.ones(12), abs=1e-9)


def test_a_similarity_and_the_errors_left_are_found():
    generator = np.random.default_rng(3)
    turn = Rotation.from_euler("xyz", (0.4, 1.1, -2.0)).as_matrix()
    known = _ring(20)
    posed = _moved(known, turn, np.array([4.0, -2.0, 7.0]), 0.3)
    by_name = {f"{index:02}": matrix for index, matrix in enumerate(known)}
    same = pose_errors(by_name, {f"{index:02}": matrix for index, matrix in enumerate(posed)})
    assert same.degrees.max() < 1e-6
    assert same.shares.max() < 1e-9
    # Turned by half a degree about its own axes each, and shifted by a hundredth of the distance at one place.
    for matrix in posed:
        axis = generator.normal(size=3)
        nudge = Rotation.from_rotvec(np.deg2rad(0.5) * axis / np.linalg.norm(axis)).as_matrix()
        place = -matrix[:3, :3].T @ matrix[:3, 3]
        matrix[:3, :3] = nudge @ matrix[:3, :3]
        matrix[:3, 3] = -matrix[:3, :3] @ place
    turned = pose_errors(by_name, {f"{index:02}": matrix for index, matrix in enumerate(posed)})
    assert turned.degrees == pytest.approx(np.full(20, 0.5), abs=1e-6)
    assert looked_at(known) == pytest.approx(np.zeros(3), abs=1e-9)
    mirrored = similarity(centers(known), centers(known) * [1, 1, -1])
    assert np.linalg.det(mirrored.rotation) == pytest.approx(1)


class _Model:
    """Of pycolmap: a model of so many photographs, all of which have a pose."""

    def __init__(self, placed: int):
        self.placed = placed
        pose = SimpleNamespace(matrix=lambda: np.eye(4)[:3])
        self.images = {
            number: SimpleNamespace(has_pose=True, name=f"{number}.jpg", cam_from_world=lambda: pose)
            for number in range(placed)
        }

    def num_reg_images(self) -> int:
        return self.placed

    def write(self, folder: Path) -> None:
        assert folder.is_dir()


@pytest.mark.parametrize(
    ("placed", "stages"),
    [
        # All are placed by pairs with half of the usual matches; a quarter of them still closes rings.
        ([5, 5], [100, 50]),
        ([3, 4, 5], [100, 50, 24]),
        # One that nothing shows.
        ([4, 4, 4, 4, 3, 4, 4], [100, 50, 24, 15, 50, 24, 15]),
        # Pieces that do not grow together: begun anew with the second stage.
        ([3, 3, 3, 3, 5], [100, 50, 24, 15, 50]),
        # Too few strong pairs for a model.
        ([0, 5], [100, 50]),
    ],
)
def test_pairs_with_many_matches_place_photographs_first(
    placed: list[int], stages: list[int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    pycolmap = pytest.importorskip("pycolmap")
    best = {"a": 100, "b": 200, "c": 200, "d": 900, "e": 0}
    known = Matched(features=dict.fromkeys(best, 4000), partners=dict.fromkeys(best, 2), best={**best, "f": 200})
    taken, begun = [], []

    def mapped(database, images, folder, mapping, input_path, **told):
        taken.append(mapping.min_num_matches)
        begun.append(input_path != "")
        now = placed[len(taken) - 1]
        return {0: _Model(now)} if now else {}

    monkeypatch.setattr(colmap, "matched", lambda database: known)
    monkeypatch.setattr(pycolmap, "incremental_mapping", mapped)
    (last,) = colmap.map_images(tmp_path / "db", tmp_path, tmp_path / "models", PosingOptions(), lambda done, of: None)
    assert taken == stages
    assert isinstance(last, _Model)
    assert last.placed == placed[-1]
    assert begun[0] is False
    assert begun[1] == (placed[0] > 0)


def test_likely_pairs_are_those_with_features_in_common(tmp_path: Path):
    pycolmap = pytest.importorskip("pycolmap")
    generator = np.random.default_rng(0)
    count, shared = 60, 12
    # Places along a path: each image has the features of its own and of those up to six further on.
    path = [generator.integers(0, 255, (shared, 128)) for _ in range(count + 6)]
    database = pycolmap.Database.open(tmp_path / "database.db")
    lens = database.write_camera(pycolmap.Camera.create_from_model_name(1, "SIMPLE_RADIAL", 500.0, 640, 480))
    names = [f"{index:02}.jpg" for index in range(count)]
    for index, name in enumerate(names):
        features = np.concatenate(path[index : index + 7])
        noisy = np.clip(features + generator.integers(-9, 9, features.shape), 0, 255).astype(np.uint8)
        number = database.write_image(pycolmap.Image(name=name, camera_id=lens))
        places = np.zeros((len(noisy), 6), np.float32)
        places[:, :2], places[:, 2], places[:, 5] = generator.random((len(noisy), 2)) * 400, 3.0, 3.0
        database.write_keypoints(number, places)
        kind = pycolmap.FeatureExtractorType.SIFT
        database.write_descriptors(number, pycolmap.FeatureDescriptors(data=noisy, type=kind))
    database.close()
    pairs = likely_pairs(tmp_path / "database.db", names)
    assert len(set(pairs)) == len(pairs) < count * (count - 1) / 4
    assert all(first < second for first, second in pairs)
    assert all((names[i], names[i + step]) in pairs for i in range(count - 6) for step in range(1, 7))
    assert (names[0], names[55]) in pairs  # Of every fifth with every fifth.
