"""Pieces of a mapping that have photographs in common, laid over each other."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sculpt_framework.posing.colmap import matched

if TYPE_CHECKING:
    import pycolmap


def join(
    models: "Sequence[pycolmap.Reconstruction]",
    database: Path,
    images: Path,
    work: Path,
    *,
    straight: bool = False,
) -> "list[pycolmap.Reconstruction]":
    """The models, the first with all those that can be laid over it, the others as they are.

    The similarity between two is that by which features of the photographs they share reproject into the other. Points
    are then triangulated anew from the matches of all photographs, and everything is adjusted together; with
    ``straight``, lenses keep no distortion. ``work`` is a folder for intermediate files.
    """
    if len(models) < 2:
        return list(models)
    import pycolmap

    whole, apart = pycolmap.Reconstruction(models[0]), list(models[1:])
    taken = True
    while taken:  # What could not be laid over the first may go over what has joined it.
        before = len(apart)
        apart = [piece for piece in apart if not _take_in(whole, piece)]
        taken = len(apart) < before
    if len(apart) == len(models) - 1:
        return list(models)
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = 1
    options.min_num_matches = matched(database).fewest()
    work.mkdir(parents=True, exist_ok=True)
    whole = pycolmap.triangulate_points(whole, database, images, work, clear_points=True, options=options)
    adjustment = pycolmap.BundleAdjustmentOptions()
    adjustment.print_summary = False
    adjustment.refine_extra_params = not straight
    adjustment.ceres.solver_options.num_threads = 1
    pycolmap.bundle_adjustment(whole, adjustment)
    whole.update_point_3d_errors()
    return [whole, *apart]


def _take_in(whole: "pycolmap.Reconstruction", piece: "pycolmap.Reconstruction") -> bool:
    """Place the photographs that only ``piece`` has in ``whole``, if the two can be laid over each other."""
    import pycolmap

    if not whole.find_common_reg_image_ids(piece):
        return False
    similarity = pycolmap.align_reconstructions_via_reprojections(piece, whole)
    if similarity is None:
        return False
    for image in piece.images.values():
        if not whole.exists_image(image.image_id):
            _add(whole, piece, image)
            moved = similarity.transform_camera_world(image.cam_from_world())
            whole.frame(image.frame_id).set_cam_from_world(image.camera_id, moved)
            whole.register_frame(image.frame_id)
    return True


def _add(whole: "pycolmap.Reconstruction", piece: "pycolmap.Reconstruction", image: "pycolmap.Image") -> None:
    """The photograph and what it needs, without a pose and without points."""
    import pycolmap

    rig = piece.frame(image.frame_id).rig_id
    if not whole.exists_camera(image.camera_id):
        whole.add_camera(piece.camera(image.camera_id))
    if not whole.exists_rig(rig):
        whole.add_rig(piece.rig(rig))
    frame = pycolmap.Frame(frame_id=image.frame_id, rig_id=rig)
    frame.add_data_id(image.data_id)
    whole.add_frame(frame)
    places = np.array([feature.xy for feature in image.points2D]).reshape(-1, 2)
    copy = pycolmap.Image(name=image.name, keypoints=places, camera_id=image.camera_id, image_id=image.image_id)
    copy.frame_id = image.frame_id
    whole.add_image(copy)
