"""What the pipeline's events carry: plain JSON values from its objects."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any

from sculpt_framework.config import MethodConfig, TrainerConfig
from sculpt_framework.engine.inputs import input_digests
from sculpt_framework.engine.measuring import resident_megabytes
from sculpt_framework.evaluation.certificate import certify
from sculpt_framework.evaluation.mesh import Mesh
from sculpt_framework.geometry.grid import Grid
from sculpt_framework.sculpting.assembly import Parts
from sculpt_framework.sculpting.trainer import BiLevelTrainer, StepReport
from sculpt_framework.types import Scene, Surface


def run_started(
    config: MethodConfig, scene: Scene, parts: Parts, views: int, held_out: int, steps: int | None
) -> dict[str, Any]:
    """``views`` are those that are learned from; ``steps`` is None where time decides."""
    reference = config.reference or scene.reference_mesh
    return {
        "method": config.method,
        "scene": scene.name,
        "notes": list(scene.notes),
        "total_steps": steps,
        "max_time": config.max_time,
        "views": views,
        "held_out": held_out,
        "box": [scene.box.minimum.tolist(), scene.box.maximum.tolist()],
        "device": str(parts.device),
        "rasterizer": type(parts.rasterizer).__name__,
        "seed": config.seed,
        "reference": None if reference is None else str(reference.absolute()),
        "inputs": input_digests(scene, reference),
    }


def initial_surface(config: MethodConfig, fit_error: float) -> dict[str, Any]:
    name = type(config.initializer).__name__.removesuffix("Config")
    return {"item": "initial surface", "value": name, "fit_error": fit_error}


def stage_entered(index: int, trainer: TrainerConfig, grid: Grid) -> dict[str, Any]:
    stage = trainer.stages[index]
    return {
        "index": index,
        "count": len(trainer.stages),
        "level": stage.level,
        "grid": list(grid.shape),
        "image_scale": stage.image_scale,
        "inner_steps": stage.inner_steps,
        "silhouette_only": stage.silhouette_only,
    }


def cut_short(gain: float, factor: float) -> dict[str, Any]:
    """Of a run that ends early: what the later half brought, and the share of its time that it takes now."""
    return {"item": "time", "value": "end early", "gain_db": gain, "run_cut_to": 1 / factor}


def sizes(trainer: BiLevelTrainer, surface: Surface) -> dict[str, Any]:
    """How much there is of everything, for a row of the curve."""
    faces = surface.faces.shape[0]
    return {
        "inner": trainer.inner_total,
        "faces": faces,
        "gaussians": faces * trainer.scene.binder.gaussians_per_face,
        "grid": max(trainer.extractor.grid.shape),
        "rss_mb": resident_megabytes(),
    }


def outer_step(report: StepReport, *, progress: float, psnr: float | None, eta_seconds: float | None) -> dict[str, Any]:
    return {
        "progress": progress,
        "loss": report.loss,
        "terms": report.terms,
        "inner_loss": report.inner_loss,
        "inner_s": report.inner_seconds,
        "faces": report.faces,
        "gaussians": report.gaussians,
        "step_kept": report.step_kept,
        "psnr": psnr,
        "rss_mb": resident_megabytes(),
        "eta_s": eta_seconds,
    }


def run_ended(
    mesh: Mesh, *, status: str, failure: str | None, final: Mapping[str, Any], milestones: Sequence[Mapping[str, Any]]
) -> dict[str, Any]:
    return {
        "status": status,
        "failure": failure,
        "final": dict(final),
        "certificate": asdict(certify(mesh.vertices, mesh.faces, self_intersections=True)),
        "milestones": list(milestones),
    }
