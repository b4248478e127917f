"""The default method and its variants for tests and first contact."""

from dataclasses import replace

from sculpt_framework.sculpting.config import PlanConfig, SculptingConfig, StageConfig, TrainerConfig
from sculpt_plugins.appearances.color_field.config import ColorFieldConfig
from sculpt_plugins.binders.face_barycentric.config import FaceBarycentricConfig
from sculpt_plugins.constraints.boundary.config import BoundaryConfig
from sculpt_plugins.constraints.coverage.config import CoverageConfig
from sculpt_plugins.constraints.mee_scale.config import MeeScaleConfig
from sculpt_plugins.constraints.spacing.config import SpacingConfig
from sculpt_plugins.datasets.auto.config import AutoDatasetConfig
from sculpt_plugins.extractors.flexicubes.config import FlexiCubesConfig
from sculpt_plugins.fields.hash_grid.config import HashGridFieldConfig
from sculpt_plugins.initializers.photo_hull.config import PhotoHullConfig
from sculpt_plugins.initializers.visual_hull.config import VisualHullConfig
from sculpt_plugins.losses.consistency.config import ConsistencyConfig
from sculpt_plugins.losses.deviation.config import DeviationConfig
from sculpt_plugins.losses.eikonal.config import EikonalConfig
from sculpt_plugins.losses.photometric.config import PhotometricConfig
from sculpt_plugins.losses.sign_change.config import SignChangeConfig
from sculpt_plugins.losses.silhouette.config import SilhouetteConfig
from sculpt_plugins.observers.console.config import ConsoleConfig
from sculpt_plugins.observers.recorder.config import RecorderConfig
from sculpt_plugins.rasterizers.auto.config import AutoRasterizerConfig


def gaussian_sculpting() -> SculptingConfig:
    """The default: hash-grid SDF, FlexiCubes, warm inner loop, from the carved hull; minutes on a CPU."""
    return SculptingConfig(
        method="gaussian-sculpting",
        steps=80,
        level_gain_db=0.3,
        # Fewer colour steps cost more than they spare (docs/background/plan.md).
        plan=PlanConfig(mode="on", inner_steps="off"),
        field=HashGridFieldConfig(),
        extractor=FlexiCubesConfig(damp_grazing=True),
        binder=FaceBarycentricConfig(),
        appearance=ColorFieldConfig(),
        rasterizer=AutoRasterizerConfig(),
        initializer=PhotoHullConfig(),
        dataset=AutoDatasetConfig(),
        losses=(
            PhotometricConfig(),
            SilhouetteConfig(),
            EikonalConfig(),
            SignChangeConfig(),
            DeviationConfig(),
            ConsistencyConfig(),
        ),
        constraints=(MeeScaleConfig(), BoundaryConfig(), SpacingConfig(), CoverageConfig()),
        observers=(ConsoleConfig(), RecorderConfig()),
        trainer=TrainerConfig(
            base_cells=32,
            warm_up_steps=120,
            ramp_steps=15,
            surface_steps=44.0,
            # One stage: what the initializer knows is finer than coarser cells could hold.
            stages=(StageConfig(share=1.0, level=2, image_scale=1.0, inner_steps=4, outer_views=4),),
        ),
    )


def gaussian_sculpting_fine() -> SculptingConfig:
    """The default in cells two thirds as wide: for photographs that show more; about twice the time."""
    base = gaussian_sculpting()
    return replace(base, method="gaussian-sculpting-fine", trainer=replace(base.trainer, base_cells=48))


def gaussian_sculpting_tiny() -> SculptingConfig:
    """A few coarse steps in seconds: for tests and first contact."""
    base = gaussian_sculpting()
    return replace(
        base,
        method="gaussian-sculpting-tiny",
        steps=24,
        plan=PlanConfig(mode="off"),
        initializer=VisualHullConfig(cells=0),
        losses=tuple(each for each in base.losses if not isinstance(each, ConsistencyConfig)),
        trainer=replace(
            base.trainer,
            base_cells=16,
            fit_steps=60,
            warm_up_steps=0,
            ramp_steps=1,
            polish_steps=20,
            stages=(
                StageConfig(share=0.4, level=0, image_scale=0.25, inner_steps=2, outer_views=2),
                StageConfig(share=0.6, level=1, image_scale=0.5, inner_steps=2, outer_views=2),
            ),
        ),
    )
