"""What is left between two photographs when one is brought into the other through a mesh."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float32, Float64, Int32, Int64, UInt8

from sculpt_framework.cpu_kernels import kernel_cache
from sculpt_framework.evaluation.image_pairs import PreparedImage
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.export.mesh_pixels import MeshPixels, farthest_around, from_camera_to_camera, lens_values

with kernel_cache("evaluation", Path(__file__).with_name("warp_kernels.py")):
    from sculpt_framework.evaluation import warp_kernels as kernels

STRIDE = 2
"""Every so many pixels are judged, down and across: the flow is smoother than that."""
_GREY, _GREYS_PER_CONTRAST = 128, 50
"""How normalised brightness becomes the 8 bits that the flow takes; two and a half contrasts up and down fit."""
_PATCH, _PATCH_STRIDE, _DESCENTS, _SMOOTHINGS = 16, 8, 8, 5
"""Of the flow: sides and distance of its patches in pixels, and rounds of its two parts."""
_BORDER = np.ones((5, 5), np.uint8)
"""Pixels so near the border of what both images show are not judged."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Residuals:
    """Of one pair of images."""

    pixels: Float32[np.ndarray, " n"]
    """Length of the displacement left, in pixels of the first view as it was given, for every pixel that is judged."""
    depths: Float64[np.ndarray, " m"]
    """How far the surface is off across itself, scene units, where the displacement leads to a place on the surface:
    by what is left along epipolar lines."""
    beside: Float64[np.ndarray, " m"]
    """What the displacement across epipolar lines would come to. No depth explains it: cameras, noise and gloss do."""
    places: Int64[np.ndarray, "m 2"]
    """Rows and columns of these pixels, of the first image as it was prepared."""
    facing: Float64[np.ndarray, " m"]
    """What a unit of camera z is across the surface there."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Warp:
    """Where the first image's pixels lie in the second, as ``warp_kernels.project`` says."""

    places: Float32[np.ndarray, "h w 2"]
    slopes: Float32[np.ndarray, "h w 2"]
    state: UInt8[np.ndarray, "h w"]


@dataclass(frozen=True, kw_only=True, eq=False)
class SeenMesh:
    """A photograph, and the mesh as its camera sees it."""

    image: PreparedImage
    pixels: MeshPixels


def residuals(mesh: Mesh, first: SeenMesh, second: SeenMesh, slack: float) -> Residuals:
    """Lay the second image over the first through the mesh, all in world frame.

    A pixel is judged where it is in both masks, has texture, and the second camera sees the same place: by depth, but
    for ``slack`` scene units.
    """
    here, there = first.image, second.image
    warp = _project(first, second, slack)
    both = here.mask & (warp.state > 0) & (_sample(there.mask.astype(np.float32), warp.places) > 0.99)
    flow = _flow(np.where(both, here.normalised, 0), np.where(both, _sample(there.normalised, warp.places), 0))
    kept = cv2.erode(both.astype(np.uint8), _BORDER, borderType=cv2.BORDER_CONSTANT, borderValue=0)
    judged = (np.asarray(kept) > 0) & here.textured & (warp.state == kernels.SEEN)
    rows, columns = (STRIDE * index for index in np.nonzero(judged[::STRIDE, ::STRIDE]))
    facing = _facing(mesh, here, rows, columns, first.pixels.face[rows, columns])
    depths = np.empty((len(rows), 2))
    kernels.distances(rows, columns, flow, warp.places, warp.slopes, warp.state, facing, depths)
    lengths = np.linalg.norm(flow[rows, columns], axis=1).astype(np.float32)
    known = np.isfinite(depths[:, 0])
    return Residuals(
        pixels=lengths / np.float32(here.scale),
        depths=depths[known, 0],
        beside=depths[known, 1],
        places=np.stack([rows, columns], axis=1)[known],
        facing=facing[known],
    )


def _project(first: SeenMesh, second: SeenMesh, slack: float) -> _Warp:
    depth, cameras = first.pixels.depth, (first.image.camera, second.image.camera)
    places, slopes = np.empty((*depth.shape, 2), np.float32), np.zeros((*depth.shape, 2), np.float32)
    state = np.zeros(depth.shape, np.uint8)
    rotation, shift = from_camera_to_camera(*cameras)
    lens, other = (lens_values(camera) for camera in cameras)
    farthest = farthest_around(second.pixels.depth)
    kernels.project(depth, lens, rotation, shift, other, farthest, slack, places, slopes, state)
    return _Warp(places=places, slopes=slopes, state=state)


def _sample(image: Float32[np.ndarray, "h w"], places: Float32[np.ndarray, "h2 w2 2"]) -> Float32[np.ndarray, "h2 w2"]:
    """Bicubic; 0 outside the image."""
    columns, rows = cv2.split(places)
    return np.asarray(cv2.remap(image, columns, rows, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT, borderValue=0))


def _flow(first: Float32[np.ndarray, "h w"], second: Float32[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w 2"]:
    """Columns and rows from a pixel of the first image to what looks like it in the second; coarse to fine."""
    finder = cv2.DISOpticalFlow.create()
    finder.setFinestScale(0)
    finder.setPatchSize(_PATCH)
    finder.setPatchStride(_PATCH_STRIDE)
    finder.setGradientDescentIterations(_DESCENTS)
    finder.setVariationalRefinementIterations(_SMOOTHINGS)
    grey = [np.clip(np.rint(_GREY + _GREYS_PER_CONTRAST * image), 0, 255).astype(np.uint8) for image in (first, second)]
    # It takes no image smaller than its patches.
    height, width = first.shape
    beside = ((0, max(0, 3 * _PATCH - height)), (0, max(0, 3 * _PATCH - width)))
    wide = [np.pad(each, beside, constant_values=_GREY) for each in grey]
    return np.asarray(finder.calc(wide[0], wide[1], np.zeros((*wide[0].shape, 2), np.float32)))[:height, :width]


def _facing(
    mesh: Mesh,
    image: PreparedImage,
    rows: Int64[np.ndarray, " n"],
    columns: Int64[np.ndarray, " n"],
    faces: Int32[np.ndarray, " n"],
) -> Float64[np.ndarray, " n"]:
    """By how much the surface at some pixels goes away from itself per unit of camera z."""
    camera = image.camera
    ways = np.stack(
        [(columns + 0.5 - camera.cx) / camera.fx, (rows + 0.5 - camera.cy) / camera.fy, np.ones(len(rows))], axis=1
    )
    normals = mesh.area_vectors[faces] / np.maximum(mesh.areas[faces, None], np.finfo(np.float64).tiny)
    return np.abs(np.sum(normals @ camera.world_to_camera.double().numpy()[:3, :3].T * ways, axis=1))
