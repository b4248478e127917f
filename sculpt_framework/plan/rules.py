"""From evidence to decisions: one pure function per item.

A rule is given the config as decided so far, and says what it would do and why. It changes options of components by
name, and only where the component has them; whether it may (``--plan.ITEM``, what the user has set) is not its matter.
"""

from collections.abc import Sequence
from dataclasses import replace

from sculpt_framework import registry
from sculpt_framework.config import InitializerConfig
from sculpt_framework.plan.agreement import PHOTOMETRIC, UNEVEN_COLORS, differing, light, stereo
from sculpt_framework.plan.evidence import Evidence
from sculpt_framework.plan.options import option_of, with_options, without
from sculpt_framework.plan.ruling import Rule, Ruling
from sculpt_framework.registry import name_of
from sculpt_framework.sculpting.config import SculptingConfig

HULLS = ("visual-hull", "photo-hull", "stereo")
SILHOUETTE, NO_MASKS = "silhouette", "sphere"
BETWEEN_GAUSSIANS = ("spacing", "coverage")
"""Constraints that are constant where a face has one Gaussian."""
ON_PLACES = ("mee-scale", "boundary", *BETWEEN_GAUSSIANS)
"""Constraints that act on nothing but where Gaussians lie on their faces and how large they are."""

CELL_PIXELS_LEAST = 1.0
"""A cell narrower than a pixel is more than the images can tell."""
CELL_PIXELS_MOST, CELL_PIXELS_AIM = 4.0, 2.0
"""Images in which a cell is wider than the first are reduced until it is as wide as the second."""
THIN_CELLS = 3.0
"""Cells that the thinnest part must keep across when the finest level is left out."""
THIN_HELD, THIN_LEAST = 2.0, 1.25
"""Cells that a thin part must have across to be held safely, and to be held at all."""
FINER_MOST = 1.375
"""Times that cells are made narrower at most for a thin part: faces and seconds grow with the square."""
FINER_SECONDS = 300.0
"""A run that must end earlier has no time for them."""
UNEVEN = 2.0
"""Ratio of pixel widths on the object from which larger cells, where the images show less, are worth their trouble."""
GLOSS_LEAST, GLOSS_MUCH = 0.05, 0.1
FINE_TEXTURE = 0.02
"""Root mean square of brightness, in [0, 1], below which texture is not worth a Gaussian or a step of its own."""
PLAIN_TEXTURE = 0.004
GAUSSIAN_PIXELS = 2.5
"""Area in pixels that a Gaussian needs to have a colour of its own."""
GAUSSIANS_MOST = 4
PLACE_PIXELS = 2.5
"""Width of a face, in pixels, from which the images can tell where on it a Gaussian lies."""
FACE_SHARE = 0.7
"""Width of a face as a share of its cell's: two triangles for a square."""
REST_AFTER = 20
POLISH_GAIN_DB = 0.02
POLISH_OF_VIEWS, POLISH_FRESH, POLISH_RATE = 3, (60, 200), 3.0
"""Where colours have only followed the surface: steps for each view, how many at least and at most, and the rate that
they begin with."""
ACTIVE_EVERY = 60
SHADED_DEGREE, SHADED_EVERY, SHADED_RATE = 3, 20, 5e-3
"""Of colours under light that turns relative to the object: degree, steps until the next is active, rate of all but the
mean. Shade is as large as colour there, where a highlight is a little on top of it."""


def silhouette(config: SculptingConfig, evidence: Evidence) -> Ruling:
    measured = {"masked": float(evidence.masked), "views": float(evidence.views)}
    if evidence.masked:
        why = f"{evidence.masked} of {evidence.views} views have an alpha"
        return Ruling(config=config, value="used", evidence=why, measured=measured)
    decided = without(config, "losses", [SILHOUETTE])
    value, saves = "no silhouette loss", "the loss"
    if name_of(config.initializer) in HULLS:
        start = registry.default("initializer", NO_MASKS)
        assert isinstance(start, InitializerConfig)  # noqa: S101
        decided = replace(decided, initializer=start)
        value, saves = f"no silhouette loss; start from a {NO_MASKS} in the cameras' box", "the loss and the hull"
    why = f"0 of {evidence.views} views have an alpha, and no constant background was found to make one"
    return Ruling(config=decided, value=value, evidence=why, measured=measured, saves=saves)


def views(config: SculptingConfig, evidence: Evidence) -> Ruling:
    dropped = (*evidence.blind, *(name for name, _ in evidence.repeated))
    measured = {"blind": float(len(evidence.blind)), "repeated": float(len(evidence.repeated))}
    why = f"of {evidence.views} views {len(evidence.blind)} show nothing, {len(evidence.repeated)} repeat another"
    # What is left must still be a scene.
    if not dropped or evidence.views - len(dropped) < 2:
        return Ruling(config=config, value="all", evidence=why, measured=measured)
    megabytes = len(dropped) * evidence.view_megabytes
    return Ruling(
        config=replace(config, skip_views=dropped),
        value=f"{evidence.views - len(dropped)} of {evidence.views}",
        evidence=why,
        measured=measured,
        saves=f"{megabytes:.0f} MB of images",
        spared={"megabytes": megabytes},
    )


def level(config: SculptingConfig, evidence: Evidence) -> Ruling:
    pixels = cell_pixels(config, evidence)
    measured = {"cell_pixels": pixels}
    why = f"the smallest cells are {pixels:.2f} pixels wide in the views that show most"
    finest, drop = config.trainer.finest_level, 0
    while drop < finest and pixels * 2**drop < CELL_PIXELS_LEAST:
        wide = pixels * 2 ** (drop + 1)
        if evidence.thinnest is not None and evidence.thinnest < THIN_CELLS * wide:
            why += f"; a part is about {evidence.thinnest} pixels thin and keeps level {finest - drop}"
            measured["thinnest"] = float(evidence.thinnest)
            break
        drop += 1
    if drop == 0:
        kept = Ruling(config=config, value=f"level {finest}", evidence=why, measured=measured)
        return _as_fine_as_thin(config, evidence.thinnest, kept)
    stages = tuple(replace(stage, level=min(stage.level, finest - drop)) for stage in config.trainer.stages)
    share = 100 * (1 - 0.25**drop)
    return Ruling(
        config=with_options(config, "trainer", stages=stages),
        value=f"level {finest - drop} at the finest, not {finest}",
        evidence=why,
        measured=measured,
        saves=f"about {share:.0f} % of cells, faces and Gaussians",
        spared={"share of faces": 0.01 * share},
    )


def _as_fine_as_thin(config: SculptingConfig, thinnest: int | None, kept: Ruling) -> Ruling:
    """``kept``, or narrower cells where they hold a part that these do not."""
    pixels = kept.measured["cell_pixels"]
    if thinnest is None or thinnest >= THIN_HELD * pixels:
        return kept
    measured = {**kept.measured, "thinnest": float(thinnest)}
    why = f"{kept.evidence}; a part is about {thinnest} pixels thin"
    finer = min(FINER_MOST, THIN_HELD * pixels / thinnest, pixels / CELL_PIXELS_LEAST)
    if finer <= 1 or finer * thinnest < THIN_LEAST * pixels:
        why += ", too thin for cells that can be afforded"
    elif config.max_time is not None and config.max_time < FINER_SECONDS:
        why += f", for which {config.max_time:g} s are too short"
    else:
        return replace(
            kept,
            config=with_options(config, "trainer", base_cells=round(finer * config.trainer.base_cells)),
            value=f"cells {finer:.2g} times narrower",
            evidence=why,
            measured=measured,
        )
    return replace(kept, evidence=why, measured=measured)


def images(config: SculptingConfig, evidence: Evidence) -> Ruling:
    pixels = cell_pixels(config, evidence)
    why = f"the smallest cells are {pixels:.2f} pixels wide in the views that show most"
    measured = {"cell_pixels": pixels}
    lost = evidence.finer_than(pixels / CELL_PIXELS_AIM)
    if pixels > CELL_PIXELS_MOST:
        why += f"; reduced to {CELL_PIXELS_AIM:g}, they would lose texture of a contrast of {lost:.3f}"
        measured["contrast"] = lost
    if pixels <= CELL_PIXELS_MOST or lost >= FINE_TEXTURE:
        value = f"cropped to the object, {100 * config.trainer.stages[-1].image_scale:.0f} %"
        return Ruling(config=config, value=value, evidence=why, measured=measured)
    factor = CELL_PIXELS_AIM / pixels
    stages = tuple(
        replace(stage, image_scale=max(min(stage.image_scale, 0.05), stage.image_scale * factor))
        for stage in config.trainer.stages
    )
    share = 1 - factor * factor
    return Ruling(
        config=with_options(config, "trainer", stages=stages),
        value=f"cropped to the object, {100 * stages[-1].image_scale:.0f} %",
        evidence=why,
        measured=measured,
        saves=f"{100 * share:.0f} % of the pixels",
        spared={"megabytes": share * 0.5 * evidence.view_megabytes * evidence.views},
    )


def refinement(config: SculptingConfig, evidence: Evidence) -> Ruling:
    ratio = evidence.pixel_worst / evidence.pixel_best
    why = f"pixels on the object differ in width by {ratio:.2f}"
    measured = {"ratio": ratio}
    if ratio < UNEVEN or config.trainer.cell_pixels is not None:
        return Ruling(config=config, value="cells of one size", evidence=why, measured=measured)
    return Ruling(
        config=with_options(config, "trainer", cell_pixels=CELL_PIXELS_LEAST),
        value=f"no cell narrower than {CELL_PIXELS_LEAST:g} pixel of the view that shows it best",
        evidence=why,
        measured=measured,
        saves="small cells where no view is near",
    )


def sh_degree(config: SculptingConfig, evidence: Evidence) -> Ruling:
    degree = option_of(config.appearance, "sh_degree")
    if evidence.gloss is None or evidence.gloss.strength is None or degree is None:
        why = "how colours change with the view cannot be told: no masks, or too few views"
        return Ruling(config=config, value="as the method has it", evidence=why)
    strength = evidence.gloss.strength
    wanted = 0 if strength < GLOSS_LEAST else 2 if strength < GLOSS_MUCH else 3
    why = f"places brighten by {strength:.3f} more than they darken in a tenth of the views"
    measured = {"gloss": strength, "points": float(evidence.gloss.points)}
    rate, every, decided = option_of(config.appearance, "rest_rate"), ACTIVE_EVERY, config
    if rate is not None and evidence.gloss.unevenness >= UNEVEN_COLORS:
        wanted, every = SHADED_DEGREE, SHADED_EVERY
        why += f"; {differing(evidence.gloss.unevenness)}"
        measured["unevenness"] = evidence.gloss.unevenness
        decided = with_options(config, "appearance", rest_rate=max(rate, SHADED_RATE))
    elif wanted == degree:
        return Ruling(config=config, value=f"degree {degree}", evidence=why, measured=measured)
    decided = with_options(decided, "appearance", sh_degree=wanted)
    if wanted > 0:
        # A run is shorter than 3DGS': each degree must have its time.
        decided = with_options(decided, "trainer", sh_degree_every=min(config.trainer.sh_degree_every, every))
    fewer = (degree + 1) ** 2 - (wanted + 1) ** 2
    saves = f"{3 * fewer} of {3 * (degree + 1) ** 2} colour numbers per Gaussian" if fewer > 0 else None
    value = f"degree {wanted}, not {degree}" if wanted != degree else f"degree {degree}, learned faster"
    return Ruling(config=decided, value=value, evidence=why, measured=measured, saves=saves)


def gaussians(config: SculptingConfig, evidence: Evidence) -> Ruling:
    count = option_of(config.binder, "gaussians_per_face")
    face = FACE_SHARE * cell_pixels(config, evidence)
    fine, area = evidence.finer_than(face), face * face
    why = f"texture finer than a face ({face:.1f} pixels) has a contrast of {fine:.3f}"
    measured = {"face_pixels": face, "contrast": fine}
    wanted = 1 if fine < FINE_TEXTURE else max(1, min(GAUSSIANS_MOST, round(area / GAUSSIAN_PIXELS)))
    polished = 1
    if not _colors_teach(config):
        wanted, polished = 1, wanted if config.trainer.polish_steps else 1
        why += ", but the surface does not learn from colours"
    if count is None or (count == wanted and polished == 1):
        return Ruling(config=config, value=f"K = {count}", evidence=why, measured=measured)
    decided, value = config, f"K = {wanted}"
    saves = f"{count - wanted} of {count} Gaussians on each face" if wanted < count else None
    if count != wanted:
        decided, value = with_options(decided, "binder", gaussians_per_face=wanted), f"{value}, not {count}"
    if polished > 1:
        decided = with_options(decided, "trainer", polish_gaussians=polished)
        value = f"{value}, and {polished} while colours are polished"
        saves = f"{polished - 1} of {polished} Gaussians until then"
    return Ruling(config=decided, value=value, evidence=why, measured=measured, saves=saves)


def places(config: SculptingConfig, evidence: Evidence) -> Ruling:
    learned, count = option_of(config.binder, "places"), option_of(config.binder, "gaussians_per_face")
    face = FACE_SHARE * cell_pixels(config, evidence)
    why = f"a face is {face:.1f} pixels wide, and has {count} Gaussian{'' if count == 1 else 's'}"
    measured = {"face_pixels": face}
    fixed = learned == "learned" and count == 1 and face < PLACE_PIXELS and config.trainer.gradient_isolation
    if not fixed or option_of(config.binder, "opacity") == "learnable":
        return Ruling(config=config, value=str(learned), evidence=why, measured=measured)
    decided = with_options(config, "binder", places="fixed")
    decided = without(decided, "constraints", ON_PLACES)
    return Ruling(
        config=decided,
        value="Gaussians stay where their faces put them",
        evidence=why,
        measured=measured,
        saves="their rows and optimiser state, a binding a step, the constraints on them",
        spared={"binds per outer step": _inner_binds(config)},
    )


def constraints(config: SculptingConfig, evidence: Evidence) -> Ruling:
    names = [name_of(each) for each in config.constraints]
    idle = [name for name in names if name in BETWEEN_GAUSSIANS]
    count = option_of(config.binder, "gaussians_per_face")
    decided = config
    if count == 1 and idle:
        decided = without(decided, "constraints", idle)
    if decided.constraints and config.trainer.rest_after == 0:
        decided = with_options(decided, "trainer", rest_after=REST_AFTER)
    why = f"a face has {count} Gaussian{'' if count == 1 else 's'}"
    left = ", ".join(name_of(each) for each in decided.constraints) or "none"
    if decided == config:
        return Ruling(config=config, value=left, evidence=why, measured={})
    out = f"{', '.join(idle)}, which are constant" if count == 1 and idle else None
    value = f"{left}, each until it has done nothing {REST_AFTER} times" if decided.constraints else left
    return Ruling(config=decided, value=value, evidence=why, measured={"count": float(count or 0)}, saves=out)


def inner_steps(config: SculptingConfig, evidence: Evidence) -> Ruling:
    cell = cell_pixels(config, evidence)
    fine = evidence.finer_than(cell)
    why = f"texture finer than a cell ({cell:.1f} pixels) has a contrast of {fine:.3f}"
    measured = {"cell_pixels": cell, "contrast": fine}
    factor = 1.0 if fine >= 2 * FINE_TEXTURE else 0.5 if fine >= PLAIN_TEXTURE else 0.25
    trainer = config.trainer
    stages = tuple(
        replace(stage, inner_steps=max(1, round(factor * stage.inner_steps))) if stage.inner_steps else stage
        for stage in trainer.stages
    )
    before, after = trainer.stages[-1].inner_steps, stages[-1].inner_steps
    if stages == trainer.stages or not trainer.warm_start or not trainer.gradient_isolation:
        return Ruling(config=config, value=f"{before} a step", evidence=why, measured=measured)
    return Ruling(
        config=with_options(config, "trainer", stages=stages),
        value=f"{after} a step, not {before}",
        evidence=why,
        measured=measured,
        saves=f"{before - after} of {before} colour steps",
        spared={"inner steps per outer step": float(before - after)},
    )


def polish(config: SculptingConfig, evidence: Evidence) -> Ruling:
    trainer = config.trainer
    why = f"{evidence.views} views; the run has yet to show how long colours improve"
    if trainer.polish_steps == 0 or trainer.polish_gain_db > 0 or config.holdout_every == 0:
        return Ruling(config=config, value=f"{trainer.polish_steps} steps", evidence=why)
    if not _colors_teach(config):
        least, most = POLISH_FRESH
        steps = min(most, max(least, POLISH_OF_VIEWS * evidence.views))
        why = f"{evidence.views} views; until then colours only follow the surface"
        decided = with_options(config, "trainer", polish_steps=steps, polish_rate=POLISH_RATE)
        value = f"{steps} steps, at first at {POLISH_RATE:g} times the rates"
        return Ruling(config=decided, value=value, evidence=why)
    return Ruling(
        config=with_options(config, "trainer", polish_gain_db=POLISH_GAIN_DB),
        value=f"at most {trainer.polish_steps} steps, until the last twenty gain less than {POLISH_GAIN_DB} dB",
        evidence=why,
        measured={"gain_db": POLISH_GAIN_DB},
        saves="the steps after that",
    )


def _colors_teach(config: SculptingConfig) -> bool:
    """Whether the surface learns from colours."""
    return any(name_of(each) == PHOTOMETRIC and each.weight > 0 for each in config.losses)


def cell_pixels(config: SculptingConfig, evidence: Evidence) -> float:
    """Width of the smallest cells in the images of the last stage, in pixels of the views that show most."""
    last = max(config.trainer.stages, key=lambda stage: stage.level)
    cell = 2.0 / config.trainer.finest_cells
    return cell / (evidence.pixel_best / last.image_scale)


def _inner_binds(config: SculptingConfig) -> float:
    """Bindings of one outer step, of steps that learn places and between them, beside the one there is anyway."""
    learning = -(-config.trainer.stages[-1].inner_steps // config.trainer.bind_every)
    return float(learning if config.trainer.bind_every == 1 else 2 * learning - 1)


STAGES = "trainer.stages"
RULES: Sequence[Rule] = (
    Rule(item="silhouette", touches=("losses", "initializer"), decide=silhouette),
    # Before the start is chosen, which is as fine as the cells.
    Rule(item="level", touches=(STAGES, "trainer.base_cells"), decide=level),
    Rule(item="stereo", touches=("initializer",), decide=stereo),
    Rule(item="light", touches=("losses", STAGES, "trainer.warm_up_steps"), decide=light),
    Rule(item="views", touches=("skip_views",), decide=views),
    Rule(item="images", touches=(STAGES,), decide=images),
    Rule(item="refinement", touches=("trainer.cell_pixels", "refine_box"), decide=refinement),
    Rule(
        item="sh_degree",
        touches=("appearance.sh_degree", "appearance.rest_rate", "trainer.sh_degree_every"),
        decide=sh_degree,
    ),
    Rule(
        item="gaussians", touches=("binder", "binder.gaussians_per_face", "trainer.polish_gaussians"), decide=gaussians
    ),
    Rule(item="places", touches=("binder", "binder.places", "constraints"), decide=places),
    Rule(item="constraints", touches=("constraints", "trainer.rest_after"), decide=constraints),
    Rule(item="inner_steps", touches=(STAGES,), decide=inner_steps),
    Rule(
        item="polish", touches=("trainer.polish_steps", "trainer.polish_rate", "trainer.polish_gain_db"), decide=polish
    ),
)
