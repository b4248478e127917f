"""Rules about what photographs say of each other: where the surface starts from, and what it learns from."""

from dataclasses import replace

from sculpt_framework import registry
from sculpt_framework.config import InitializerConfig, LossConfig
from sculpt_framework.plan.evidence import Evidence
from sculpt_framework.plan.options import has_option, option_of, with_options, without
from sculpt_framework.plan.ruling import Ruling
from sculpt_framework.registry import name_of
from sculpt_framework.sculpting.config import SculptingConfig

PHOTOMETRIC, CONSISTENCY, BENDING = "photometric", "consistency", "bending"
CARVED, STEREO, HULL, VOLUME = "photo-hull", "stereo", "visual-hull", "volume-rendering"
SPEAKING_LEAST = 0.02
"""Share of the object that stereo must be able to tell apart: below, depths are found in specks only."""
UNEVEN_COLORS = 0.015
"""Share of its brightness by which a place differs between views from which on colours themselves are no measure of
what belongs together, only how they vary around a place. Clean renders have 0.005 to 0.013, or 0.018 and more where the
hull is far from the surface; photographs have 0.016 and more."""
CUT = 0.5
"""Share of the masks, cut by the borders of their images, from which on carving has too little to go by."""
FAR_APART = 26.0
"""Degrees between a view and the one nearest to it from which on too little of what both show looks alike."""
UNEVEN_LIGHT = 0.024
"""The same share from which on the surface does not learn from colours either: they would move it away from where views
agree."""
AGREEING_VIEWS = 6
"""Views compared with others in a step where the surface learns from nothing else."""
FIRST_STEPS, FOLLOWING_STEPS, OUTLINE_VIEWS = 30, 1, 2
"""There, colours only have to follow the surface, for the viewer and for what is measured, until they are polished; and
Gaussians are rendered for their outline alone."""


def stereo(config: SculptingConfig, evidence: Evidence) -> Ruling:
    measured = {"speaking": evidence.speaking}
    why = _speaking(evidence)
    if name_of(config.initializer) != CARVED:
        return Ruling(config=config, value="as the method starts", evidence=why, measured=measured)
    if evidence.speaking < SPEAKING_LEAST:
        maps = option_of(config.initializer, "maps")
        spared = {"depth maps": float(min(maps or 0, evidence.views))}
        return Ruling(
            config=replace(config, initializer=_start(HULL, config)),
            value="start from the visual hull alone",
            evidence=why,
            measured=measured,
            saves=f"{spared['depth maps']:.0f} depth maps and their fusion",
            spared=spared,
        )
    measured |= {"apart": evidence.apart}
    if evidence.apart > FAR_APART and evidence.masked > 0:
        return Ruling(
            config=replace(config, initializer=_start(VOLUME, config)),
            value="start from volume rendering, not from comparing neighbouring views",
            evidence=f"{why}; the view nearest to a view is {evidence.apart:.0f} degrees away",
            measured=measured,
        )
    if evidence.masked == 0:
        return Ruling(config=config, value="as the method starts", evidence=why, measured=measured)
    measured["cut"] = evidence.cut
    if evidence.gloss is not None:
        measured["unevenness"] = evidence.gloss.unevenness
        why += f"; {differing(evidence.gloss.unevenness)}"
    if evidence.cut >= CUT:
        why += f"; {100 * evidence.cut:.0f} % of the masks are cut by the border"
    elif evidence.gloss is None or evidence.gloss.strength is None:
        # Carving needs many words against one that is wrong.
        why += "; places are seen by fewer than eight views, or over-exposed"
    elif evidence.gloss.unevenness < UNEVEN_COLORS:
        return Ruling(config=config, value="as the method starts", evidence=why, measured=measured)
    return Ruling(
        config=replace(config, initializer=_start(STEREO, config)),
        value="start from normalised correlation, not from equal colours",
        evidence=why,
        measured=measured,
    )


def _start(name: str, config: SculptingConfig) -> InitializerConfig:
    """The initializer of that name, with as many views as the method's own, and as fine as the cells of the grid."""
    start = registry.default("initializer", name)
    assert isinstance(start, InitializerConfig)  # noqa: S101
    views = option_of(config.initializer, "max_views")
    options: dict[str, int] = {}
    if has_option(start, "max_views") and views is not None:
        options["max_views"] = views
    cells, pixels = option_of(start, "cells"), option_of(start, "pixels")
    finest = config.trainer.finest_cells
    if cells and pixels and finest > cells:
        options |= {"cells": finest, "pixels": round(pixels * finest / cells)}
    return replace(start, **options)


def light(config: SculptingConfig, evidence: Evidence) -> Ruling:
    names = [name_of(each) for each in config.losses]
    if CONSISTENCY not in names:
        return Ruling(config=config, value="as the method has it", evidence=f"there is no term of {CONSISTENCY}")
    if evidence.speaking < SPEAKING_LEAST:
        return Ruling(
            config=without(config, "losses", [CONSISTENCY]),
            value="the surface learns from colours alone",
            evidence=_speaking(evidence),
            measured={"speaking": evidence.speaking},
            saves="the comparison of photographs with each other",
            spared={"comparing terms": 1.0},
        )
    if name_of(config.initializer) == VOLUME and evidence.apart > FAR_APART:
        return Ruling(
            config=bent_least(config),
            value="of surfaces that colours and views allow, the least bent",
            evidence=f"the view nearest to a view is {evidence.apart:.0f} degrees away",
            measured={"apart": evidence.apart},
        )
    if evidence.gloss is None:
        why = "how colours change with the view cannot be told"
        return Ruling(config=config, value="as the method has it", evidence=why)
    uneven = evidence.gloss.unevenness
    why = differing(uneven)
    measured = {"unevenness": uneven}
    # Agreement leads no farther than windows overlap: it cannot do without colours from a start that is not near.
    if (uneven < UNEVEN_LIGHT and evidence.cut < CUT) or name_of(config.initializer) != STEREO:
        value = "the surface learns from colours and from agreement between views"
        return Ruling(config=config, value=value, evidence=why, measured=measured)
    return Ruling(
        config=by_agreement(config),
        value="the surface learns from agreement between views, not from colours",
        evidence=why,
        measured=measured,
        saves="the photometric term of the outer loss, and most colour steps",
        spared={"photometric terms": 1.0},
    )


def by_agreement(config: SculptingConfig) -> SculptingConfig:
    """Colours follow the surface instead of teaching it."""
    terms: list[LossConfig] = []
    for each in config.losses:
        if name_of(each) == PHOTOMETRIC:
            terms.append(replace(each, weight=0.0))
        elif name_of(each) == CONSISTENCY and has_option(each, "views"):
            terms.append(replace(each, **{"views": max(AGREEING_VIEWS, option_of(each, "views"))}))
        else:
            terms.append(each)
    stages = tuple(
        replace(
            stage,
            inner_steps=min(stage.inner_steps, FOLLOWING_STEPS),
            outer_views=min(stage.outer_views, OUTLINE_VIEWS),
        )
        for stage in config.trainer.stages
    )
    steps = min(config.trainer.warm_up_steps, FIRST_STEPS)
    decided = bent_least(replace(config, losses=tuple(terms)))
    return with_options(decided, "trainer", stages=stages, warm_up_steps=steps)


def bent_least(config: SculptingConfig) -> SculptingConfig:
    """What says nothing is smoothed."""
    if BENDING in map(name_of, config.losses):
        return config
    term = registry.default("losses", BENDING)
    assert isinstance(term, LossConfig)  # noqa: S101
    return replace(config, losses=(*config.losses, term))


def _speaking(evidence: Evidence) -> str:
    return f"{100 * evidence.speaking:.1f} % of the object can be told apart from its surroundings in brightness"


def differing(uneven: float) -> str:
    return f"places differ by {100 * uneven:.1f} % of their brightness between views"
