"""The contract of a method: what a session needs of whatever turns posed images into a mesh.

A session has the clock, the curve, the best state, checkpoints and events; a ``Reconstructor`` has a shape and learns.
It is built by its config (``MethodConfig.build``), and the session calls it in this order:

    begin                           or load_state, where a saved run is resumed
    settle, (measured,) step        again and again
    settle, (measured,) finish      once; load_state before, where an earlier state was better
    mesh, colors, save              of the result, and of any state between two steps

Everything a method hands out is in world frame.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from sculpt_framework.commands import Command
from sculpt_framework.errors import ConfigError
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.events import EventName
from sculpt_framework.export.drawn_mesh import GREY, draw_mesh_in_colors
from sculpt_framework.geometry.signed_distance import EmptySurfaceError
from sculpt_framework.parallel.processes import Processes
from sculpt_framework.snapshot import Snapshot
from sculpt_framework.types import Camera, Rendering, View


@dataclass(frozen=True, kw_only=True)
class Moment:
    """Where the run stands when a method is asked for something."""

    step: int
    """Steps taken so far."""
    progress: float
    """Share of the run that is done, in [0, 1]: by steps, or by the clock under ``--max-time``."""
    rate: float = 1.0
    """Factor on learning rates; halved each time the session had to go back to an earlier state."""
    last: bool = False
    """No step comes after this: what the method has is brought up to date, nothing new is begun."""


@dataclass(frozen=True, kw_only=True)
class StepReport:
    """What a step did."""

    loss: float
    terms: Mapping[str, float]
    """What the loss is the sum of."""
    faces: int
    facts: Mapping[str, Any] = field(default_factory=dict)
    """What else is told of the step, as JSON values."""
    decisions: Sequence[Mapping[str, Any]] = ()
    """What the method decided in it, each with an "item" and a "value"."""


class Host(ABC):
    """What the session offers the method it hosts."""

    views: Sequence[View]
    """To learn from, in world frame; some of the scene's train views may be held out."""
    processes: Processes
    """Who shares the work (torchrun)."""

    @property
    @abstractmethod
    def timed(self) -> bool:
        """Whether the clock says how long the run takes."""

    @abstractmethod
    def progress(self) -> float:
        """Share of the run that is done by now."""

    @abstractmethod
    def deadline(self, *, share_left: float, seconds_left: float) -> float | None:
        """The ``time.monotonic()`` instant at which so much of the time limit is left; None without a limit."""

    @abstractmethod
    def tell(self, name: EventName, data: Mapping[str, Any]) -> None:
        """An event, as JSON values."""

    @abstractmethod
    def warn(self, message: str) -> None:
        """Of something that went wrong but ends nothing."""

    @abstractmethod
    def show_start(self, make: Callable[[], tuple[Mesh, Mapping[str, Any]] | None]) -> None:
        """Something to start from, as the method comes by it: a row of the curve, if one is due, from what ``make``
        returns: the mesh, and sizes as ``Reconstructor.sizes``; None if it is no surface."""

    @property
    @abstractmethod
    def judged(self) -> bool:
        """Whether there are held-out views to judge by."""

    @abstractmethod
    def judge(self, render: Callable[[Camera], Float[Tensor, "h w 3"]]) -> float:
        """Mean PSNR, in dB, of what ``render`` makes of a few held-out views' cameras, on white. Costs as many
        renderings; the same for all processes, of which the first renders."""


class Reconstructor(ABC):
    """One way from posed images to a mesh. Everything not abstract has a default that suits a method of meshes."""

    begins_with_surface: bool = True
    """Whether what ``begin`` makes is measured. Noise or fog need not be: drawing it takes longer than the rest."""

    @abstractmethod
    def begin(self) -> None:
        """Make the surface that is started from. Raises DataError if the views give none."""

    @abstractmethod
    def step(self, moment: Moment) -> StepReport:
        """Learn. Raises FloatingPointError or EmptySurfaceError where it went wrong: the session goes back then."""

    @abstractmethod
    def mesh(self) -> Mesh:
        """The surface now: closed, outward-oriented, no two vertices at the same place (``geometry.coincident``), world
        frame. May be asked for often."""

    @abstractmethod
    def state(self) -> dict[str, Tensor]:
        """Copies of all that the next step depends on, random generators included."""

    @abstractmethod
    def load_state(self, state: Mapping[str, Tensor]) -> None:
        """Inverse of ``state``. Raises KeyError or RuntimeError where it is not one of this config's."""

    def settle(self, moment: Moment) -> None:
        """Bring up to date what is seen and measured of the state a step begins with. Raises as ``step``."""
        return

    def finish(self) -> None:
        """After the last ``settle``: what is done for the result alone."""
        return

    @property
    def stage(self) -> int:
        """Number of the stretch of the run: a new one's first surface is measured."""
        return 0

    @property
    def stages(self) -> int:
        """How many stretches there are: the best state is chosen among those of the last."""
        return 1

    def colors(self) -> Float[np.ndarray, "v 3"]:
        """Of the vertices of ``mesh``: sRGB in [0, 1]."""
        return np.full((len(self.mesh().vertices), 3), GREY, np.float32)

    def render(self, camera: Camera) -> Rendering:
        """How it looks from a camera in world frame, on white. By default the mesh, in its colours."""
        return draw_mesh_in_colors(self.mesh(), self.colors(), camera)

    def sizes(self) -> Mapping[str, Any]:
        """How much there is of everything, for a row of the curve: "faces", and "inner", "gaussians", "grid" (cells
        along the longest side) where a method has them."""
        return {"faces": len(self.mesh().faces)}

    def about(self) -> Mapping[str, Any]:
        """What is told of the method when a run starts."""
        return {}

    def save(self, folder: Path) -> dict[str, Path]:
        """Files beside the mesh, by kind."""
        return {}

    def snapshot(self) -> Snapshot | None:
        """The state for a viewer, cheap to take; None if there is none to show."""
        try:
            mesh, colors = self.mesh(), torch.from_numpy(self.colors())
        except (EmptySurfaceError, FloatingPointError):
            # A passing state without a surface: a look must not end what the session would recover from.
            return None
        return Snapshot.of_mesh(mesh.vertices, mesh.faces, colors)

    def obey(self, command: Command, step: int, folder: Path) -> str:
        """Do what a person asks for after so many steps, and say what was done; ``folder`` is the run's.

        Raises ConfigError where it cannot be done, and changes nothing then.
        """
        raise ConfigError("this method cannot be told that.")

    def alone(self) -> None:
        """The other processes are done, or gone."""
        return
