"""A client of the viewer's page without a browser: speaks viser's WebSocket protocol, draws nothing."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import msgspec
import viser
import viser._messages as messages
import zstandard
from websockets.sync.client import ClientConnection, connect
from websockets.sync.connection import Connection
from websockets.typing import Origin, Subprotocol


def connected(address: str, *, origin: str | None = None) -> ClientConnection:
    """A connection to the page at ``address`` (http://...), as a page of ``origin`` would open it.

    Raises OSError or websockets' InvalidHandshake where there is no such page.
    """
    return connect(
        address.replace("http", "ws", 1),
        subprotocols=[Subprotocol(f"viser-v{viser.__version__}")],
        origin=None if origin is None else Origin(origin),
        max_size=None,
        compression=None,
    )


def send(client: Connection, message: messages.Message) -> None:
    client.send(msgspec.msgpack.encode(message.as_serializable_dict([])))


def announce(client: Connection) -> None:
    """Tell where the camera is; only then does the server count a browser."""
    send(
        client,
        messages.ViewerCameraMessage(
            wxyz=(1.0, 0.0, 0.0, 0.0),
            position=(0.0, 0.0, -3.0),
            fov=1.0,
            near=0.01,
            far=100.0,
            image_height=600,
            image_width=800,
            look_at=(0.0, 0.0, 0.0),
            up_direction=(0.0, 0.0, 1.0),
        ),
    )


def received(client: Connection, seconds: float, *, first: float | None = None) -> list[dict[str, Any]]:
    """Messages the server sends until it is silent for so long; ``first`` is as in ``received_bytes``."""
    return [message for data in received_bytes(client, seconds, first=first) for message in _messages(data)]


def received_bytes(client: Connection, seconds: float, *, first: float | None = None) -> list[bytes]:
    """The same as they come: each with any number of messages, compressed, and their arrays.

    ``first`` is how long to wait for the first of them, else as long as for any.
    """
    out: list[bytes] = []
    while True:
        try:
            data = client.recv(timeout=seconds if out or first is None else first)
        except TimeoutError:
            return out
        out.append(_as_bytes(data))


def find_control(client: Connection, kind: str, label: str, seconds: float = 60.0) -> str:
    """The uuid of the control that is labelled so, once it is shown; ``kind`` is the type of its message, as in
    "GuiButtonMessage".

    Raises TimeoutError if the page shows none by then.
    """
    deadline = time.monotonic() + seconds
    looked_for, shown = None, False
    while (left := deadline - time.monotonic()) > 0:
        try:
            data = client.recv(timeout=left)
        except TimeoutError:
            break
        for message in _messages(_as_bytes(data)):
            if message["type"] == kind and message["props"]["label"] == label:
                looked_for, shown = message["uuid"], message["props"]["visible"]
            elif message["type"] == "GuiUpdateMessage" and message["uuid"] == looked_for:
                shown = message["updates"].get("visible", shown)
            if looked_for is not None and shown:
                return looked_for
    raise TimeoutError(f"the page shows no {kind} labelled {label!r}")


def set_control(client: Connection, uuid: str, value: object) -> None:
    """As if somebody had given the control this value; a button is pressed with True.

    The client has to stay open until that shows: the server may forget what one that closes has just asked for.
    """
    send(client, messages.GuiUpdateMessage(uuid=uuid, updates={"value": value}))


@contextmanager
def given(address: str, kind: str, label: str, value: object) -> Iterator[None]:
    """A browser that has just been opened gives the control of that label this value; it is closed in the end."""
    with connected(address) as client:
        announce(client)
        set_control(client, find_control(client, kind, label), value)
        yield


def _as_bytes(data: str | bytes) -> bytes:
    assert isinstance(data, bytes), "viser sends no text"  # noqa: S101
    return data


def _messages(data: bytes) -> list[dict[str, Any]]:
    # Two lengths of 8 bytes, then that much Zstandard; arrays follow.
    packed = zstandard.decompress(data[16 : 16 + int.from_bytes(data[8:16], "little")])
    return msgspec.msgpack.decode(packed)["messages"]
