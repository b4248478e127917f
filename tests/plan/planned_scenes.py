"""Demo scenes as the plan sees them, in pictures small enough for a test."""

from dataclasses import replace

import torch

from sculpt_framework import registry
from sculpt_framework.config import MethodConfig
from sculpt_framework.demo_scenes.cameras import demo_cameras
from sculpt_framework.demo_scenes.folder import lit_in
from sculpt_framework.demo_scenes.objects import demo_object
from sculpt_framework.demo_scenes.tracing import render
from sculpt_framework.plan.decision import Decision
from sculpt_framework.plan.evidence import Evidence, gather
from sculpt_framework.plan.make import decide
from sculpt_framework.sculpting.config import PlanConfig
from sculpt_framework.types import Box, Scene, View

SCALE = 0.5
"""Of the pictures' sides and of the grid, so that cells are as many pixels wide as in the scene itself."""


def scene_of(name: str, views: int) -> Scene:
    item = demo_object(name)
    pictures = []
    for index, camera in enumerate(demo_cameras(views, round(SCALE * item.resolution), placement=item.seen_from)):
        rgb, alpha = render(lit_in(item, index), camera)
        pictures.append(
            View(name=f"r_{index}", camera=camera, rgb=torch.from_numpy(rgb), alpha=torch.from_numpy(alpha))
        )
    reach = torch.ones(3, dtype=torch.float64)
    return Scene(name=name, train=tuple(pictures), test=(), box=Box(minimum=-reach, maximum=reach))


def method(name: str = "gaussian-sculpting") -> MethodConfig:
    """With all items of the plan on."""
    return replace(registry.load_method(name)(), plan=PlanConfig(mode="on"))


def decided(evidence: Evidence, config: MethodConfig | None = None) -> tuple[MethodConfig, dict[str, Decision]]:
    """The config after the plan, and what it changed by item."""
    given = method() if config is None else config
    result, decisions, _ = decide(given, evidence, own=method())
    return result, {decision.item: decision for decision in decisions}


def evidence_of(name: str, views: int = 16) -> Evidence:
    """With pixels as wide as in the scene itself."""
    found = gather(scene_of(name, views))
    return replace(
        found,
        pixel_best=SCALE * found.pixel_best,
        pixel_worst=SCALE * found.pixel_worst,
    )
