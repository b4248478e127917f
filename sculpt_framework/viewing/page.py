"""The page's text, plots and list of decisions: what the run has said, brought up to date as it speaks."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import viser

from sculpt_framework.viewing.markdown import code, plain
from sculpt_framework.viewing.run_folder import RunFolder

_POINTS_AT_MOST = 2000
"""Of a plot: more are thinned out."""
_DECISIONS_AT_MOST = 60
_TOLD = ("decision", "action", "warning", "recovered")
_MEASURES = {"chamfer_ps": "Chamfer distance", "psnr": "PSNR of held-out views, dB", "iou": "IoU of silhouettes"}


class Overview:
    """The top of the page and the tabs "Plots" and "Plan"."""

    def __init__(self, server: viser.ViserServer, run: RunFolder):
        self._server, self._run = server, run
        self.text = server.gui.add_markdown("Waiting for the run to start.")
        self._bar = server.gui.add_progress_bar(0.0)
        self._stage: Mapping[str, Any] = {}
        self._step: Mapping[str, Any] = {}
        self._losses: list[tuple[float, float]] = []
        self._evaluations: list[tuple[float, Mapping[str, Any]]] = []
        self._decisions: list[str] = []
        self._plots: dict[str, viser.GuiUplotHandle] = {}
        self._clock = 0.0
        self._paused = False

    def add_tabs(self, tabs: viser.GuiTabGroupHandle) -> None:
        self._plot_tab = tabs.add_tab("Plots")
        with tabs.add_tab("Plan"):
            self.plan = self._server.gui.add_markdown("No decisions yet.")

    def hear(self, events: Sequence[Mapping[str, Any]]) -> None:
        """Take in what the run said since last time."""
        for event in events:
            name, data, seconds = event["event"], event["data"], float(event["t_train"])
            self._clock = seconds
            if name == "run_started":
                self._paused = False
            elif name == "action" and "command" in data:
                self._paused = {"pause": True, "resume": False}.get(data["command"]["do"], self._paused)
            elif name == "stage":
                self._stage = data
            elif name == "outer_step":
                self._step = {**data, "outer": event["outer"]}
                self._losses.append((seconds, data["loss"]))
            elif name == "evaluation":
                self._evaluations.append((seconds, data))
            elif name == "plan":
                self._decisions += [_planned(row) for row in data["decisions"]]
            if name in _TOLD:
                self._decisions.append(f"- {seconds:.1f} s, {name}: {_sentence(data)}")
        if events:
            self._draw_plots()
            shown = self._decisions[-_DECISIONS_AT_MOST:]
            self.plan.content = "\n".join(shown) or "No decisions yet."
        self._tell()

    def _tell(self) -> None:
        run, step = self._run, self._step
        status, started = run.status, run.started
        scene, method = started.get("scene", run.folder.name), started.get("method", run.config.method)
        lines = [f"**{plain(scene)}** by *{plain(method)}*"]
        if self._paused and status in ("running", "silent"):
            lines.append("**Paused.**")
        elif status == "silent" and not run.has_events:
            lines.append("It recorded no events: nothing is known of its steps.")
        elif status == "silent":
            lines.append(f"**No news for {run.silent_seconds:.0f} s: killed, or in a very long step.**")
        elif status == "running":
            lines.append("Running." if self._step else "Starting.")
        else:
            lines.append(f"**{status.capitalize()}.**")
        if self._stage:
            grid = "x".join(map(str, self._stage["grid"]))
            lines.append(f"Stage {self._stage['index'] + 1} of {self._stage['count']}, grid {grid}")
        if step:
            eta = step.get("eta_s")
            left = f", about {eta:.0f} s left" if eta is not None and status == "running" else ""
            lines.append(f"Step {step['outer']}, {self._clock:.0f} s of training{left}")
            # Methods that render a volume have none.
            gaussians = f", {step['gaussians']} Gaussians" if "gaussians" in step else ""
            lines.append(f"{step['faces']} faces{gaussians}, {step['rss_mb']:.0f} MB, loss {step['loss']:.4g}")
            progress = 100.0 if status == "finished" else min(100.0, 100.0 * step["progress"])
            if self._bar.value != progress:
                self._bar.value = progress
        if self._evaluations:
            row = self._evaluations[-1][1]
            known = [f"{name} {row[name]:.4g}" for name in _MEASURES if row.get(name) is not None]
            lines.append("Measured: " + ", ".join(known) if known else "Nothing to measure against.")
        text = "\n\n".join(lines)
        if self.text.content != text:
            self.text.content = text

    def _draw_plots(self) -> None:
        for key, label in _MEASURES.items():
            points = [(seconds, row[key]) for seconds, row in self._evaluations if row.get(key) is not None]
            if len(points) > 1:
                self._plot(key, label, points)
        if len(self._losses) > 1:
            self._plot("loss", "Loss", self._losses)

    def _plot(self, key: str, label: str, points: Sequence[tuple[float, float]]) -> None:
        thin = points[:: -(-len(points) // _POINTS_AT_MOST)]
        data = tuple(np.array(column, dtype=np.float64) for column in zip(*thin, strict=True))
        if key in self._plots:
            self._plots[key].data = data
            return
        with self._plot_tab:
            self._plots[key] = self._server.gui.add_uplot(
                data,
                series=({"label": "s of training"}, {"label": label, "stroke": "#1f6f8b", "width": 2}),
                title=f"{label} against training time",
                scales={"x": {"time": False}},
                aspect=1.6,
            )


def _planned(row: Mapping[str, Any]) -> str:
    """A row of the data of the event "plan"."""
    item, value, evidence = (plain(row[name]) for name in ("item", "value", "evidence"))
    return f"- plan, {item}: {value}; {evidence} ({code(row['override'])} takes it back)"


def _sentence(data: Mapping[str, Any]) -> str:
    if "message" in data:
        return plain(data["message"])
    return plain(", ".join(f"{name} {_short(value)}" for name, value in data.items()))


def _short(value: object) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)
