"""What a session's events carry: plain JSON values from its objects."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from sculpt_framework.config import MethodConfig
from sculpt_framework.device import pick_device
from sculpt_framework.engine.inputs import input_digests
from sculpt_framework.engine.milestones import Milestones
from sculpt_framework.evaluation.certificate import certify
from sculpt_framework.memory import peak_megabytes
from sculpt_framework.reconstructor import Reconstructor, StepReport
from sculpt_framework.types import Scene


def run_started(config: MethodConfig, scene: Scene, about: Mapping[str, Any]) -> dict[str, Any]:
    """``about`` is what the method says of itself."""
    reference = config.reference or scene.reference_mesh
    return {
        "method": config.method,
        "scene": scene.name,
        "notes": list(scene.notes),
        "max_time": config.max_time,
        "box": [scene.box.minimum.tolist(), scene.box.maximum.tolist()],
        "device": str(pick_device(config.device)),
        **about,
        "seed": config.seed,
        "reference": None if reference is None else str(reference.absolute()),
        "inputs": input_digests(scene, reference),
    }


def time_is_over(config: MethodConfig) -> str:
    return (
        f"--max-time {config.max_time:g} was over before the start was made; the surface stays as that is, and has "
        "hardly had time for colours. Give it more time, or fewer or smaller images"
    )


def cut_short(gain: float, factor: float) -> dict[str, Any]:
    """Of a run that ends early: what the later half brought, and the share of its time that it takes now."""
    return {"item": "time", "value": "end early", "gain_db": gain, "run_cut_to": 1 / factor}


def step_taken(report: StepReport, *, progress: float, psnr: float | None, eta_seconds: float | None) -> dict[str, Any]:
    return {
        "progress": progress,
        "loss": report.loss,
        "terms": dict(report.terms),
        "faces": report.faces,
        **report.facts,
        "psnr": psnr,
        "rss_mb": peak_megabytes(),
        "eta_s": eta_seconds,
    }


def run_ended(method: Reconstructor, milestones: Milestones, status: str, failure: str | None) -> dict[str, Any]:
    """Of a result that has just been measured: the last row is of it."""
    mesh = method.mesh()
    return {
        "status": status,
        "failure": failure,
        "final": dict(milestones.rows[-1]),
        "certificate": asdict(certify(mesh.vertices, mesh.faces, self_intersections=True)),
        "milestones": milestones.shares(),
    }
