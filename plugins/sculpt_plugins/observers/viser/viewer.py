"""Mesh and splats in the browser, fed from a slot that training only ever overwrites."""

import contextlib
import io
import logging
import os
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
from sculpt_framework.export.mesh_files import srgb_to_linear
from sculpt_framework.observers import Observer
from sculpt_framework.rendering.spherical_harmonics import sh_to_rgb
from sculpt_plugins.observers.viser.config import ViserConfig

_log = logging.getLogger("sculpt")
_POLL_SECONDS = 0.2
_LINES: Mapping[str, str] = {"stage": "Stage", "outer_step": "Step", "evaluation": "Measured", "run_ended": "Ended"}


@dataclass(frozen=True, kw_only=True)
class _News:
    """The latest of everything, replaced as a whole."""

    reconstruction: Reconstruction | None
    lines: Mapping[str, str]


class ViserViewer(Observer):
    """Training leaves the newest surface in a slot and goes on; a thread of the viewer's own sends it when it can.

    A slow or vanished browser therefore costs training nothing but the snapshot itself. Raises ConfigError if the
    address cannot be listened on.
    """

    def __init__(self, config: ViserConfig):
        self._config = config
        _check_can_listen(config.host, config.port)
        with _quiet():
            self._server = viser.ViserServer(
                host=config.host, port=config.port, label="Gaussian Sculpting", verbose=False
            )
        self._server.scene.set_up_direction("+z")
        self._text = self._server.gui.add_markdown("Waiting for the first surface.")
        self._show_mesh = self._server.gui.add_checkbox("Mesh", initial_value=True)
        self._show_splats = self._server.gui.add_checkbox("Gaussians", initial_value=False)
        self._show_mesh.on_update(lambda _: self._set_visibility())
        self._show_splats.on_update(lambda _: self._set_visibility())
        # Guards the two handles: checkboxes answer in threads of the server's, and the feed replaces the handles.
        self._handles = threading.Lock()
        self._mesh: viser.GlbHandle | None = None
        self._splats: viser.GaussianSplatHandle | None = None
        self._lines: dict[str, str] = {}
        self._news: _News | None = None
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._feed, name="viser-feed", daemon=True)
        self._thread.start()
        _log.info("viewer at %s", self.address)

    @property
    def address(self) -> str:
        """Where a browser finds the page."""
        host = f"[{self._config.host}]" if ":" in self._config.host else self._config.host
        return f"http://{host}:{self._server.get_port()}"

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
        """What was told last is still sent; then the page goes away."""
        self._ended.set()
        self._thread.join(timeout=5.0)
        with _quiet():
            self._server.stop()

    def _feed(self) -> None:
        shown: _News | None = None
        ended = False
        while not ended:
            ended = self._ended.wait(_POLL_SECONDS)
            news = self._news
            if news is None or news is shown:
                continue
            if news.lines:
                self._text.content = "\n\n".join(f"**{name}** {line}" for name, line in news.lines.items())
            if news.reconstruction is not None and (shown is None or news.reconstruction is not shown.reconstruction):
                self._show(news.reconstruction)
            shown = news

    def _show(self, reconstruction: Reconstruction) -> None:
        if len(reconstruction.faces) == 0:
            return
        # The browser takes vertex colours for linear light, as glTF has them.
        colors = (255 * srgb_to_linear(reconstruction.colors.clip(0, 1)) + 0.5).astype(np.uint8)
        mesh = trimesh.Trimesh(
            vertices=reconstruction.vertices, faces=reconstruction.faces, vertex_colors=colors, process=False
        )
        gaussians = reconstruction.gaussians
        factor = gaussians.rotations * gaussians.scales[:, None]
        rgb = sh_to_rgb(gaussians.sh, -gaussians.rotations[:, :, 0], torch.zeros(3)).clamp(0, 1)
        with self._handles, self._server.atomic():
            first = self._mesh is None
            self._mesh = self._server.scene.add_mesh_trimesh("/mesh", mesh, visible=self._show_mesh.value)
            self._splats = self._server.scene.add_gaussian_splats(
                "/gaussians",
                centers=gaussians.means.numpy(),
                covariances=(factor @ factor.transpose(1, 2)).numpy(),
                rgbs=rgb.numpy(),
                opacities=gaussians.opacities[:, None].numpy(),
                visible=self._show_splats.value,
            )
        if first:
            self._look_at(reconstruction.vertices.min(axis=0), reconstruction.vertices.max(axis=0))

    def _look_at(self, lowest: np.ndarray, highest: np.ndarray) -> None:
        """Let a page that opens see the whole object, from above and aside."""
        center, radius = 0.5 * (lowest + highest), 0.5 * float(np.linalg.norm(highest - lowest))
        view = self._server.initial_camera
        view.look_at = center
        view.position = center + 2.0 * radius * np.array([0.7, -0.6, 0.4])
        view.near, view.far = 0.01 * radius, 100.0 * radius

    def _set_visibility(self) -> None:
        with self._handles:
            if self._mesh is not None and self._splats is not None:
                self._mesh.visible = self._show_mesh.value
                self._splats.visible = self._show_splats.value


def _quiet() -> contextlib.redirect_stdout:
    """The server prints a table when it starts and a line when it stops, and cannot be asked not to."""
    return contextlib.redirect_stdout(io.StringIO())


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


def _check_can_listen(host: str, port: int) -> None:
    """The server itself would go on to the next free port, or wait for ever for an address of another machine."""
    with socket.socket(socket.AF_INET6 if ":" in host else socket.AF_INET) as probe:
        if os.name == "posix":
            # As the server does: a port whose last connection is still winding down is free.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except (OSError, OverflowError) as error:
            reason = error.strerror if isinstance(error, OSError) else error
            raise ConfigError(
                f"the viewer cannot listen on {host}:{port} ({reason}); choose another --observers.viser.port or .host"
            ) from error
