"""Methods of the paper's tables whose Gaussians are free, in a size that suits a CPU.

Where a number is a paper's, its place is named; "program" is what its authors published: ``arguments/__init__.py`` and
``train.py`` of 3DGS, 2DGS, PGSR and GOF; ``arguments/__init__.py`` and ``script/run_nerf.sh`` of Relightable;
``train.py``, ``sugar_trainers/coarse_sdf.py`` and ``sugar_extractors/coarse_mesh.py`` of SuGaR.
"""

from dataclasses import replace

from sculpt_framework.free_gaussians.config import DensityConfig, GaussianRates
from sculpt_plugins.datasets.auto.config import AutoDatasetConfig
from sculpt_plugins.extractors.marching_tetrahedra.config import MarchingTetrahedraConfig
from sculpt_plugins.methods.gof.config import GofConfig
from sculpt_plugins.methods.pgsr.config import PgsrConfig
from sculpt_plugins.methods.relightable.config import MaterialRates, RelightableConfig
from sculpt_plugins.methods.splatting_2d.config import Splatting2dConfig
from sculpt_plugins.methods.splatting_3d.config import Splatting3dConfig
from sculpt_plugins.methods.sugar.config import PoissonConfig, SugarConfig
from sculpt_plugins.observers.console.config import ConsoleConfig
from sculpt_plugins.observers.recorder.config import RecorderConfig
from sculpt_plugins.rasterizers.auto.config import AutoRasterizerConfig


def splatting_3d() -> Splatting3dConfig:
    """3D Gaussian splatting, a fifteenth of the paper's steps; its mesh is fused from rendered depths."""
    return Splatting3dConfig(
        method="splatting-3d",
        steps=2000,  # 7.2: 30 000
        gaussians=10_000,  # 7.2, without points: 100 000
        sh_degree=3,  # 7.1: four bands
        sh_every=67,  # 7.1: 1000, of fifteen times the steps
        dssim=0.2,  # eq. 7, lambda
        density=DensityConfig(
            every=100,  # 5.2
            gradient=2e-4,  # 5.2, tau_pos
            least_opacity=0.005,  # program; 5.2 calls it epsilon
        ),
        rates=GaussianRates(
            means=1.6e-3,  # program: 1.6e-4; a fifteenth of the steps
            scales=5e-3,  # program
            rotations=1e-3,  # program
            opacities=5e-2,  # program; 0.025 in later versions
            colors=2.5e-3,  # program
        ),
        rasterizer=AutoRasterizerConfig(),
        extractor=MarchingTetrahedraConfig(),
        dataset=AutoDatasetConfig(),
        observers=(ConsoleConfig(), RecorderConfig()),
    )


def splatting_2d() -> Splatting2dConfig:
    """2D Gaussian splatting, a fifteenth of the paper's steps; its mesh is fused from rendered depths. CPU only."""
    like = splatting_3d()
    return Splatting2dConfig(
        method="splatting-2d",
        steps=like.steps,
        gaussians=like.gaussians,
        sh_degree=like.sh_degree,
        sh_every=like.sh_every,
        dssim=like.dssim,
        density=like.density,  # 6.1: as 3DGS, with a least opacity of 0.05
        rates=like.rates,
        distortion=1000.0,  # 5, alpha, of bounded scenes
        distortion_from=0.1,  # program: step 3000 of 30 000
        normals=0.05,  # 5, beta
        normals_from=0.23,  # program: step 7000 of 30 000
        extractor=like.extractor,
        dataset=like.dataset,
        observers=like.observers,
    )


def pgsr() -> PgsrConfig:
    """PGSR, a fifteenth of the paper's steps; its mesh is fused from the planes' depths."""
    like = splatting_3d()
    return PgsrConfig(
        method="pgsr",
        steps=like.steps,
        gaussians=like.gaussians,
        sh_degree=like.sh_degree,
        sh_every=like.sh_every,
        dssim=like.dssim,
        density=like.density,  # V: as AbsGS, which takes gradients by their size; here as 3DGS
        rates=like.rates,
        flatness=100.0,  # IV-D, lambda_1
        planes_from=0.23,  # program: step 7000 of 30 000
        single_view=0.015,  # program; IV-D, lambda_2: 0.01 in one version
        photometric=0.15,  # program; IV-D, lambda_3: 0.2 in one version
        geometric=0.03,  # program; IV-D, lambda_4: 0.05 in one version
        rasterizer=like.rasterizer,
        extractor=like.extractor,
        dataset=like.dataset,
        observers=like.observers,
    )


def relightable() -> RelightableConfig:
    """Relightable 3D Gaussian, a twentieth of its program's steps; its mesh is fused from rendered depths."""
    like = splatting_3d()
    return RelightableConfig(
        method="relightable",
        steps=like.steps,
        gaussians=like.gaussians,
        sh_degree=like.sh_degree,
        sh_every=like.sh_every,
        dssim=like.dssim,
        density=like.density,  # program: until step 10 000 of 40 000, by normals' pull, too
        rates=like.rates,
        normal=0.01,  # program: lambda_normal_render_depth
        spread=0.01,  # program: lambda_depth_var
        mask=0.1,  # program: lambda_mask_entropy
        materials_from=0.75,  # program: step 30 000 of 40 000
        shaded=1.0,  # program: lambda_pbr
        white=0.01,  # program: lambda_light, of the diffuse light at each Gaussian; here of the harmonics
        material_rates=MaterialRates(
            normals=1e-2,  # program
            albedo=1e-2,  # program
            roughness=1e-2,  # program
            visibility=2.5e-3,  # program
            light=1e-2,  # ours; program: 0.1, of a map of 16 x 32 pixels
        ),
        rasterizer=like.rasterizer,
        extractor=like.extractor,
        dataset=like.dataset,
        observers=like.observers,
    )


def sugar() -> SugarConfig:
    """SuGaR, a seventh of the paper's steps; its mesh is the Poisson surface of a level of the density (extra pose)."""
    like = splatting_3d()
    return SugarConfig(
        method="sugar",
        steps=like.steps,  # 5.1: 15 000, before the refinement
        gaussians=like.gaussians,
        sh_degree=like.sh_degree,
        sh_every=133,  # 3DGS: 1000, of seven and a half times the steps
        dssim=like.dssim,
        density=replace(like.density, end=0.47),  # program: until step 7000
        rates=like.rates,
        entropy_from=0.47,  # 5.1: step 7000 of 15 000
        entropy=0.1,  # program
        surface_from=0.6,  # 5.1: step 9000 of 15 000
        clear=0.5,  # 5.1
        distance=0.5,  # program: 2 by the cameras' spread, here of some four object units
        normals=0.2,  # program
        samples=4096,  # program: 1 000 000
        poisson=PoissonConfig(
            level=0.3,  # 5.1, lambda
            points=100_000,  # program: 10 000 000
            depth=7,  # 5.1: 10
        ),
        rasterizer=like.rasterizer,
        extractor=like.extractor,
        dataset=like.dataset,
        observers=like.observers,
    )


def gof() -> GofConfig:
    """Gaussian opacity fields, a fifteenth of the paper's steps; a level of the opacity is the mesh. CPU only."""
    like = splatting_3d()
    return GofConfig(
        method="gof",
        steps=like.steps,  # program: 30 000
        gaussians=like.gaussians,
        sh_degree=like.sh_degree,
        sh_every=like.sh_every,
        dssim=like.dssim,
        # Eq. 15: by the sum of the gradients' lengths in pixels; here as 3DGS. Program: until step 15 000 of 30 000.
        density=replace(like.density, end=0.5, least_opacity=0.05),
        rates=like.rates,
        distortion=100.0,  # program; 1000 for DTU
        distortion_from=0.5,  # program: step 15 000 of 30 000
        normals=0.05,  # program
        normals_from=0.5,  # program: step 15 000 of 30 000
        smoothing=0.2,  # program: scene/gaussian_model.py, as Mip-Splatting
        level=0.5,  # program: extract_mesh.py
        bisections=8,  # program: extract_mesh.py
        mesh_gaussians=30_000,  # program: all
        extractor=like.extractor,
        dataset=like.dataset,
        observers=like.observers,
    )
