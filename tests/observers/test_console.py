"""What a user reads while a run goes on."""

import io
from pathlib import Path

import pytest
from rich.console import Console

from sculpt_framework.events import Event
from sculpt_plugins.observers.console.config import ConsoleConfig
from sculpt_plugins.observers.console.observer import ConsoleObserver
from sculpt_plugins.observers.console.wording import certificate_text, count, duration, memory, message_text

RUN_DIR = Path("outputs/jar/gaussian-sculpting/now")
CERTIFICATE = {"watertight": True, "outward": True, "boundary_edges": 0, "components": 1, "genus": 0}


def event(name: str, t_wall: float = 1.0, outer: int = 3, **data: object) -> Event:
    return Event(t_train=t_wall, t_wall=t_wall, outer=outer, event=name, data=data)


def step(t_wall: float, **changes: object) -> Event:
    data = {"progress": t_wall / 100, "loss": 0.01234, "psnr": None, "faces": 24_100, "gaussians": 72_300}
    data |= {"rss_mb": 1536.0, "eta_s": 100 - t_wall, **changes}
    return event("outer_step", t_wall, outer=int(t_wall), **data)


def whole_run() -> list[Event]:
    start = {
        "method": "gaussian-sculpting",
        "scene": "jar",
        "notes": ["two images are grey; colours are taken as grey"],
    }
    stage = {"index": 0, "count": 3, "level": 1, "grid": [64, 64, 48], "image_scale": 0.5, "inner_steps": 8}
    end = {"status": "finished", "seconds": 118.2, "final": {"faces": 24_100}, "certificate": CERTIFICATE}
    end |= {kind: str(RUN_DIR / name) for kind, name in {"mesh": "mesh.ply", "curve": "curve.csv"}.items()}
    end["milestones"] = [
        {"share": 0.25, "chamfer_ps": 0.00412, "psnr": 28.1, "iou": 0.99},
        {"share": 1.0, "chamfer_ps": None, "psnr": None, "iou": None},
    ]
    return [
        event("run_started", **start, total_steps=None, max_time=120.0, views=90),
        event("decision", item="initial surface", value="VisualHull", fit_error=0.00123456),
        event("stage", **stage, silhouette_only=True),
        *(step(float(t)) for t in range(1, 60)),
        event("snapshot", reconstruction=object()),
        event("evaluation", 60.0, chamfer_ps=0.00212, psnr=31.234, iou=0.9912, reason="time"),
        event("warning", message="loss is not finite"),
        event("recovered", error="loss is not finite", rate_scale=0.5, attempt=1),
        event("checkpoint", outer=3),
        event("run_ended", 118.0, **end),
    ]


def shown(*events: Event, terminal: bool = False) -> str:
    file = io.StringIO()
    console = Console(file=file, force_terminal=terminal, width=100, highlight=False, markup=False, soft_wrap=True)
    observer = ConsoleObserver(ConsoleConfig(), RUN_DIR, console)
    for each in events:
        observer.notify(each)
    observer.close()
    return file.getvalue()


def test_plain_lines():
    assert shown(*whole_run()).splitlines() == [
        "jar with gaussian-sculpting, 90 views, done within 2:00",
        "note: two images are grey; colours are taken as grey",
        "decided: initial surface: VisualHull (fit error 0.001235)",
        "stage 1/3, grid 64 x 64 x 48, images at 50 %, silhouettes only",
        "  1 %  step 1: loss 0.01234, faces 24.1k, Gaussians 72.3k, memory 1.5 GB, 1:39 left",
        " 11 %  step 11: loss 0.01234, faces 24.1k, Gaussians 72.3k, memory 1.5 GB, 1:29 left",
        " 21 %  step 21: loss 0.01234, faces 24.1k, Gaussians 72.3k, memory 1.5 GB, 1:19 left",
        " 31 %  step 31: loss 0.01234, faces 24.1k, Gaussians 72.3k, memory 1.5 GB, 1:09 left",
        " 41 %  step 41: loss 0.01234, faces 24.1k, Gaussians 72.3k, memory 1.5 GB, 59 s left",
        " 51 %  step 51: loss 0.01234, faces 24.1k, Gaussians 72.3k, memory 1.5 GB, 49 s left",
        "after 1:00 of training: Chamfer 0.00212, PSNR 31.23 dB, mask IoU 0.9912",
        "warning: loss is not finite",
        "recovered: loss is not finite (rate scale 0.5, attempt 1)",
        "finished after 1:58",
        "  mesh      outputs/jar/gaussian-sculpting/now/mesh.ply   24.1k faces, watertight, 1 component, genus 0",
        "  curve     outputs/jar/gaussian-sculpting/now/curve.csv",
        "  error      25 % of the optimisation: Chamfer 0.00412, PSNR 28.10 dB, mask IoU 0.9900",
        "            100 % of the optimisation: not known",
    ]


def test_live_display_shows_the_same_facts_and_restores_the_cursor():
    text = shown(*whole_run(), terminal=True)
    for fact in ("59 %", "step 59", "41 s left", "24.1k", "1.5 GB", "mesh.ply", "25 % of the optimisation"):
        assert fact in text
    assert text.rindex("\x1b[?25h") > text.rindex("\x1b[?25l")


def test_the_display_is_taken_down_when_training_fails():
    text = shown(*whole_run()[:10], terminal=True)
    assert text.rindex("\x1b[?25h") > text.rindex("\x1b[?25l")


def test_brackets_in_names_are_not_markup():
    assert "note: [red]folder[/red] has no test split" in shown(
        event("run_started", method="m", scene="s", notes=["[red]folder[/red] has no test split"], views=1)
    )


def test_a_config_builds_it(tmp_path: Path):
    ConsoleConfig().build(tmp_path).close()


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        (duration(42.4), "42 s"),
        (duration(59.6), "1:00"),
        (duration(3723), "1:02:03"),
        (count(812), "812"),
        (count(1_300_000), "1.3M"),
        (memory(812), "812 MB"),
        (memory(2048), "2.0 GB"),
        (message_text({"item": "grid", "value": 96}), "grid: 96"),
        (message_text({"lost": 3}), "lost 3"),
        (message_text({"message": "views left out", "evidence": None}), "views left out"),
    ],
)
def test_wording(text: str, expected: str):
    assert text == expected


def test_a_mesh_that_merging_opens_is_told():
    open_ = CERTIFICATE | {"watertight_merged": False, "coincident_vertices": 4}
    assert certificate_text(open_) == (
        "watertight, but open where 4 vertices coincide with others, 1 component, genus 0"
    )
