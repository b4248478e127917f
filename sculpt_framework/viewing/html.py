"""A run as one HTML file that plays how its surface came to be: no server, nothing loaded from elsewhere."""

from pathlib import Path

from sculpt_framework.errors import CheckpointError
from sculpt_framework.export.atomic import write_atomically
from sculpt_framework.spread import spread
from sculpt_framework.viewing.colors import COLORS, paint
from sculpt_framework.viewing.frames import Frame, read_frame, step_files
from sculpt_framework.viewing.layers import show_mesh, show_splats
from sculpt_framework.viewing.run_folder import RunFolder
from sculpt_framework.viewing.server import look_from_aside, start_server, stop_server

_SECONDS_PER_STEP = 0.4
_LAST_SECONDS = 3.0
_STEPS_AT_MOST = 40
FACES_AT_MOST = 4_000_000
"""In all steps together: 80 MB or so, which a browser still opens at once."""
_SPLATS_AT_MOST = 200_000


def write_html(folder: Path, out: Path) -> int:
    """Write the page; returns how many steps it plays, the last being the newest state.

    The steps are those a viewer recorded (RUN_DIR/evolution); without any the page shows the newest state alone. At its
    end the page turns to the Gaussians. Raises CheckpointError where the folder is no run or holds no surface yet.
    """
    last = RunFolder(folder).newest()
    if last is None or len(last.faces) == 0:
        raise CheckpointError(f"{folder} has no surface to show yet.")
    most = min(_STEPS_AT_MOST, max(1, FACES_AT_MOST // len(last.faces)))
    chosen = spread(step_files(folder), most)
    write_atomically(out, _play([*(read_frame(path) for _, path in chosen), last]).encode("utf-8"))
    return len(chosen) + 1


def _play(frames: list[Frame]) -> str:
    last = frames[-1]
    server = start_server("127.0.0.1", 0)
    try:
        scene = server.scene
        scene.set_up_direction("+z")
        look_from_aside(server, last.vertices.min(axis=0), last.vertices.max(axis=0))
        recording = server.get_scene_serializer()
        shown = None
        for index, frame in enumerate(frames):
            node = show_mesh(scene, paint(frame, COLORS, None, ()), name=f"/mesh-{index}")
            if shown is not None:
                shown.visible = False
            shown = node
            recording.insert_sleep(_SECONDS_PER_STEP)
        recording.insert_sleep(_LAST_SECONDS)
        if last.gaussians is not None and shown is not None:
            show_splats(scene, last.gaussians, _SPLATS_AT_MOST)
            shown.visible = False
            recording.insert_sleep(_LAST_SECONDS)
        return recording.as_html()
    finally:
        stop_server(server)
