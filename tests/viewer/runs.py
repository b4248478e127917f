"""Run directories to look at, made by hand."""

import json
from dataclasses import replace
from pathlib import Path

import torch

from sculpt_framework import registry
from sculpt_framework.geometry.grid import Grid, pack
from sculpt_framework.serialization import config_to_json
from sculpt_framework.snapshot import Cells, Snapshot
from sculpt_framework.types import Box, Gaussians, Surface
from sculpt_framework.viewing.frames import FOLDER, LIVE, step_path, write_frame
from sculpt_plugins.observers.recorder.config import RecorderConfig


def octahedron(size: float = 1.0, opacity: float = 0.99) -> Snapshot:
    vertices = size * torch.tensor([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])
    faces = torch.tensor([[0, 2, 4], [2, 1, 4], [1, 3, 4], [3, 0, 4], [2, 0, 5], [1, 2, 5], [3, 1, 5], [0, 3, 5]])
    shade = torch.linspace(-1, 1, 8)
    colors = torch.stack([shade, -shade, torch.ones(8)], dim=1)[:, None]
    return Snapshot(
        surface=Surface(vertices=vertices, faces=faces, face_keys=torch.arange(8)),
        gaussians=Gaussians(
            means=vertices[faces].mean(dim=1),
            scales=torch.tensor([0.01, 0.2, 0.1]).expand(8, 3).contiguous(),
            rotations=torch.eye(3).expand(8, 3, 3).contiguous(),
            opacities=torch.full((8,), opacity),
            sh=colors,
            face=torch.arange(8),
        ),
        box=Box(minimum=torch.tensor([-1.0, -1.0, 1.0]), maximum=torch.tensor([3.0, 3.0, 5.0])),
        cells=Cells(
            grid=Grid(origin=(-1.0, -1.0, -1.0), base_shape=(4, 4, 4), base_cell=0.5),
            keys=pack(1, torch.tensor([[1, 1, 1], [2, 2, 2]])),
        ),
    )


def line(event: str, outer: int, t_train: float, **data: object) -> str:
    return (
        json.dumps({"v": 1, "t_train": t_train, "t_wall": t_train, "outer": outer, "event": event, "data": data}) + "\n"
    )


def make_run(folder: Path) -> Path:
    """A run of the demo that was at step 20 a moment ago, with two recorded steps and its newest state."""
    config = replace(registry.load_method("gaussian-sculpting-tiny")(), data="demo", observers=(RecorderConfig(),))
    (folder / "config.json").write_text(config_to_json(config), encoding="utf-8")
    (folder / FOLDER).mkdir()
    for outer, size in ((1, 0.4), (10, 0.7)):
        write_frame(step_path(folder, outer), octahedron(size), outer=outer, t_train=outer / 10, whole=False)
    write_frame(folder / FOLDER / LIVE, octahedron(1.0), outer=20, t_train=2.0, whole=True)
    step = {"progress": 0.2, "faces": 8, "gaussians": 8, "psnr": None, "rss_mb": 100.0, "eta_s": 8.0}
    (folder / "events.jsonl").write_text(
        line("run_started", 0, 0.0, scene="shape", method="tiny", box=[[-1, -1, 1], [3, 3, 5]], reference=None)
        + line("stage", 0, 0.0, index=0, count=2, grid=[8, 8, 8])
        + line("decision", 0, 0.0, item="initial surface", value="Sphere", fit_error=0.001)
        + "".join(line("outer_step", outer, outer / 10, loss=1 / outer, **step) for outer in range(1, 21))
        + line("evaluation", 10, 1.0, psnr=20.0, chamfer_ps=0.02, iou=0.9)
        + line("evaluation", 20, 2.0, psnr=21.5, chamfer_ps=0.01, iou=None),
        encoding="utf-8",
    )
    return folder
