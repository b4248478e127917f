"""What a person may tell the bi-level method while it runs: weights, rates, and boxes to treat otherwise."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from sculpt_framework.commands import AddBox, ClearBoxes, Command, SetRate, SetWeight, SwitchConstraint
from sculpt_framework.errors import ConfigError
from sculpt_framework.geometry.octree_policy import RefineBox
from sculpt_framework.sculpting.assembly import Parts, refine_boxes, refine_in
from sculpt_framework.sculpting.boxes import freeze, object_box, read_frozen, write_frozen
from sculpt_framework.sculpting.config import SculptingConfig
from sculpt_framework.sculpting.trainer import Objectives
from sculpt_framework.sculpting.view_gradients import Weighted
from sculpt_framework.types import Box

Term = TypeVar("Term")


class Wishes:
    """What has been asked for so far, on top of what the config says."""

    def __init__(self, parts: Parts, config: SculptingConfig, box: Box):
        self.parts = parts
        self._scene_box = box
        self._objectives = parts.trainer.objectives
        self._weights: dict[tuple[str, str], float] = {}
        self._off: set[str] = set()
        self._configured_boxes = refine_boxes(config, box)
        self._finest = config.trainer.finest_level
        self._boxes: list[RefineBox] = []

    def obey(self, command: Command, step: int, folder: Path) -> str:
        """As ``Reconstructor.obey``."""
        match command:
            case SetWeight():
                return self._set_weight(command)
            case SwitchConstraint():
                return self._switch(command)
            case SetRate():
                return self._set_rate(command)
            case AddBox():
                return self._add_box(command, step, folder)
            case ClearBoxes():
                return self._clear_boxes()
            case _:
                raise ConfigError("this method cannot be told that.")

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
        self.parts.trainer.objectives = reweighted(self._objectives, self._weights, self._off)

    def _set_rate(self, command: SetRate) -> str:
        if command.part == "surface":
            self.parts.trainer.surface_rate = command.factor
        else:
            self.parts.trainer.gaussian_rate = command.factor
        return f"learning rates of the {command.part} times {command.factor:g}"

    def _add_box(self, command: AddBox, step: int, folder: Path) -> str:
        box = object_box("the box", command.minimum, command.maximum, self._scene_box)
        if command.kind == "refine":
            self._refine([*self._boxes, RefineBox(box=box, levels=1)])
        elif command.kind == "freeze":
            self._freeze(box, step, folder)
        else:
            self.parts.trainer.ignored.append(box)
        corners = " ".join(f"{number:.4g}" for number in (*command.minimum, *command.maximum))
        return f"{command.kind} in the box {corners}"

    def _freeze(self, box: Box, step: int, folder: Path) -> None:
        """The values that are kept go to a file: a resumed run must not take later ones."""
        trainer = self.parts.trainer
        path = folder / "checkpoints" / f"frozen-{step:06d}-{len(trainer.frozen)}.safetensors"
        if path.exists():
            trainer.frozen.append(read_frozen(path, box, trainer.field))
        else:
            frozen = freeze(box, trainer.field, self.parts.detail)
            write_frozen(path, frozen)
            trainer.frozen.append(frozen)
        trainer.ignored.append(box)

    def _refine(self, boxes: list[RefineBox]) -> None:
        try:
            self.parts = refine_in(self.parts, [*self._configured_boxes, *boxes], self._finest)
        except ValueError as error:
            raise ConfigError(f"cells cannot be refined: {error}.") from error
        self._boxes = boxes

    def _clear_boxes(self) -> str:
        if self._boxes:
            self._refine([])
        self.parts.trainer.frozen.clear()
        self.parts.trainer.ignored.clear()
        return "boxes taken back"


def term_names(objectives: Objectives) -> dict[str, list[str]]:
    """The names of the terms whose weights can be set, by slot."""
    losses = (*objectives.images, *objectives.geometry, *objectives.views)
    return {
        "losses": [objective.name for objective in losses],
        "constraints": [objective.name for objective in objectives.constraints],
    }


def reweighted(objectives: Objectives, weights: Mapping[tuple[str, str], float], off: set[str]) -> Objectives:
    """The objectives with other weights for terms named by slot and name, and without the constraints in ``off``."""

    def weighed(terms: Sequence[Weighted[Term]]) -> list[Weighted[Term]]:
        return [replace(o, weight=weights.get(("losses", o.name), o.weight)) for o in terms]

    return replace(
        objectives,
        images=weighed(objectives.images),
        silhouettes=weighed(objectives.silhouettes),
        geometry=weighed(objectives.geometry),
        views=weighed(objectives.views),
        constraints=[
            replace(o, weight=weights.get(("constraints", o.name), o.weight))
            for o in objectives.constraints
            if o.name not in off
        ],
    )
