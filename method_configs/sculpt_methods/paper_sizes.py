"""The methods of the paper's tables at the size of their own papers: hours on a GPU, days on a CPU.

Where a number is a paper's, its place is named; "program" is what its authors published, in the file beside it. What is
not named here is as in the method of the same name without ``-paper``, which says where that is from; cells of meshes
and limits are ours.
"""

from dataclasses import replace
from typing import TypeVar

from sculpt_framework.free_gaussians.config import FreeGaussiansConfig
from sculpt_framework.volume_rendering.config import SdfVolumeConfig
from sculpt_methods import guided, splatting, volume_rendered
from sculpt_plugins.fields.mlp.config import MlpFieldConfig
from sculpt_plugins.methods.gaussians_3dgsr.config import Gaussians3dgsrConfig
from sculpt_plugins.methods.gof.config import GofConfig
from sculpt_plugins.methods.gsdf.config import GsdfConfig
from sculpt_plugins.methods.nerf.config import NerfConfig
from sculpt_plugins.methods.neus.config import NeusConfig
from sculpt_plugins.methods.pgsr.config import PgsrConfig
from sculpt_plugins.methods.relightable.config import RelightableConfig
from sculpt_plugins.methods.splatting_2d.config import Splatting2dConfig
from sculpt_plugins.methods.splatting_3d.config import Splatting3dConfig
from sculpt_plugins.methods.sugar.config import SugarConfig
from sculpt_plugins.methods.volsdf.config import VolsdfConfig

_FIELD = MlpFieldConfig(
    # NeuS, program: confs/wmask.conf; all but the skip and the rate also 4.1. VolSDF, program: code/confs/dtu.conf.
    hidden_layers=8,
    hidden_units=256,
    skip_layer=4,
    frequencies=6,
    rate=5e-4,
)
_LENGTH = 30_000  # 3DGS, 7.2; 2DGS, 6.2; PGSR, V; GOF, program: arguments/__init__.py

SdfVolume = TypeVar("SdfVolume", bound=SdfVolumeConfig)
FreeGaussians = TypeVar("FreeGaussians", bound=FreeGaussiansConfig)


def nerf_paper() -> NerfConfig:
    """NeRF at the size of its paper, but on a hash grid; for a GPU."""
    return replace(
        volume_rendered.nerf(),
        method="nerf-paper",
        steps=200_000,  # 5.3: 100 000 to 300 000
        rays=4096,  # 5.3
        steps_across=192,  # 5.3: 64 and 128 samples
        final_rate=0.1,  # 5.3: 5e-4 to 5e-5
    )


def neus_paper() -> NeusConfig:
    """NeuS at the size of its paper; for a GPU."""
    return _with_network(
        replace(
            volume_rendered.neus(),
            method="neus-paper",
            steps=300_000,  # 4.1
            rays=512,  # 4.1
            final_rate=0.05,  # program: confs/wmask.conf
            sharpness=20.0,  # program: confs/wmask.conf, e^3
            sharpness_rate=5e-4,  # program: exp_runner.py, one rate for all
        )
    )


def volsdf_paper() -> VolsdfConfig:
    """VolSDF at the size of its paper; for a GPU."""
    return _with_network(
        replace(
            volume_rendered.volsdf(),
            method="volsdf-paper",
            steps=100_000,  # program: code/training/exp_runner.py, 2000 times each image; DTU has 49 or 64
            final_rate=0.1,  # program: code/training/volsdf_train.py
            beta_rate=5e-4,  # program: the same, one rate for all
        )
    )


def splatting_3d_paper() -> Splatting3dConfig:
    """3D Gaussian splatting at the size of its paper; for a GPU."""
    return _with_length(replace(splatting.splatting_3d(), method="splatting-3d-paper"))


def splatting_2d_paper() -> Splatting2dConfig:
    """2D Gaussian splatting at the size of its paper; days, as it is drawn on the CPU."""
    small = splatting.splatting_2d()
    density = replace(small.density, least_opacity=0.05)  # 6.1
    return _with_length(replace(small, method="splatting-2d-paper", density=density))


def pgsr_paper() -> PgsrConfig:
    """PGSR at the size of its paper; for a GPU."""
    return _with_length(replace(splatting.pgsr(), method="pgsr-paper"))


def gof_paper() -> GofConfig:
    """Gaussian opacity fields at the size of their paper; days, as they are drawn on the CPU."""
    return _with_length(replace(splatting.gof(), method="gof-paper", mesh_gaussians=10_000_000))  # program: all


def sugar_paper() -> SugarConfig:
    """SuGaR at the size of its paper, before its refinement; for a GPU, and with the extra pose."""
    small = splatting.sugar()
    return _with_length(
        replace(
            small,
            method="sugar-paper",
            samples=1_000_000,  # program: sugar_trainers/coarse_sdf.py
            # Program: sugar_extractors/coarse_mesh.py; the depth also 5.1.
            poisson=replace(small.poisson, points=10_000_000, depth=10),
        ),
        steps=15_000,  # 5.1, before the refinement
    )


def relightable_paper() -> RelightableConfig:
    """Relightable 3D Gaussian at the size of its program; for a GPU."""
    small = splatting.relightable()
    density = replace(small.density, end=0.25)  # program: arguments/__init__.py, step 10 000
    return _with_length(
        replace(small, method="relightable-paper", density=density),
        steps=40_000,  # program: script/run_nerf.sh; script/run_dtu.sh: 50 000
    )


def gaussians_3dgsr_paper() -> Gaussians3dgsrConfig:
    """3DGSR at the length of 3DGS (place not checked); for a GPU."""
    long = _with_length(replace(guided.gaussians_3dgsr(), method="3dgsr-paper"))
    return replace(long, density=replace(long.density, reset_every=0))  # opacities follow the field


def gsdf_paper() -> GsdfConfig:
    """GSDF at the size of its paper; for a GPU."""
    small = guided.gsdf()
    return _with_length(
        # Program: configs/dtu.
        replace(small, method="gsdf-paper", guidance=replace(small.guidance, samples=64)),
        steps=45_000,  # 4.1
    )


def _with_network(small: SdfVolume) -> SdfVolume:
    return replace(small, field=_FIELD, mesh_cells=512)


def _with_length(small: FreeGaussians, *, steps: int = _LENGTH) -> FreeGaussians:
    """What the methods of Gaussians take from 3DGS, over so many steps. Their meshes have finer cells."""
    return replace(
        small,
        steps=steps,
        gaussians=100_000,  # 3DGS, 7.2: so many without points
        sh_every=1000,  # 3DGS, 7.1
        density=replace(
            small.density,
            begin=500 / steps,  # 3DGS, program: arguments/__init__.py
            end=min(0.5, small.density.end),  # the same: step 15 000 of 30 000
            most=10_000_000,  # no paper has a limit
            reset_every=3000,  # 3DGS, 5.2
        ),
        # 3DGS, program: the same; 1.6e-4 times the cameras' spread, here of some four object units.
        rates=replace(small.rates, means=6.4e-4),
        mesh_cells=512,
    )
