"""``sculpt-export``: the results of a run in the format another program wants."""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from sculpt_framework.cli import exit_codes
from sculpt_framework.command_line.options import Flag
from sculpt_framework.errors import CheckpointError, ConfigError

if TYPE_CHECKING:
    import numpy as np

    from sculpt_framework.export.assets import TexturedMesh
    from sculpt_framework.types import Scene

_ENDINGS = {"gaussians": ".ply", "turntable": ".gif"}


@dataclass(frozen=True, kw_only=True)
class ExportRequest:
    """Write the mesh or the Gaussians of a run, or pictures of the mesh."""

    run_dir: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN_DIR")]
    """Run directory."""
    format: Literal["obj", "ply", "glb", "gaussians", "turntable", "maps", "html"]
    """obj, ply, glb: the mesh with vertex colours. gaussians: PLY as 3DGS has it, for splat viewers. turntable: GIF or
    MP4. maps: depths and normals from the cameras of the run, a folder. html: a page that plays how the surface came to
    be, from the steps a viewer recorded, also of a run that has not finished."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")] = None
    """File to write. Default: mesh.FORMAT, gaussians.ply, turntable.gif or maps in the run directory."""
    target_faces: Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="")] = None
    """Simplify the mesh to at most so many faces; it stays closed."""
    texture: Flag = False
    """glb, obj, turntable: a texture baked from the photographs of the run, instead of vertex colours."""
    texture_size: Annotated[int, tyro.conf.arg(metavar="TEXELS")] = 2048
    """About how wide and high the texture is."""
    attributes: Flag = False
    """ply: also normals, how many photographs show a vertex, and at which angle the best of them does."""
    data: Annotated[str | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")] = None
    """Where the photographs are, if not where the run found them."""
    cameras: Literal["train", "test"] = "train"
    """maps: whose cameras."""
    frames: Annotated[int, tyro.conf.arg(metavar="N")] = 60
    """turntable: pictures in a turn."""
    size: Annotated[int, tyro.conf.arg(metavar="PIXELS")] = 480
    """turntable: side of a picture."""
    up: Literal["x", "y", "z", "-x", "-y", "-z"] = "z"
    """turntable: the direction that is up; COLMAP's models often have -y."""


def main() -> None:
    """The console script ``sculpt-export``."""
    exit_codes.run(lambda: export(sys.argv[1:]))


def export(words: Sequence[str]) -> None:
    """Write the file and say where it is. Raises SculptError; exits as tyro does for ``--help``."""
    request = tyro.cli(ExportRequest, args=words, prog="sculpt-export")
    _check(request)
    if request.format == "html":
        _write_html(request)
        return
    name = "gaussians.ply" if request.format == "gaussians" else "mesh.ply"
    source = request.run_dir / name
    if not source.is_file():
        raise CheckpointError(
            f"{request.run_dir} has no {name}: not a run directory, or a run that has not finished;"
            f" sculpt-train --resume {request.run_dir} goes on with it."
        )
    out = request.out or _default_place(request)
    for line in _write(source, request, out):
        sys.stdout.write(f"{line}\n")


def _write_html(request: ExportRequest) -> None:
    from sculpt_framework.viewing.html import write_html

    out = request.out or request.run_dir / "evolution.html"
    steps = write_html(request.run_dir, out)
    sys.stdout.write(f"{out}\n")
    if steps == 1:
        sys.stdout.write("note: one state only; a run with --viewer records the steps on its way.\n")


def _default_place(request: ExportRequest) -> Path:
    if request.format == "maps":
        return request.run_dir / "maps"
    stem = request.format if request.format in _ENDINGS else "mesh"
    # mesh.ply and mesh.glb are the run's own: an export of another kind gets a name of its own.
    parts = [stem]
    if request.target_faces is not None:
        parts.append(str(request.target_faces))
    if request.texture:
        parts.append("textured")
    if request.attributes:
        parts.append("attributes")
    return request.run_dir / ("-".join(parts) + _ENDINGS.get(request.format, f".{request.format}"))


def _check(request: ExportRequest) -> None:
    """Raises ConfigError for options that do not go together."""
    if request.texture and request.format not in ("glb", "obj", "turntable"):
        raise ConfigError(f"--texture goes with --format glb, obj or turntable, not {request.format}.")
    if request.attributes and request.format != "ply":
        raise ConfigError(f"--attributes goes with --format ply, not {request.format}.")
    if request.target_faces is not None and request.format == "gaussians":
        raise ConfigError("--target-faces is for the mesh; Gaussians lie on the faces of the whole one.")
    if not 1 <= request.frames <= 3600:
        raise ConfigError(f"--frames is {request.frames}; expected 1 to 3600.")
    if not 16 <= request.size <= 4096:
        raise ConfigError(f"--size is {request.size}; expected 16 to 4096 pixels.")


@dataclass(frozen=True, kw_only=True, eq=False)
class _Mesh:
    """World frame."""

    vertices: "np.ndarray"
    faces: "np.ndarray"
    colors: "np.ndarray | None"


def _write(source: Path, request: ExportRequest, out: Path) -> list[str]:
    """Write, and what to say about it, the file first."""
    from sculpt_framework.export.atomic import write_atomically

    plain = request.target_faces is None and not request.attributes
    if request.format in ("ply", "gaussians") and plain:
        if not (out.exists() and out.samefile(source)):
            write_atomically(out, source.read_bytes())
        return [str(out)]
    mesh = _read(source, request.target_faces)
    if request.format == "turntable":
        return _write_turntable(mesh, request, out)
    if request.format == "maps":
        return _write_maps(mesh, request, out)
    if request.texture:
        return _write_textured(mesh, request, out)
    if request.attributes:
        return _write_attributes(mesh, request, out)
    from sculpt_framework.export import mesh_files

    writers = {
        "obj": mesh_files.write_mesh_obj,
        "glb": mesh_files.write_mesh_glb,
        "ply": mesh_files.write_mesh_ply,
    }
    writers[request.format](out, mesh.vertices, mesh.faces, mesh.colors)
    return [str(out)]


def _read(source: Path, target_faces: int | None) -> _Mesh:
    from sculpt_framework.export import mesh_files

    vertices, faces, colors = mesh_files.read_colored_mesh(source)
    if target_faces is not None:
        from sculpt_framework.export.decimation import carry_over, decimate

        few, faces_left = decimate(vertices, faces, target_faces)
        if colors is not None and few is not vertices:
            colors = carry_over(colors, vertices, faces, few)
        vertices, faces = few, faces_left
    return _Mesh(vertices=vertices, faces=faces, colors=colors)


def _scene(request: ExportRequest) -> "Scene":
    """The run's photographs and cameras. Raises CheckpointError where the run does not say which, DataError."""
    from sculpt_framework.engine.run import read_config
    from sculpt_framework.errors import DataError

    config = read_config(request.run_dir)
    try:
        return config.dataset.build(request.data or config.data).load()
    except DataError as error:
        if request.data is not None:
            raise
        raise DataError(f"{error} The run was made from {config.data}; --data DIR says where it is now.") from None


def _colors(mesh: _Mesh) -> "np.ndarray":
    import numpy as np

    return np.full(mesh.vertices.shape, 0.7) if mesh.colors is None else mesh.colors


def _textured(mesh: _Mesh, request: ExportRequest) -> "TexturedMesh":
    from sculpt_framework.export.assets import TexturedMesh
    from sculpt_framework.export.texture import bake, unwrap

    atlas = unwrap(mesh.vertices, mesh.faces, request.texture_size)
    texture = bake(mesh.vertices, mesh.faces, atlas, _scene(request).train, _colors(mesh))
    return TexturedMesh(vertices=mesh.vertices, faces=mesh.faces, atlas=atlas, texture=texture)


def _write_textured(mesh: _Mesh, request: ExportRequest, out: Path) -> list[str]:
    from sculpt_framework.export.assets import write_textured_glb, write_textured_obj

    textured = _textured(mesh, request)
    if request.format == "glb":
        write_textured_glb(out, textured)
        written = [out]
    else:
        written = write_textured_obj(out, textured)
    unseen = 100 * (1 - textured.texture.seen_share)
    size = f"{textured.atlas.width}x{textured.atlas.height}"
    said = (
        f"{len(mesh.faces)} faces, texture {size}; {unseen:.1f} % of it is in no photograph and has the mesh's colours"
    )
    return [*(str(path) for path in written), said]


def _write_attributes(mesh: _Mesh, request: ExportRequest, out: Path) -> list[str]:
    from sculpt_framework.export.assets import write_attribute_ply
    from sculpt_framework.export.mesh_files import vertex_normals
    from sculpt_framework.export.mesh_pixels import visibility

    cameras = [view.camera for view in _scene(request).train]
    normals = vertex_normals(mesh.vertices, mesh.faces)
    seen = visibility(mesh.vertices, mesh.faces, normals, cameras)
    write_attribute_ply(out, mesh.vertices, mesh.faces, _colors(mesh), seen)
    unseen = int((seen.times_seen == 0).sum())
    return [str(out), f"{unseen} of {len(mesh.vertices)} vertices are in no photograph: times_seen is 0 there"]


def _write_turntable(mesh: _Mesh, request: ExportRequest, out: Path) -> list[str]:
    from sculpt_framework.evaluation.pictures import color_picture
    from sculpt_framework.export.pictures import paint, turntable_cameras, write_turntable

    colors = _textured(mesh, request) if request.texture else _colors(mesh)
    cameras = turntable_cameras(mesh.vertices, request.up, request.frames, request.size)
    pictures = (color_picture(paint(mesh.vertices, mesh.faces, colors, camera)) for camera in cameras)
    # A turn takes four seconds, at a rate that players keep.
    write_turntable(out, pictures, max(1, min(30, round(request.frames / 4))))
    return [str(out)]


def _write_maps(mesh: _Mesh, request: ExportRequest, out: Path) -> list[str]:
    from sculpt_framework.export.pictures import write_maps

    scene = _scene(request)
    views = scene.train if request.cameras == "train" else scene.test
    if not views:
        raise ConfigError(f"the run has no {request.cameras} views; choose other --cameras.")
    count = write_maps(out, mesh.vertices, mesh.faces, views)
    return [str(out), f"depth/NAME.tiff and normal/NAME.png for {count} {request.cameras} views"]


if __name__ == "__main__":
    main()
