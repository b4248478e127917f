"""Mesh and splats in the browser, fed from a slot that training only ever overwrites."""

import logging
import socket
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import trimesh
import viser

from sculpt_framework.engine.events import Event
from sculpt_framework.engine.reconstruction import Reconstruction
from sculpt_framework.errors import ConfigError
from sculpt_framework.observers import Observer
from sculpt_framework.rendering.spherical_harmonics import sh_to_rgb
from sculpt_plugins.observers.viser.config import ViserConfig

_log = logging.getLogger("sculpt")
_POLL_SECONDS = 0.5
_LINES: Mapping[str, str] = {"stage": "Stage", "outer_step": "Step", "evaluation": "Measured", "run_ended": "Ended"}


@dataclass(frozen=True, kw_only=True)
class _News:
    """The latest of everything, replaced as a whole."""

    reconstruction: Reconstruction | None
    lines: Mapping[str, str]


class ViserViewer(Observer):
    """Training leaves the newest surface in a slot and goes on; a thread of the viewer's own sends it when it can.

    A slow or vanished browser therefore costs training nothing but the snapshot itself.
    """

    def __init__(self, config: ViserConfig):
        self._config = config
        _check_port_free(config.host, config.port)
        self._server = viser.ViserServer(host=config.host, port=config.port, verbose=False)
        self._server.scene.set_up_direction("+z")
        self._text = self._server.gui.add_markdown("Waiting for the first surface.")
        self._show_mesh = self._server.gui.add_checkbox("Mesh", initial_value=True)
        self._show_splats = self._server.gui.add_checkbox("Gaussians", initial_value=False)
        self._lines: dict[str, str] = {}
        self._news: _News | None = None
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="viser-feed", daemon=True)
        self._thread.start()
        _log.info("viewer at http://%s:%d", config.host, config.port)

    @property
    def snapshot_seconds(self) -> float | None:
        return self._config.seconds

    def notify(self, event: Event) -> None:
        surface = self._news.reconstruction if self._news is not None else None
        if event.event == "snapshot":
            surface = event.data["reconstruction"]
        elif event.event in _LINES:
            self._lines = {**self._lines, _LINES[event.event]: _line(event)}
        self._news = _News(reconstruction=surface, lines=self._lines)

    def close(self) -> None:
        self._ended.set()
        self._thread.join(timeout=5.0)
        self._server.stop()

    def _serve(self) -> None:
        shown: _News | None = None
        while not self._ended.wait(_POLL_SECONDS):
            news = self._news
            if news is None or news is shown:
                continue
            if news.lines:
                self._text.content = "\n\n".join(f"**{name}** {line}" for name, line in news.lines.items())
            if news.reconstruction is not None and (shown is None or news.reconstruction is not shown.reconstruction):
                self._show(news.reconstruction)
            shown = news

    def _show(self, reconstruction: Reconstruction) -> None:
        colors = (255 * np.clip(reconstruction.colors, 0, 1)).astype(np.uint8)
        mesh = trimesh.Trimesh(
            vertices=reconstruction.vertices, faces=reconstruction.faces, vertex_colors=colors, process=False
        )
        gaussians = reconstruction.gaussians
        factor = gaussians.rotations * gaussians.scales[:, None]
        rgb = sh_to_rgb(gaussians.sh, -gaussians.rotations[:, :, 0], torch.zeros(3)).clamp(0, 1)
        with self._server.atomic():
            self._server.scene.add_mesh_trimesh("/mesh", mesh, visible=self._show_mesh.value)
            self._server.scene.add_gaussian_splats(
                "/gaussians",
                centers=gaussians.means.numpy(),
                covariances=(factor @ factor.transpose(1, 2)).numpy(),
                rgbs=rgb.numpy(),
                opacities=gaussians.opacities[:, None].numpy(),
                visible=self._show_splats.value,
            )


def _line(event: Event) -> str:
    data: Mapping[str, Any] = event.data
    if event.event == "stage":
        return f"{data['index'] + 1} of {data['count']}, grid {'x'.join(map(str, data['grid']))}"
    if event.event == "outer_step":
        return f"{event.outer}, loss {data['loss']:.4f}, {data['faces']} faces, {event.t_train:.0f} s"
    if event.event == "evaluation":
        known = {name: data[name] for name in ("psnr", "iou", "chamfer_ps") if data[name] is not None}
        return ", ".join(f"{name} {value:.4g}" for name, value in known.items()) or "nothing to measure against"
    return str(data["status"])


def _check_port_free(host: str, port: int) -> None:
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
        try:
            probe.bind((host, port))
        except OSError as error:
            raise ConfigError(
                f"the viewer cannot listen on {host}:{port} ({error.strerror}); choose another --observers.viser.port"
            ) from error
