"""Methods of the paper's tables that render a volume along rays, in a size that suits a CPU.

Where a number is a paper's, its place is named; "program" is what its authors published. Learning rates, rays and
steps are ours: those papers train for a hundred thousand steps and more on a GPU. Programs: ``confs/wmask.conf`` of
NeuS, ``code/confs/dtu.conf`` of VolSDF.
"""

from sculpt_framework.volume_rendering.config import RadianceConfig
from sculpt_plugins.datasets.auto.config import AutoDatasetConfig
from sculpt_plugins.extractors.marching_tetrahedra.config import MarchingTetrahedraConfig
from sculpt_plugins.fields.hash_grid.config import HashGridFieldConfig
from sculpt_plugins.methods.nerf.config import NerfConfig
from sculpt_plugins.methods.neus.config import NeusConfig
from sculpt_plugins.methods.volsdf.config import VolsdfConfig
from sculpt_plugins.observers.console.config import ConsoleConfig
from sculpt_plugins.observers.recorder.config import RecorderConfig

_STEPS, _FIELD_RATE = 2000, 8e-3


def nerf() -> NerfConfig:
    """NeRF on a hash grid with occupied cells; its mesh is a threshold of the density."""
    return NerfConfig(
        method="nerf",
        steps=_STEPS,
        mask_weight=0.0,  # it has no such term
        # Density, too, is decoded from this grid.
        radiance=RadianceConfig(rate=5e-2, decoder_rate=5e-3),
        extractor=MarchingTetrahedraConfig(),
        dataset=AutoDatasetConfig(),
        observers=(ConsoleConfig(), RecorderConfig()),
    )


def neus() -> NeusConfig:
    """NeuS on any field; its mesh is the field's zero."""
    return NeusConfig(
        method="neus",
        steps=_STEPS,
        eikonal_weight=0.1,  # program: igr_weight; 3.2, lambda
        mask_weight=0.1,  # program; 3.2, beta, with masks
        sharpness=60.0,  # program: e^3, about 20; ours is not as far from sharp in a hundredth of the steps
        sharpness_rate=3e-3,
        field=HashGridFieldConfig(rate=_FIELD_RATE),
        extractor=MarchingTetrahedraConfig(),
        dataset=AutoDatasetConfig(),
        observers=(ConsoleConfig(), RecorderConfig()),
    )


def volsdf() -> VolsdfConfig:
    """VolSDF on any field; its mesh is the field's zero."""
    return VolsdfConfig(
        method="volsdf",
        steps=_STEPS,
        rays=1024,  # 3.5
        mask_weight=0.0,  # it has no such term
        beta=0.1,  # program
        beta_rate=2e-2,
        eikonal_weight=0.1,  # 3.5, lambda
        field=HashGridFieldConfig(rate=_FIELD_RATE),
        extractor=MarchingTetrahedraConfig(),
        dataset=AutoDatasetConfig(),
        observers=(ConsoleConfig(), RecorderConfig()),
    )
