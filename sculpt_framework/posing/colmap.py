"""The steps that pycolmap does: features, matches, mapping. Each goes on where an earlier call was stopped."""

import importlib
import os
import shutil
import signal
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Int64

from sculpt_framework.errors import ComponentImportError, DataError
from sculpt_framework.posed_images.distortion import Distortion, rectify
from sculpt_framework.posed_images.lens import Pinhole
from sculpt_framework.posing.features import read_features
from sculpt_framework.posing.options import PosingOptions
from sculpt_framework.posing.standing import standing

if TYPE_CHECKING:
    import pycolmap

Tell = Callable[[int, int], None]
"""Told how many of how many are done."""

_PAIRS_AT_ONCE = 50
_MOST_TRIALS = 2000
"""Of RANSAC: finds a pair whose matches are right by a third. COLMAP's 10000 mostly go to hopeless ones."""
SMALLEST_MODEL = 3
_MOST_MODELS = 10
_SHARES, _ALWAYS = (0.5, 0.25, 0.12, 0.0), 2
"""Of the matches that an image usually has with its best partner: pairs with at least so many are used, in stages. The
first two close rings; the others are for images that are not placed by then."""
FEWEST_MATCHES = 15
"""Of a pair that is used at all."""
_LENS = "SIMPLE_RADIAL"
"""A focal length and one coefficient of distortion: what a ring of views determines."""
_WORTH_IT = 0.998
"""The principal point is estimated where that lowers the reprojection error to this share or below,"""
_LEAST_SHIFT, _MOST_SHIFT = 0.01, 0.05
"""and moves it by such shares of the image's longer side: other errors of the model move it by less, and no lens is as
far off; in a ring of views it is hardly told from a turn of all cameras."""
_ENOUGH_VIEWS = 15
"""Of one lens, before its principal point is estimated."""


@dataclass(frozen=True, kw_only=True)
class Matched:
    """What is known of each photograph before mapping, by its name in the database."""

    features: dict[str, int]
    partners: dict[str, int]
    """Photographs it has verified matches with."""
    best: dict[str, int]
    """Matches with the one of them that it has most with."""

    def fewest(self, share: float = _SHARES[_ALWAYS - 1]) -> int:
        """Matches of a pair that has at least such a share of what is usual for best partners."""
        usual = np.median([most for most in self.best.values() if most] or [0])
        return max(FEWEST_MATCHES, round(share * float(usual)))


def require_pycolmap(
    what: str = "finding the cameras of photographs",
    instead: str = "give photographs with cameras (docs/guide/data.md)",
) -> None:
    """Raises ComponentImportError, with what needs it and what to install, where pycolmap is missing."""
    try:
        module = importlib.import_module("pycolmap")
    except ImportError as error:
        raise ComponentImportError(
            f"{what} needs pycolmap ({error}); pip install 'gaussian-sculpting[pose]', or {instead}."
        ) from error
    module.logging.minloglevel = module.logging.Level.FATAL.value
    # It prints the stack on SIGTERM, which is no fault here.
    if threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, signal.getsignal(signal.SIGTERM))


def extract(
    database: Path, images: Path, names: Sequence[str], masks: Path | None, options: PosingOptions, tell: Tell
) -> None:
    """Features of ``names`` below ``images``; those of one folder share a camera, unless each has its own.

    The mask of ``images/a/b.jpg`` is ``masks/a/b.jpg.png``. Images that have features already are passed over.
    """
    import pycolmap

    pycolmap.set_random_seed(options.seed)
    mode = pycolmap.CameraMode.PER_IMAGE if options.cameras == "per-image" else pycolmap.CameraMode.PER_FOLDER
    reading = pycolmap.ImageReaderOptions()
    reading.camera_model = _LENS
    if masks is not None:
        reading.mask_path = masks
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.max_image_size = options.image_size
    extraction.num_threads = _threads(options)
    extraction.sift.max_num_features = options.features
    # Nearly twice the matches between views of dark bronze 16 degrees apart, for thrice the seconds of this step.
    extraction.sift.domain_size_pooling = True
    pycolmap.Database.open(database).close()
    # All cameras first: images of one camera that come in several calls would get one camera each call.
    pycolmap.import_images(database, images, camera_mode=mode, image_names=list(names), options=reading)
    step = 2 * _threads(options)
    tell(0, len(names))
    for start in range(0, len(names), step):
        batch = list(names[start : start + step])
        pycolmap.extract_features(
            database,
            images,
            image_names=batch,
            camera_mode=mode,
            reader_options=reading,
            extraction_options=extraction,
            device=pycolmap.Device.cpu,
        )
        tell(min(start + step, len(names)), len(names))


def leave_out_standing(database: Path, names: Sequence[str]) -> tuple[int, int]:
    """Take features of a background that stands still out of the database; how many, of how many. It is changed at
    once: a call that is killed leaves it as it was."""
    import pycolmap

    features = read_features(database, names)
    count = sum(len(each.places) for each in features)
    opened = pycolmap.Database.open(database)
    sides = [max(camera.width, camera.height) for camera in opened.read_all_cameras()]
    opened.close()
    found = standing(features, max(sides))
    if found is None:
        return 0, count
    changed = database.with_name("changed.db")
    shutil.copyfile(database, changed)
    opened = pycolmap.Database.open(changed)
    images = [opened.read_image_with_name(name) for name in names]
    kept = [
        (image.image_id, opened.read_keypoints(image.image_id), opened.read_descriptors(image.image_id), ~gone)
        for image, gone in zip(images, found, strict=True)
        if image is not None
    ]
    # Descriptors cannot be replaced one by one.
    opened.clear_descriptors()
    for number, keypoints, descriptors, these in kept:
        descriptors.data = np.asarray(descriptors.data)[these]
        opened.update_keypoints(number, np.asarray(keypoints)[these])
        opened.write_descriptors(number, descriptors)
    opened.close()
    os.replace(changed, database)
    return sum(int(each.sum()) for each in found), count


def match(database: Path, pairs: Sequence[tuple[str, str]], options: PosingOptions, tell: Tell) -> None:
    """Match features of pairs of images and verify them; pairs that are done already are passed over."""
    import pycolmap

    pycolmap.set_random_seed(options.seed)
    matching = pycolmap.FeatureMatchingOptions()
    matching.num_threads = _threads(options)
    # A second search along the epipolar lines of pairs that are verified: on dark bronze twice as many matches.
    matching.guided_matching = True
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = options.seed
    verification.ransac.max_num_trials = _MOST_TRIALS
    # What stands still while the object turns, and dirt on the lens.
    verification.filter_stationary_matches = True
    listed = database.with_name("pairs.txt")
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = listed
    tell(0, len(pairs))
    for start in range(0, len(pairs), _PAIRS_AT_ONCE):
        batch = pairs[start : start + _PAIRS_AT_ONCE]
        listed.write_text("".join(f"{first} {second}\n" for first, second in batch), encoding="utf-8")
        pycolmap.match_image_pairs(database, matching, pairing, verification, device=pycolmap.Device.cpu)
        tell(min(start + _PAIRS_AT_ONCE, len(pairs)), len(pairs))
    listed.unlink(missing_ok=True)


def matched(database: Path) -> Matched:
    """What the database holds of each image."""
    import pycolmap

    opened = pycolmap.Database.open(database)
    images = {image.image_id: image.name for image in opened.read_all_images()}
    features = {name: opened.num_keypoints_for_image(number) for number, name in images.items()}
    pairs, inliers = opened.read_two_view_geometry_num_inliers()
    opened.close()
    partners, best = dict.fromkeys(images.values(), 0), dict.fromkeys(images.values(), 0)
    for pair, count in zip(pairs, inliers, strict=True):
        if count > 0:
            for number in pycolmap.pair_id_to_image_pair(pair):
                name = images[number]
                partners[name] += 1
                best[name] = max(best[name], int(count))
    return Matched(features=features, partners=partners, best=best)


def map_images(
    database: Path, images: Path, folder: Path, options: PosingOptions, tell: Tell, *, straight: bool = False
) -> "list[pycolmap.Reconstruction]":
    """Incremental mapping; the models that could not be joined, the one with most images first. None: no model.

    By pairs of images with many matches first: those that look alike without being the same place (the sides of a box,
    an object on a turntable under lamps that stand still) have fewer, and find the others placed already.
    Models of fewer than three images, and those that have no image of their own, are left out. With
    ``straight``, lenses have a focal length and no distortion.
    """
    known = matched(database)
    best: list[pycolmap.Reconstruction] = []
    # Where few pairs have many matches, the first stage leaves pieces that do not grow together any more.
    for first in range(_ALWAYS):
        pieces: list[pycolmap.Reconstruction] = []
        for stage in range(first, len(_SHARES)):
            if stage >= _ALWAYS and _placed(pieces) == len(known.features):
                break
            mapping = _mapping(options, known.fewest(_SHARES[stage]), straight=straight)
            begun, out = pieces[0] if pieces else None, folder / f"{first} {stage}"
            pieces = _map(database, images, out, mapping, begun, len(known.features), tell) or pieces
        best = max(best, pieces, key=_placed)
        if _placed(best) == len(known.features):
            break
    return best


def grown(
    begun: "pycolmap.Reconstruction", database: Path, images: Path, folder: Path, options: PosingOptions, tell: Tell
) -> "pycolmap.Reconstruction | None":
    """The model with the images that it lacks, by all pairs, and adjusted; None: nothing of it holds together."""
    mapping = _mapping(options, FEWEST_MATCHES, straight=False)
    pieces = _map(database, images, folder, mapping, begun, len(matched(database).features), tell)
    return pieces[0] if pieces else None


def without(model: "pycolmap.Reconstruction", names: Sequence[str]) -> "pycolmap.Reconstruction":
    """A copy, as mapping would leave it without these images: photographs without a camera are not in it."""
    import pycolmap

    rest = pycolmap.Reconstruction(model)
    for image in list(rest.images.values()):
        if image.name in names:
            rest.deregister_frame(image.frame_id)
    rest.tear_down()
    return rest


def _placed(pieces: "Sequence[pycolmap.Reconstruction]") -> int:
    return pieces[0].num_reg_images() if pieces else 0


def _mapping(options: PosingOptions, fewest: int, *, straight: bool) -> "pycolmap.IncrementalPipelineOptions":
    import pycolmap

    pycolmap.set_random_seed(options.seed)
    mapping = pycolmap.IncrementalPipelineOptions()
    mapping.random_seed = mapping.mapper.random_seed = mapping.triangulation.random_seed = options.seed
    # With more threads the same matches give one of several models, from run to run.
    mapping.num_threads = mapping.mapper.num_threads = 1
    mapping.min_num_matches = fewest
    mapping.min_model_size = SMALLEST_MODEL
    mapping.max_num_models = _MOST_MODELS
    if straight:
        mapping.ba_refine_extra_params = mapping.mapper.abs_pose_refine_extra_params = False
    return mapping


def _map(
    database: Path,
    images: Path,
    folder: Path,
    mapping: "pycolmap.IncrementalPipelineOptions",
    begun: "pycolmap.Reconstruction | None",
    count: int,
    tell: Tell,
) -> "list[pycolmap.Reconstruction]":
    """The model that is ``begun`` with more images, where there is one, and further ones."""
    import pycolmap

    folder.mkdir(parents=True)
    before, placed = "", 0
    if begun is not None:
        before, placed = folder / "begun", begun.num_reg_images()
        before.mkdir()
        begun.write(before)

    def place(more: int) -> None:
        # Models begin anew with images that others have, so the count may go beyond all of them.
        nonlocal placed
        placed = min(placed + more, count)
        tell(placed, count)

    tell(placed, count)
    models = pycolmap.incremental_mapping(
        database,
        images,
        folder,
        mapping,
        input_path=before,
        initial_image_pair_callback=lambda: place(2),
        next_image_callback=lambda: place(1),
    )
    # Equal sizes: the one that was found first.
    in_order = [models[number] for number in sorted(models, key=lambda n: (-models[n].num_reg_images(), n))]
    seen: set[str] = set()
    pieces = []
    for model in in_order:
        own = world_to_cameras(model).keys() - seen
        if own and model.num_reg_images() >= SMALLEST_MODEL:
            pieces.append(model)
            seen |= own
    return pieces


def diverged(model: "pycolmap.Reconstruction") -> bool:
    """Whether a lens of it bends images as no lens does: then its poses are wrong, too."""
    for lens in model.cameras.values():
        focal, x, y, bend = lens.params
        pinhole, distortion = Pinhole(fx=focal, fy=focal, cx=x, cy=y), Distortion(coefficients=(bend, 0.0, 0.0, 0.0))
        try:
            rectify(pinhole, distortion, lens.width, lens.height, "")
        except DataError:
            return True
    return False


def refined(model: "pycolmap.Reconstruction") -> "pycolmap.Reconstruction":
    """The model, with the lenses' principal points estimated where they are notably away from the middle."""
    import pycolmap

    views = list(model.images.values())
    if len(views) < _ENOUGH_VIEWS * len(model.cameras):
        return model
    moved = pycolmap.Reconstruction(model)
    adjustment = pycolmap.BundleAdjustmentOptions()
    adjustment.refine_principal_point = True
    adjustment.print_summary = False
    adjustment.ceres.solver_options.num_threads = 1
    chosen = pycolmap.BundleAdjustmentConfig()
    for image in moved.reg_image_ids():
        chosen.add_image(image)
    chosen.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    pycolmap.create_default_bundle_adjuster(adjustment, chosen, moved).solve()
    moved.update_point_3d_errors()
    better = moved.compute_mean_reprojection_error() <= _WORTH_IT * model.compute_mean_reprojection_error()
    shift = max(map(_shift, moved.cameras.values()))
    return moved if better and _LEAST_SHIFT <= shift <= _MOST_SHIFT else model


def _shift(lens: "pycolmap.Camera") -> float:
    """Of the principal point from the middle of the image, as a share of the longer side."""
    x, y = lens.principal_point_x - lens.width / 2, lens.principal_point_y - lens.height / 2
    return float(np.hypot(x, y)) / max(lens.width, lens.height)


def world_to_cameras(model: "pycolmap.Reconstruction") -> dict[str, np.ndarray]:
    """4x4 matrices of the images that have a pose, OpenCV axes, by name."""
    out = {}
    for image in model.images.values():
        if image.has_pose:
            out[image.name] = np.eye(4)
            out[image.name][:3] = image.cam_from_world().matrix()
    return out


def tracked(model: "pycolmap.Reconstruction") -> Int64[np.ndarray, " n"]:
    """Numbers of the points that three images or more show."""
    return np.array([number for number, point in model.points3D.items() if point.track.length() >= 3], np.int64)


def _threads(options: PosingOptions) -> int:
    if options.threads is not None:
        return options.threads
    import torch

    return torch.get_num_threads()
