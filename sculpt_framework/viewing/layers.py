"""The layers of the scene: each puts one thing into viser's scene tree, world frame."""

import math
from collections.abc import Sequence

import numpy as np
import torch
import trimesh
import viser
import viser.transforms
from jaxtyping import Float

from sculpt_framework.export.mesh_files import srgb_to_linear
from sculpt_framework.rendering.spherical_harmonics import sh_to_rgb
from sculpt_framework.types import Camera, Gaussians, View
from sculpt_framework.viewing.colors import Painted, ramp
from sculpt_framework.viewing.frames import Cells, Frame

_THUMBNAIL_PIXELS = 96
_LEVELS_SHOWN = 8
_CELLS_AT_MOST = 40_000
"""More cells than this are thinned out: a page is to stay fluent."""


def show_mesh(scene: viser.SceneApi, painted: Painted, *, name: str = "/mesh") -> viser.GlbHandle:
    # The browser takes vertex colours for linear light, as glTF has them.
    colors = (255 * srgb_to_linear(painted.colors.clip(0, 1)) + 0.5).astype(np.uint8)
    mesh = trimesh.Trimesh(vertices=painted.vertices, faces=painted.faces, vertex_colors=colors, process=False)
    return scene.add_mesh_trimesh(name, mesh)


def show_wireframe(scene: viser.SceneApi, frame: Frame) -> viser.MeshHandle:
    return scene.add_mesh_simple(
        "/wireframe",
        frame.vertices,
        frame.faces.astype(np.uint32),
        color=(20, 20, 20),
        wireframe=True,
    )


def show_splats(scene: viser.SceneApi, gaussians: Gaussians, most: int) -> viser.GaussianSplatHandle:
    """True splats in their colour along the normal; of more than ``most`` a part, each as much wider."""
    rgb = sh_to_rgb(gaussians.sh, -gaussians.rotations[:, :, 0], torch.zeros(3)).clamp(0, 1)
    scales, keep = gaussians.scales, torch.arange(len(gaussians))
    if len(gaussians) > most:
        keep = torch.linspace(0, len(gaussians) - 1, most).long()
        # Tangential widths alone: thicker splats would stand off the surface.
        scales = scales * torch.tensor([1.0, *[math.sqrt(len(gaussians) / most)] * 2])
    factor = gaussians.rotations[keep] * scales[keep][:, None]
    return scene.add_gaussian_splats(
        "/gaussians",
        centers=gaussians.means[keep].numpy(),
        covariances=(factor @ factor.transpose(1, 2)).numpy(),
        rgbs=rgb[keep].numpy(),
        opacities=gaussians.opacities[keep][:, None].numpy(),
    )


def show_box(
    scene: viser.SceneApi, name: str, low: Float[np.ndarray, " 3"], high: Float[np.ndarray, " 3"]
) -> viser.LineSegmentsHandle:
    lines = low + _cube_edges() * (high - low)
    return scene.add_line_segments(name, lines, (90, 90, 90), thickness=1.5, thickness_units="screen")


def show_cells(scene: viser.SceneApi, cells: Cells) -> viser.FrameHandle:
    """Cells as wire cubes, a colour for each level."""
    root = scene.add_frame("/cells", show_axes=False)
    edges = _cube_edges().astype(np.float32)
    thin = max(1, -(-len(cells.level) // _CELLS_AT_MOST))
    for level in np.unique(cells.level).tolist():
        chosen = np.flatnonzero(cells.level == level)[::thin]
        lines = cells.minimum[chosen, None, None] + edges[None] * cells.side[chosen, None, None, None]
        color = (255 * ramp(np.array([level % _LEVELS_SHOWN / (_LEVELS_SHOWN - 1)]))[0]).astype(np.uint8)
        scene.add_line_segments(
            f"/cells/level-{level}", lines.reshape(-1, 2, 3), color, thickness=1.0, thickness_units="screen"
        )
    return root


def _cube_edges() -> Float[np.ndarray, "12 2 3"]:
    """Ends of the edges of the unit cube."""
    corners = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    pairs = [(a, b) for a in range(8) for b in range(a) if np.abs(corners[a] - corners[b]).sum() == 1]
    return np.stack([corners[list(pair)] for pair in pairs])


def show_cameras(scene: viser.SceneApi, views: Sequence[View], size: float) -> list[viser.CameraFrustumHandle]:
    """A frustum with a small image for each view, under /cameras; ``size`` is how deep they are."""
    out = []
    for index, view in enumerate(views):
        camera = view.camera
        wxyz, position = camera_pose(camera)
        out.append(
            scene.add_camera_frustum(
                f"/cameras/{index}",
                fov=vertical_fov(camera),
                aspect=camera.width / camera.height,
                scale=size,
                thickness=1.0,
                thickness_units="screen",
                image=thumbnail(view),
                jpeg_quality=70,
                wxyz=wxyz,
                position=position,
                cast_shadow=False,
                receive_shadow=False,
            )
        )
    return out


def camera_pose(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Quaternion (w x y z) and position of a camera in the surrounding frame."""
    rotation = camera.world_to_camera[:3, :3].T.double().numpy()
    return viser.transforms.SO3.from_matrix(rotation).wxyz, camera.position.double().numpy()


def vertical_fov(camera: Camera) -> float:
    """Radians."""
    return 2 * math.atan(0.5 * camera.height / camera.fy)


def thumbnail(view: View) -> np.ndarray:
    """A small picture of the view, over white, as bytes."""
    step = max(1, max(view.rgb.shape[:2]) // _THUMBNAIL_PIXELS)
    rgb = view.rgb[::step, ::step]
    if view.alpha is not None:
        rgb = rgb * view.alpha[::step, ::step, None] + (1 - view.alpha[::step, ::step, None])
    return as_bytes(rgb.numpy())


def as_bytes(rgb: np.ndarray) -> np.ndarray:
    return (255 * rgb.clip(0, 1) + 0.5).astype(np.uint8)
