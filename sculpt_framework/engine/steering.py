"""Obeys commands between two outer steps, and tells what it did in "action" events."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from sculpt_framework.commands import (
    LASTING,
    AddBox,
    ClearBoxes,
    Command,
    ExportMesh,
    Pause,
    Recorded,
    Resume,
    SetRate,
    SetWeight,
    Stop,
    SwitchConstraint,
    TakeSnapshot,
    command_to_json,
)
from sculpt_framework.engine.pipeline import Pipeline
from sculpt_framework.errors import ConfigError, SculptError
from sculpt_framework.events import Event, EventName
from sculpt_framework.export.mesh_files import write_mesh_glb, write_mesh_ply
from sculpt_framework.geometry.grid import RefineBox
from sculpt_framework.sculpting.regions import Region, freeze, read_frozen, write_frozen
from sculpt_framework.sculpting.snapshot import take_snapshot
from sculpt_framework.sculpting.trainer import Objectives

_PAUSE_POLL_SECONDS = 0.05
_SNAPSHOT_SHARE = 0.005
"""Of the run's time that snapshots may take, at most: costly ones come less often."""


class Steering:
    """Called before every outer step; says whether the run is to end.

    ``sources`` give commands as they come; ``replay`` those of an earlier run, each due after as many outer steps as it
    was obeyed after then. What is not valid in this run is refused, with an "action" event that says why.
    """

    def __init__(
        self,
        pipeline: Pipeline,
        *,
        emit: Callable[[Event], None],
        folder: Path,
        sources: Sequence[Callable[[], Sequence[Command]]] = (),
        replay: Sequence[Recorded] = (),
        interrupted: Callable[[], bool] = lambda: False,
        snapshot_seconds: float | None = None,
    ):
        self._pipeline = pipeline
        self._trainer = pipeline.parts.trainer
        self._emit_event = emit
        self._folder = folder
        self._sources = sources
        self._replay = list(replay)
        self._interrupted = interrupted
        self._snapshot_seconds = snapshot_seconds
        self._next_snapshot = float("-inf")
        self._snapshot_wanted = False
        self._paused = False
        self._stopping = False
        self._objectives = pipeline.parts.trainer.objectives
        self._weights: dict[tuple[str, str], float] = {}
        self._off: set[str] = set()
        self._configured_boxes = self._boxes_of_config()
        self._boxes: list[RefineBox] = []

    def __call__(self) -> bool:
        while self._replay and self._replay[0].outer <= self._pipeline.outer:
            self.obey(self._replay.pop(0).command, "replay")
        self._poll()
        if self._paused:
            with self._pipeline.clock.pause():
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
            message, facts = self._do(command, self._pipeline.outer)
        except SculptError as error:
            message, facts = f"refused: {error}", {"refused": True}
        self._tell("action", {"message": message, "command": command_to_json(command), "source": source, **facts})

    def take_up(self, commands: Sequence[Recorded], outer: int) -> None:
        """Before a run is gone on with after ``outer`` steps: put what it was told until then in force again."""
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
            case SetWeight():
                return self._set_weight(command), {}
            case SwitchConstraint():
                return self._switch(command), {}
            case SetRate():
                return self._set_rate(command), {}
            case AddBox():
                return self._add_box(command, outer), {}
            case ClearBoxes():
                return self._clear_boxes(), {}
            case ExportMesh():
                return self._export()
            case TakeSnapshot():
                raise ValueError("a snapshot is no action")

    def _set_weight(self, command: SetWeight) -> str:
        names = term_names(self._objectives)[command.slot]
        if command.name not in names:
            raise ConfigError(
                f"this run has no {command.name!r} among its {command.slot}; it has {', '.join(names) or 'none'}."
            )
        self._weights[command.slot, command.name] = command.weight
        self._apply_objectives()
        return f"weight of {command.name} is {command.weight:g}"

    def _switch(self, command: SwitchConstraint) -> str:
        names = term_names(self._objectives)["constraints"]
        if command.name not in names:
            raise ConfigError(f"this run has no constraint {command.name!r}; it has {', '.join(names) or 'none'}.")
        self._off = self._off - {command.name} if command.on else self._off | {command.name}
        self._apply_objectives()
        return f"constraint {command.name} is {'on' if command.on else 'off'}"

    def _apply_objectives(self) -> None:
        self._trainer.objectives = reweighted(self._objectives, self._weights, self._off)

    def _set_rate(self, command: SetRate) -> str:
        if command.part == "surface":
            self._trainer.surface_rate = command.factor
        else:
            self._trainer.gaussian_rate = command.factor
        return f"learning rates of the {command.part} times {command.factor:g}"

    def _add_box(self, command: AddBox, outer: int) -> str:
        box = self._pipeline.scene.box
        low, high = torch.tensor(command.minimum).to(box.minimum), torch.tensor(command.maximum).to(box.minimum)
        if bool((low >= box.maximum).any() | (high <= box.minimum).any()):
            raise ConfigError("the box lies outside the object's box.")
        minimum, maximum = box.to_object(torch.stack([low, high])).float()
        region = Region(minimum=minimum, maximum=maximum)
        if command.kind == "refine":
            (x0, y0, z0), (x1, y1, z1) = minimum.tolist(), maximum.tolist()
            self._refine([*self._boxes, RefineBox(minimum=(x0, y0, z0), maximum=(x1, y1, z1), levels=1)])
        elif command.kind == "freeze":
            self._freeze(region, outer)
        else:
            self._trainer.ignored.append(region)
        corners = " ".join(f"{number:.4g}" for number in (*command.minimum, *command.maximum))
        return f"{command.kind} in the box {corners}"

    def _freeze(self, region: Region, outer: int) -> None:
        """The values that are kept go to a file: a run that is gone on with must not take later ones."""
        path = self._folder / "checkpoints" / f"frozen-{outer:06d}-{len(self._trainer.frozen)}.safetensors"
        if path.exists():
            self._trainer.frozen.append(read_frozen(path, region, self._trainer.field))
        else:
            frozen = freeze(region, self._trainer.field, self._pipeline.parts.detail)
            write_frozen(path, frozen)
            self._trainer.frozen.append(frozen)
        self._trainer.ignored.append(region)

    def _refine(self, boxes: list[RefineBox]) -> None:
        try:
            self._pipeline.refine([*self._configured_boxes, *boxes])
        except ValueError as error:
            raise ConfigError(f"cells cannot be refined: {error}.") from error
        self._boxes = boxes

    def _clear_boxes(self) -> str:
        if self._boxes:
            self._refine([])
        self._trainer.frozen.clear()
        self._trainer.ignored.clear()
        return "boxes taken back"

    def _export(self) -> tuple[str, Mapping[str, Any]]:
        if self._trainer.extraction is None:
            raise ConfigError("there is no surface to export yet.")
        with self._pipeline.clock.pause():
            mesh = self._pipeline.current()
            folder = self._folder / "exports"
            folder.mkdir(exist_ok=True)
            stem = folder / f"mesh-step-{self._pipeline.outer:06d}"
            write_mesh_ply(stem.with_suffix(".ply"), mesh.vertices, mesh.faces, mesh.colors)
            write_mesh_glb(stem.with_suffix(".glb"), mesh.vertices, mesh.faces, mesh.colors)
        return f"mesh written to {stem}.ply and .glb", {"path": str(stem.with_suffix(".ply"))}

    def _boxes_of_config(self) -> list[RefineBox]:
        config, box, out = self._pipeline.config, self._pipeline.scene.box, []
        for given in config.refine_box:
            x, y, z = box.to_object(torch.tensor([given[:3], given[3:]])).double().T.tolist()
            low, high = (x[0], y[0], z[0]), (x[1], y[1], z[1])
            out.append(RefineBox(minimum=low, maximum=high, levels=config.refine_box_levels))
        return out

    # -- telling -------------------------------------------------------------------------------------------------

    def _snapshot_if_due(self) -> None:
        now = time.monotonic()
        if not self._snapshot_wanted and self._snapshot_seconds is None:
            return
        if now < self._next_snapshot:
            return
        with self._pipeline.clock.pause():
            snapshot = take_snapshot(self._trainer, self._pipeline.scene.box)
            if snapshot is None:
                return
            self._tell("snapshot", {"snapshot": snapshot})
        self._snapshot_wanted = False
        cost = time.monotonic() - now
        self._next_snapshot = now + max(self._snapshot_seconds or 0.0, cost / _SNAPSHOT_SHARE)

    def _tell(self, name: EventName, data: Mapping[str, Any]) -> None:
        clock, outer = self._pipeline.clock, self._pipeline.outer
        self._emit_event(
            Event(t_train=clock.train_seconds, t_wall=clock.wall_seconds, outer=outer, event=name, data=data)
        )


def term_names(objectives: Objectives) -> dict[str, list[str]]:
    """The names of the terms whose weights can be set, by slot."""
    losses = (*objectives.images, *objectives.geometry)
    return {
        "losses": [objective.name for objective in losses],
        "constraints": [objective.name for objective in objectives.constraints],
    }


def reweighted(objectives: Objectives, weights: Mapping[tuple[str, str], float], off: set[str]) -> Objectives:
    """The objectives with other weights for terms named by slot and name, and without the constraints in ``off``."""
    return replace(
        objectives,
        images=[replace(o, weight=weights.get(("losses", o.name), o.weight)) for o in objectives.images],
        silhouettes=[replace(o, weight=weights.get(("losses", o.name), o.weight)) for o in objectives.silhouettes],
        geometry=[replace(o, weight=weights.get(("losses", o.name), o.weight)) for o in objectives.geometry],
        constraints=[
            replace(o, weight=weights.get(("constraints", o.name), o.weight))
            for o in objectives.constraints
            if o.name not in off
        ],
    )
