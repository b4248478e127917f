"""Configurations: frozen, keyword-only, free of torch, so that ``--help`` costs no import of it.

A component's config says everything a user may set and builds the component: ``config.build(...)`` imports the code
inside the method. One base class per slot gives the signature of ``build``; the abstract class of what it returns is
in the module named after the slot (``sculpt_framework/fields.py`` and so on).
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from sculpt_framework.ranges import above, at_least

if TYPE_CHECKING:
    import torch

    from sculpt_framework.appearances import Appearance
    from sculpt_framework.backgrounds import Background
    from sculpt_framework.binders import Binder
    from sculpt_framework.constraints import Constraint
    from sculpt_framework.datasets import Dataset
    from sculpt_framework.engine.checkpoint import Saved
    from sculpt_framework.exporters import Exporter
    from sculpt_framework.extractors import Extractor
    from sculpt_framework.fields import Field
    from sculpt_framework.geometry.grid import Grid
    from sculpt_framework.initializers import Initializer
    from sculpt_framework.losses import GeometryLoss, ImageLoss, ViewsLoss
    from sculpt_framework.observers import Observer
    from sculpt_framework.plan.decision import ScenePlan
    from sculpt_framework.rasterizers import Rasterizer
    from sculpt_framework.reconstructor import Host, Reconstructor
    from sculpt_framework.types import Camera, Rendering, Scene


@dataclass(frozen=True, kw_only=True)
class ComponentConfig:
    """Base of every component's config. Ranges of numbers are declared in the fields' types (``ranges.py``)."""

    def check(self, option: str) -> None:
        """Raise ConfigError for values in their ranges that do not go together. ``option`` is the component's own, as
        "field" or "losses.photometric"."""
        return


@dataclass(frozen=True, kw_only=True)
class FieldConfig(ComponentConfig, ABC):
    @abstractmethod
    def build(self, cells: int, device: "torch.device") -> "Field":
        """``cells``: across [-1, 1], of the finest grid that the run samples the field on."""


@dataclass(frozen=True, kw_only=True)
class ExtractorConfig(ComponentConfig, ABC):
    @abstractmethod
    def build(self, grid: "Grid", device: "torch.device") -> "Extractor": ...


@dataclass(frozen=True, kw_only=True)
class BinderConfig(ComponentConfig, ABC):
    @abstractmethod
    def build(self) -> "Binder": ...


@dataclass(frozen=True, kw_only=True)
class AppearanceConfig(ComponentConfig, ABC):
    @abstractmethod
    def build(self, device: "torch.device") -> "Appearance": ...


@dataclass(frozen=True, kw_only=True)
class RasterizerConfig(ComponentConfig, ABC):
    @abstractmethod
    def build(self, device: "torch.device") -> "Rasterizer": ...


@dataclass(frozen=True, kw_only=True)
class BackgroundConfig(ComponentConfig, ABC):
    @abstractmethod
    def build(self, device: "torch.device") -> "Background | None":
        """None: what is around the object is not looked at."""


@dataclass(frozen=True, kw_only=True)
class NoBackgroundConfig(BackgroundConfig):
    """Masks leave out what is around the object; costs nothing."""

    def build(self, device: "torch.device") -> "Background | None":
        return None


@dataclass(frozen=True, kw_only=True)
class LossConfig(ComponentConfig, ABC):
    weight: Annotated[float, at_least(0)]
    """Factor of this term in the outer loss."""

    @abstractmethod
    def build(self) -> "ImageLoss | GeometryLoss | ViewsLoss": ...


@dataclass(frozen=True, kw_only=True)
class ConstraintConfig(ComponentConfig, ABC):
    weight: Annotated[float, at_least(0)]
    """Factor of this term in the inner loss."""

    @abstractmethod
    def build(self) -> "Constraint": ...


@dataclass(frozen=True, kw_only=True)
class InitializerConfig(ComponentConfig, ABC):
    @abstractmethod
    def build(self) -> "Initializer": ...


@dataclass(frozen=True, kw_only=True)
class DatasetConfig(ComponentConfig, ABC):
    @abstractmethod
    def build(self, data: str) -> "Dataset":
        """``data`` is what the user gave as ``--data``."""


@dataclass(frozen=True, kw_only=True)
class ObserverConfig(ComponentConfig, ABC):
    @abstractmethod
    def build(self, run_dir: Path) -> "Observer": ...

    def check_start(self) -> None:
        """Raise SculptError if it cannot be built, as far as is known before anything is read or written."""
        return


@dataclass(frozen=True, kw_only=True)
class ExporterConfig(ComponentConfig, ABC):
    """Of a format of ``sculpt-export``: no part of a run, but chosen by name and registered as parts are."""

    @property
    @abstractmethod
    def file_name(self) -> str:
        """Of the file in the run directory, where the user names none. The run's own are mesh.ply, mesh.glb and
        gaussians.ply."""

    @abstractmethod
    def build(self) -> "Exporter":
        """Raises ConfigError for options that do not go together: nothing has been read or written by then."""


@dataclass(frozen=True, kw_only=True)
class MethodConfig(ABC):
    """What every run has, whatever reconstructs. A method derives its own config, with the slots it uses.

    Method functions return one; the command line edits it; a run directory keeps it as JSON. A field whose type is a
    slot's base class (or a tuple of such) is chosen by name on the command line; a field that is another dataclass
    is a group of options.
    """

    method: str
    """Name the config was made under."""
    data: str = ""
    """Folder of the scene, or demo, or demo:NAME."""
    output: Path | None = None
    """Run directory, empty or new. Default: outputs/SCENE/METHOD/TIME."""
    max_time: Annotated[float | None, above(0, unit="seconds")] = None
    """Wall seconds from the start of the process to the saved mesh. Default: as many steps as the method says."""
    steps: Annotated[int, at_least(1)]
    """Steps without ``--max-time``; with it, time decides."""
    level_gain_db: Annotated[float, at_least(0)] = 0.0
    """Under ``--max-time``, end sooner once twice the time of the last stage gains less on the held-out views, but not
    before ``steps``; 0: take all the time there is."""
    device: Literal["auto", "cpu", "cuda"] = "auto"
    """Where tensors live; auto takes CUDA if there is one."""
    threads: Annotated[int | None, at_least(1)] = None
    """CPU threads. Default: all cores this process may use."""
    seed: Annotated[int, at_least(0, below=2**63)] = 0
    """Seed of every random choice."""
    reference: Path | None = None
    """Mesh in world frame to measure against. Default: gt_mesh.ply in the data folder, if there is one."""
    holdout_every: Annotated[int, at_least(0)] = 10
    """Every so many train views one is held out for choosing the best state; 0: none."""
    checkpoint_seconds: Annotated[float, above(0, unit="seconds")] = 60.0
    """Wall seconds between checkpoints."""
    skip_views: tuple[str, ...] = ()
    """Names of train views to leave out; the scene plan adds those that show nothing new."""
    replay: Path | None = None
    """events.jsonl of an earlier run: what that run was told in its viewer is told again, at the same steps."""
    dataset: DatasetConfig
    observers: tuple[ObserverConfig, ...]

    @abstractmethod
    def build(self, scene: "Scene", host: "Host") -> "Reconstructor":
        """What the session hosts. Raises SculptError for what the user can mend."""

    def check(self) -> None:
        """Raise ConfigError for values in their ranges that do not go together."""
        return

    def short_words(self) -> tuple[str, ...]:
        """Options that make a run of a few steps of it, in which all is compiled and loaded that a whole run needs."""
        return ("--steps", "4")

    def planned(self, scene: "Scene") -> "tuple[MethodConfig, ScenePlan | None]":
        """The config as the scene's data decide it, and the decisions; None where nothing is to be decided."""
        return self, None

    def among(self, processes: int) -> "MethodConfig":
        """The config for one of so many processes (torchrun)."""
        return self

    def check_start(self) -> None:
        """Raise SculptError where a new run cannot be started, as far as is known without the scene."""
        return

    def start(self, scene: "Scene") -> "Saved | None":
        """A state to go on from, where a new run does not begin from nothing."""
        return None

    def renderer(self, folder: Path, scene: "Scene") -> "Callable[[Camera], Rendering]":
        """How a finished run in ``folder`` looks from a camera in world frame, on white: its mesh, in its colours.

        Raises CheckpointError where what it is drawn from, beside the mesh, is not there.
        """
        from sculpt_framework.engine.output import MESH_NAME
        from sculpt_framework.export.drawn_mesh import draw_saved_mesh

        return draw_saved_mesh(folder / MESH_NAME)
