"""Look at a scene, decide, and give the config that is trained."""

import time

from sculpt_framework import registry
from sculpt_framework.errors import ComponentImportError, UnknownComponentError
from sculpt_framework.plan.decision import Decision, ScenePlan
from sculpt_framework.plan.evidence import Evidence, gather
from sculpt_framework.plan.options import set_by_hand
from sculpt_framework.plan.rules import RULES
from sculpt_framework.plan.ruling import Rule
from sculpt_framework.sculpting.config import SculptingConfig, of_sculpting
from sculpt_framework.types import Scene
from sculpt_framework.validation import check


def plan_scene(config: SculptingConfig, scene: Scene) -> tuple[SculptingConfig, ScenePlan | None]:
    """The config with what the scene does not need left out, and the decisions.

    The config as it is and None where nothing is to be decided; the scene is not looked at then.
    """
    if not config.plan.items:
        return config, None
    began = time.monotonic()
    evidence = gather(scene)
    decided, decisions, kept = decide(config, evidence, own=_method_of(config))
    check(decided)
    return decided, ScenePlan(decisions=decisions, kept=kept, seconds=time.monotonic() - began)


def decide(
    config: SculptingConfig, evidence: Evidence, *, own: SculptingConfig
) -> tuple[SculptingConfig, list[Decision], list[Decision]]:
    """The decided config, what was changed and what was looked at and kept.

    ``own`` is the method without what the user has set: what differs from it is the user's and is not decided.
    """
    decisions: list[Decision] = []
    kept: list[Decision] = []
    decided = config
    for rule in RULES:
        if rule.item not in config.plan.items:
            continue
        by_hand = set_by_hand(config, own, rule.touches)
        if by_hand is not None:
            kept.append(Decision(item=_dashed(rule), value="as given", evidence=f"{by_hand} was given"))
            continue
        ruling = rule.decide(decided, evidence)
        changes = ruling.config != decided
        (decisions if changes else kept).append(
            Decision(
                item=_dashed(rule),
                value=ruling.value,
                evidence=ruling.evidence,
                measured=ruling.measured,
                saves=ruling.saves,
                spared=ruling.spared,
            )
        )
        decided = ruling.config
    return decided, decisions, kept


def _dashed(rule: Rule) -> str:
    return rule.item.replace("_", "-")


def _method_of(config: SculptingConfig) -> SculptingConfig:
    """The method as its function makes it; the config itself where it was made otherwise."""
    try:
        return of_sculpting(registry.load_method(config.method)())
    except (UnknownComponentError, ComponentImportError):
        return config
