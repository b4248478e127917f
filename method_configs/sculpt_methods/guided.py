"""Methods of Gaussians beside a signed distance field, in a size that suits a CPU.

Where a number is a paper's, its place is named; "program" is what the authors of GSDF published: its
``configs/dtu`` and ``gaussian_splatting/scene/gaussian_model.py``. Neither program nor text of 3DGSR was found.
"""

from sculpt_framework.guided_gaussians.config import AgreementConfig, RaysConfig
from sculpt_methods.splatting import splatting_3d
from sculpt_methods.volume_rendered import neus
from sculpt_plugins.methods.gaussians_3dgsr.config import Gaussians3dgsrConfig
from sculpt_plugins.methods.gsdf.config import GsdfConfig, GuidanceConfig
from sculpt_plugins.methods.neus.config import NeusConfig


def gaussians_3dgsr() -> Gaussians3dgsrConfig:
    """3DGSR: Gaussians as opaque as a field says; its mesh is the field's zero."""
    splats, rays = splatting_3d(), neus()
    return Gaussians3dgsrConfig(
        method="3dgsr",
        steps=splats.steps,
        gaussians=splats.gaussians,
        sh_degree=splats.sh_degree,
        sh_every=splats.sh_every,
        dssim=splats.dssim,
        density=splats.density,
        rates=splats.rates,
        # Beta, learned (place not checked). Its start is ours: wide enough for all Gaussians of the box to be drawn.
        bell=10.0,
        rays=_rays(rays),
        agreement=AgreementConfig(
            depth=0.1,  # ours
            normal=0.01,  # ours
        ),
        field=rays.field,
        rasterizer=splats.rasterizer,
        extractor=splats.extractor,
        dataset=splats.dataset,
        observers=splats.observers,
    )


def gsdf() -> GsdfConfig:
    """GSDF: Gaussians and a field that guide each other; its mesh is the field's zero."""
    splats, rays = splatting_3d(), neus()
    return GsdfConfig(
        method="gsdf",
        steps=splats.steps,
        gaussians=splats.gaussians,
        sh_degree=splats.sh_degree,
        sh_every=splats.sh_every,
        dssim=splats.dssim,
        density=splats.density,
        rates=splats.rates,
        field_from=0.33,  # 4.1: step 15 000 of 45 000
        guidance=GuidanceConfig(
            reach=4.0,  # k, of the first version (place not checked); in 3.2.1 of the second, nested reaches of 3 and 1
            samples=24,  # program: 64
            sigma=0.1,  # A.1.1: a variance of 0.005; program: of objects with half a side of 0.7
            growing=5e-5,  # 3.2.2, omega_g; program: 1.5e-4, of anchors; with it all of ours would be cloned
            pruning=0.1,  # 3.2.2, omega_p; program: 1, of the sum over an anchor's ten Gaussians
        ),
        rays=_rays(rays),
        agreement=AgreementConfig(
            depth=0.01,  # program; A.1.1: 0.5
            normal=0.01,  # A.1.1; program
        ),
        radiance=rays.radiance,
        field=rays.field,
        rasterizer=splats.rasterizer,
        extractor=splats.extractor,
        dataset=splats.dataset,
        observers=splats.observers,
    )


def _rays(like: NeusConfig) -> RaysConfig:
    return RaysConfig(
        number=512,  # ours; GSDF's program: 256 and more, as many as fit
        eikonal_weight=0.1,  # as NeuS, and GSDF, A.1.1
        mask_weight=0.1,  # as NeuS, with masks; GSDF has none
        sharpness=like.sharpness,
        sharpness_rate=like.sharpness_rate,
    )
