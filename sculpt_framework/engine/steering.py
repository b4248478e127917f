"""Obeys commands between two outer steps, and tells what it did in "action" events."""

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from sculpt_framework.commands import (
    LASTING,
    Command,
    ExportMesh,
    Pause,
    Recorded,
    Resume,
    Stop,
    TakeSnapshot,
    command_to_json,
)
from sculpt_framework.engine.session import Session
from sculpt_framework.errors import SculptError
from sculpt_framework.export.atomic import make_folder
from sculpt_framework.export.mesh_files import write_mesh_glb, write_mesh_ply
from sculpt_framework.geometry.signed_distance import EmptySurfaceError

_PAUSE_POLL_SECONDS = 0.05
SNAPSHOT_SHARE = 0.005
"""Of the run's time that snapshots may take, at most: costly ones come less often."""


class Steering:
    """Called after the start and every step; says whether the run is to end.

    ``sources`` give commands as they come; ``replay`` those of an earlier run, each due after as many outer steps as it
    was obeyed after then. What is not valid in this run is refused, with an "action" event that says why.
    """

    def __init__(
        self,
        session: Session,
        *,
        folder: Path,
        sources: Sequence[Callable[[], Sequence[Command]]] = (),
        replay: Sequence[Recorded] = (),
        interrupted: Callable[[], bool] = lambda: False,
        snapshot_seconds: float | None = None,
    ):
        self._session = session
        self._folder = folder
        self._sources = sources
        self._replay = list(replay)
        self._interrupted = interrupted
        self._snapshot_seconds = snapshot_seconds
        self._next_snapshot = float("-inf")
        self._snapshot_wanted = False
        self._paused = False
        self._stopping = False

    def __call__(self) -> bool:
        while self._replay and self._replay[0].outer <= self._session.step:
            self.obey(self._replay.pop(0).command, "replay")
        self._poll()
        if self._paused:
            with self._session.host.clock.pause():
                while self._paused and not self._stopping and not self._interrupted():
                    self._snapshot_if_due()
                    time.sleep(_PAUSE_POLL_SECONDS)
                    self._poll()
        self._snapshot_if_due()
        return self._stopping or self._interrupted()

    def obey(self, command: Command, source: str) -> None:
        """Do what the command says and tell of it; a command that is not valid here is refused and changes nothing."""
        if isinstance(command, TakeSnapshot):
            self._snapshot_wanted = True
            return
        try:
            message, facts = self._do(command, self._session.step)
        except (SculptError, EmptySurfaceError, FloatingPointError) as error:
            message, facts = f"refused: {error}", {"refused": True}
        self._session.host.tell(
            "action", {"message": message, "command": command_to_json(command), "source": source, **facts}
        )

    def take_up(self, commands: Sequence[Recorded], outer: int) -> None:
        """Before a run is resumed after ``outer`` steps: put what it was told until then in force again."""
        for recorded in commands:
            if recorded.outer <= outer and isinstance(recorded.command, LASTING):
                self._do(recorded.command, recorded.outer)
        # What is replayed and was obeyed by then is among these.
        self._replay = [recorded for recorded in self._replay if recorded.outer > outer]

    # -- what each command does ----------------------------------------------------------------------------------

    def _poll(self) -> None:
        for source in self._sources:
            for command in source():
                self.obey(command, "viewer")

    def _do(self, command: Command, outer: int) -> tuple[str, Mapping[str, Any]]:
        """What was done, in words, and more about it; ``outer`` is the step it was asked for after.

        Raises SculptError if it cannot be.
        """
        match command:
            case Pause():
                self._paused = True
                return "paused", {}
            case Resume():
                self._paused = False
                return "going on", {}
            case Stop():
                self._stopping = True
                return "stopping and saving", {}
            case ExportMesh():
                return self._export()
            case _:
                return self._session.reconstructor.obey(command, outer, self._folder), {}

    def _export(self) -> tuple[str, Mapping[str, Any]]:
        with self._session.host.clock.pause():
            mesh = self._session.mesh()
            folder = self._folder / "exports"
            make_folder(folder)
            stem = folder / f"mesh-step-{self._session.step:06d}"
            write_mesh_ply(stem.with_suffix(".ply"), mesh.vertices, mesh.faces, mesh.colors)
            write_mesh_glb(stem.with_suffix(".glb"), mesh.vertices, mesh.faces, mesh.colors)
        return f"mesh written to {stem}.ply and .glb", {"path": str(stem.with_suffix(".ply"))}

    # -- telling -------------------------------------------------------------------------------------------------

    def _snapshot_if_due(self) -> None:
        now = time.monotonic()
        if not self._snapshot_wanted and self._snapshot_seconds is None:
            return
        if now < self._next_snapshot:
            return
        with self._session.host.clock.pause():
            snapshot = self._session.reconstructor.snapshot()
            if snapshot is None:
                return
            self._session.host.tell("snapshot", {"snapshot": snapshot})
        self._snapshot_wanted = False
        cost = time.monotonic() - now
        self._next_snapshot = now + max(self._snapshot_seconds or 0.0, cost / SNAPSHOT_SHARE)
