"""A package that brings a method and components for every slot, none of which does anything."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from sculpt_framework.config import (
    AppearanceConfig,
    BinderConfig,
    ConstraintConfig,
    DatasetConfig,
    ExtractorConfig,
    FieldConfig,
    InitializerConfig,
    LossConfig,
    ObserverConfig,
    RasterizerConfig,
)
from sculpt_framework.ranges import above, at_least
from sculpt_framework.sculpting.config import SculptingConfig, StageConfig, TrainerConfig


@dataclass(frozen=True, kw_only=True)
class PlainConfig(FieldConfig):
    """A field without frills."""

    radius: float = 0.5
    """Radius of the sphere it starts as, in object units."""

    def build(self, device):
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class FancyConfig(FieldConfig):
    """A field with many settings, one of every type."""

    num_levels: Annotated[int, at_least(1)] = 7
    """Levels of the grid."""
    resolution: tuple[int, int] = (4, 256)
    """Cells across [-1, 1] at the coarsest and the finest level."""
    octaves: tuple[Annotated[float, above(0)], ...] = (1.0, 2.0)
    """Frequencies, per object unit."""
    decoder: Literal["linear", "deep"] = "linear"
    """What reads the grid."""
    weights: Path | None = None
    """File of weights to start from; none: at random."""
    limit: Annotated[float, at_least(0)] | None = None
    """Largest value, in object units; none: no limit."""
    coarse_to_fine: bool = True
    """Wake the levels one after the other."""

    def build(self, device):
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class CubesConfig(ExtractorConfig):
    """Cubes."""

    def build(self, grid, device):
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class GlueConfig(BinderConfig):
    """Glue."""

    gaussians_per_face: int = 3
    """Gaussians on every face."""

    def build(self):
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class PaintConfig(AppearanceConfig):
    """Paint."""

    def build(self, device):
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class DotsConfig(RasterizerConfig):
    """Dots."""

    def build(self, device):
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class BallConfig(InitializerConfig):
    """Ball."""

    def build(self):
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class FolderConfig(DatasetConfig):
    """Folder."""

    def build(self, data):
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class LikenessConfig(LossConfig):
    """How alike image and rendering are."""

    weight: float = 1.0
    """Factor in the outer loss."""
    window: int = 11
    """Side of the window, in pixels."""

    def build(self):
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class OutlineConfig(LossConfig):
    """How far the outlines are apart."""

    weight: float = 0.5
    """Factor in the outer loss."""

    def build(self):
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class TightConfig(ConstraintConfig):
    """Gaussians stay on their face."""

    weight: float = 1.0
    """Factor in the inner loss."""
    form: Literal["paper", "ellipse"] = "ellipse"
    """Which bound."""

    def build(self):
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class EvenConfig(ConstraintConfig):
    """Gaussians spread evenly."""

    weight: float = 0.2
    """Factor in the inner loss."""

    def build(self):
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class DiaryConfig(ObserverConfig):
    """Writes everything down."""

    every: float = 1.0
    """Seconds between lines."""

    def build(self, run_dir):
        raise NotImplementedError


def fake() -> SculptingConfig:
    """A method that cannot train.

    It is there for tests.
    """
    stage = StageConfig(share=1.0, level=0, image_scale=0.5, inner_steps=2, outer_views=1)
    return SculptingConfig(
        method="fake",
        field=PlainConfig(radius=0.25),
        extractor=CubesConfig(),
        binder=GlueConfig(),
        appearance=PaintConfig(),
        rasterizer=DotsConfig(),
        initializer=BallConfig(),
        dataset=FolderConfig(),
        losses=(LikenessConfig(weight=3.0), OutlineConfig()),
        constraints=(TightConfig(),),
        observers=(DiaryConfig(),),
        steps=10,
        trainer=TrainerConfig(stages=(stage, stage), base_cells=16),
    )
