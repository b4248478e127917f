"""The default method as it stood before runs planned what to leave out: every option spelled out, nothing decided.

What a planned run is compared with. Not to be changed when defaults change; ``tests/plan/test_everything.py`` holds it.
"""

from sculpt_framework.sculpting.config import SculptingConfig, StageConfig, TrainerConfig
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
from sculpt_plugins.losses.deviation.config import DeviationConfig
from sculpt_plugins.losses.eikonal.config import EikonalConfig
from sculpt_plugins.losses.photometric.config import PhotometricConfig
from sculpt_plugins.losses.sign_change.config import SignChangeConfig
from sculpt_plugins.losses.silhouette.config import SilhouetteConfig
from sculpt_plugins.observers.console.config import ConsoleConfig
from sculpt_plugins.observers.recorder.config import RecorderConfig
from sculpt_plugins.rasterizers.auto.config import AutoRasterizerConfig


def gaussian_sculpting_everything() -> SculptingConfig:
    """The default of version 0.1 with nothing left out for any scene: the yardstick of the scene plan."""
    return SculptingConfig(
        method="gaussian-sculpting-everything",
        steps=160,
        holdout_every=10,
        checkpoint_seconds=60.0,
        field=HashGridFieldConfig(
            num_levels=7,
            log2_table=19,
            base_resolution=4,
            finest_resolution=256,
            sphere_radius=0.5,
            rate=0.004,  # of one number per corner; two that moved alike at 0.002 each were the same field
        ),
        extractor=FlexiCubesConfig(
            split="diagonal",
            learn_weights=True,
            learn_deformation=False,
            damp_grazing=False,
            weight_rate=0.01,
            deformation_rate=0.01,
        ),
        binder=FaceBarycentricConfig(
            gaussians_per_face=1,
            scale=0.6,
            reference="steiner",
            normal_scale=0.001,
            fit_outline=True,
            opacity="fixed",
            theta=0.99,
            barycentric_rate=0.001,
            scale_rate=0.005,
            rotation_rate=0.001,
            opacity_rate=0.05,
        ),
        appearance=ColorFieldConfig(
            sh_degree=0,
            num_levels=5,
            log2_table=19,
            base_resolution=8,
            finest_resolution=128,
            rate=0.01,
            residual_rate=0.0025,
            rest_rate=0.000125,
        ),
        rasterizer=AutoRasterizerConfig(),
        initializer=PhotoHullConfig(
            max_views=100,
            cells=128,
            pixels=96,
            refinements=1,
            maps=50,
            depths=64,
            neighbours=8,
            agreeing=2,
        ),
        dataset=AutoDatasetConfig(
            downscale=None,
        ),
        losses=(
            PhotometricConfig(
                weight=1.0,
                dssim=0.2,
            ),
            SilhouetteConfig(
                weight=1.0,
            ),
            EikonalConfig(
                weight=0.01,
            ),
            SignChangeConfig(
                weight=0.01,
                sharpness=20.0,
            ),
            DeviationConfig(
                weight=0.25,
            ),
        ),
        constraints=(
            MeeScaleConfig(
                weight=1.0,
                form="steiner",
                limit=1.0,
            ),
            BoundaryConfig(
                weight=0.01,
                steepness=10.0,
            ),
            SpacingConfig(
                weight=0.01,
            ),
            CoverageConfig(
                weight=0.01,
                threshold=0.8,
            ),
        ),
        observers=(
            ConsoleConfig(
                line_seconds=10.0,
                live_seconds=0.25,
            ),
            RecorderConfig(
                step_seconds=1.0,
            ),
        ),
        trainer=TrainerConfig(
            stages=(
                StageConfig(
                    share=1.0,
                    level=2,
                    image_scale=1.0,
                    inner_steps=4,
                    outer_views=4,
                    silhouette_only=False,
                ),
            ),
            base_cells=32,
            cell_pixels=None,
            final_rate=0.05,
            gradient_isolation=True,
            warm_start=True,
            bind_every=4,
            sh_degree_every=1000,
            low_pass_px2=0.05,
            random_background=True,
            fit_steps=200,
            warm_up_steps=40,
            ramp_steps=15,
            surface_steps=0.0,
            polish_steps=100,
        ),
    )
