"""A run directory as the viewer reads it: while it grows, when it is finished, and when it was killed."""

import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from sculpt_framework.config import MethodConfig
from sculpt_framework.engine.run import EVENTS_NAME, MESH_NAME, read_config, run_status
from sculpt_framework.errors import SculptError
from sculpt_framework.export.gaussian_files import read_gaussians_ply
from sculpt_framework.export.mesh_files import read_colored_mesh
from sculpt_framework.sculpting.config import SculptingConfig
from sculpt_framework.types import Scene
from sculpt_framework.viewing.frames import FOLDER, LIVE, Frame, read_frame, step_files

Status = Literal["running", "silent", "finished", "stopped", "failed"]
_SILENT_SECONDS = 60.0
"""A run that has said nothing for so long is in a very long step, or was killed."""


class RunFolder:
    """What is known of the run in ``folder``; ``read_news`` brings it up to date.

    Raises CheckpointError if it is not a run directory.
    """

    def __init__(self, folder: Path, *, alive: bool = False):
        """``alive``: it is known that the run goes on, however long it says nothing."""
        self.folder = folder
        self._alive = alive
        self.config: MethodConfig = read_config(folder)
        self.started: Mapping[str, Any] = {}
        """What the run said when it started."""
        self._under_way = False
        """Whether it has said last that it starts, and not that it ends."""
        self._position = 0
        self._rest = b""

    def read_news(self) -> list[Mapping[str, Any]]:
        """Events since the last call; half a line is left for the next."""
        try:
            with open(self.folder / EVENTS_NAME, "rb") as file:
                file.seek(self._position)
                data = file.read()
        except FileNotFoundError:
            return []
        self._position += len(data)
        *lines, self._rest = (self._rest + data).split(b"\n")
        events: list[Mapping[str, Any]] = []
        for line in lines:
            try:
                event = json.loads(line)
            except ValueError:
                continue  # cut short when a run was killed; the run that went on begins a new line
            if isinstance(event, dict) and isinstance(event.get("data"), dict):
                events.append(event)
                if event["event"] == "run_started":
                    self.started = event["data"]
                if event["event"] in ("run_started", "run_ended"):
                    self._under_way = event["event"] == "run_started"
        return events

    @property
    def has_events(self) -> bool:
        """Whether the run's recorder has written anything; a run can do without."""
        return (self.folder / EVENTS_NAME).exists()

    @property
    def silent_seconds(self) -> float:
        """Since the run last wrote an event."""
        try:
            return max(0.0, time.time() - (self.folder / EVENTS_NAME).stat().st_mtime)
        except FileNotFoundError:
            return float("inf")

    @property
    def status(self) -> Status:
        """How the run stands, as far as its files tell."""
        match run_status(self.folder):
            case "finished":
                return "finished"
            case "stopped" | "failed" as ended if not self._under_way:
                return ended
            case _:  # A run that was resumed leaves what it said when it was stopped.
                return "silent" if not self._alive and self.silent_seconds > _SILENT_SECONDS else "running"

    def load_scene(self) -> Scene:
        """The views the run learns from. Raises DataError if they are not there any more."""
        return self.config.dataset.build(self.config.data).load()

    @property
    def live_stamp(self) -> tuple[str, int]:
        """Changes when there is a newer state to show."""
        if (latest := self._latest()) is not None:
            path, stamp = latest
            return path.name, stamp
        # Of a run that goes on something newer will come; of one that was killed an older file is all there is.
        return ("", 0) if self.status == "running" else ("checkpoint", len(step_files(self.folder)))

    def newest(self) -> Frame | None:
        """The result or the latest snapshot, whichever is newer; without either, of a run that does not go on, what the
        checkpoint holds or the last recorded step; None if nothing is there yet.

        Raises CheckpointError or DataError if it cannot be read.
        """
        if (latest := self._latest()) is not None:
            path, _ = latest
            return self._result() if path.name == MESH_NAME else read_frame(path)
        if self.status == "running":
            return None
        from sculpt_framework.viewing.checkpointed import frame_of_checkpoint

        try:
            return frame_of_checkpoint(self.folder, self.config)
        except SculptError:
            steps = step_files(self.folder)
            if not steps:
                raise
            return read_frame(steps[-1][1])

    @property
    def low_pass_px2(self) -> float:
        """That Gaussians of the run are drawn with."""
        return self.config.trainer.low_pass_px2 if isinstance(self.config, SculptingConfig) else 0.0

    def _latest(self) -> tuple[Path, int] | None:
        """The result or the latest snapshot, and when it was written. What a run was stopped with is older than the
        snapshots it takes once it is resumed; of a finished run the result counts, however its files were copied."""
        paths = (self.folder / MESH_NAME, self.folder / FOLDER / LIVE)
        found = [(path, stamp) for path in paths if (stamp := _written(path)) is not None]
        if run_status(self.folder) == "finished":
            found = found[:1]
        return max(found, key=lambda each: each[1], default=None)

    def _result(self) -> Frame:
        vertices, faces, colors = read_colored_mesh(self.folder / MESH_NAME)
        path = self.folder / "gaussians.ply"
        return Frame(
            outer=-1,
            t_train=float("nan"),
            vertices=vertices.astype(np.float32),
            faces=faces,
            colors=np.full(vertices.shape, 0.7, np.float32) if colors is None else colors.astype(np.float32),
            gaussians=read_gaussians_ply(path) if path.exists() else None,
        )


def _written(path: Path) -> int | None:
    """When, in nanoseconds; None if there is no such file."""
    try:
        return path.stat().st_mtime_ns
    except FileNotFoundError:
        return None
