"""A viser server for this machine alone."""

import asyncio
import contextlib
import io
from urllib.parse import urlsplit

import numpy as np
import viser
import viser._messages as messages
from viser.infra import WebsockClientConnection

from sculpt_framework.viewing.address import is_loopback

TOWARDS_CAMERA = np.array([0.7, -0.6, 0.4])
"""From the middle of things to where a page looks from at first."""
_POLICY_VIOLATION = 1008
"""WebSocket close code (RFC 6455)."""


def start_server(host: str, port: int) -> viser.ViserServer:
    """Listen, without a word on the terminal, without viser's offer to share the page through a server of others.

    Pages of other sites that a browser on this machine shows are refused: a WebSocket to 127.0.0.1 is open to them.
    """
    with quiet():
        server = viser.ViserServer(host=host, port=port, label="Gaussian Sculpting", verbose=False)
    server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="large")
    # viser has no switch for either of these; the tests hold that they go on working.
    web = server._websock_server
    for message in (messages.ShareUrlRequest, messages.ShareUrlDisconnect):
        web.unregister_handler(message)

    @web.on_client_connect
    async def _(client: WebsockClientConnection) -> None:
        connection = web._live_connections[client.client_id]
        request = connection.request
        origin = None if request is None else request.headers.get("Origin")
        if origin is not None and not is_loopback(urlsplit(origin).hostname or ""):
            await connection.close(_POLICY_VIOLATION, "the page of another site may not look in here")
            await asyncio.sleep(0)

    return server


def look_from_aside(server: viser.ViserServer, low: np.ndarray, high: np.ndarray, away: float = 2.4) -> np.ndarray:
    """Let a page that opens see what lies between two corners, from above and aside, so many of its radii ``away``.

    Returns the place that it looks from.
    """
    center, radius = 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))
    position = center + away * radius * TOWARDS_CAMERA
    initial = server.initial_camera
    initial.look_at, initial.position = center, position
    initial.near, initial.far = 0.01 * radius, 100.0 * radius
    return position


def stop_server(server: viser.ViserServer) -> None:
    with quiet():
        server.stop()


def quiet() -> contextlib.redirect_stdout:
    """The server prints a table when it starts and a line when it stops, and cannot be asked not to."""
    return contextlib.redirect_stdout(io.StringIO())
