"""A client of the viewer's page without a browser: speaks viser's WebSocket protocol, draws nothing."""

import msgspec
import viser
import viser._messages as messages
import zstandard
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol


def connected(address: str, *, origin: str | None = None) -> ClientConnection:
    """A connection to the page at ``address`` (http://...)."""
    return connect(
        address.replace("http", "ws", 1),
        subprotocols=[Subprotocol(f"viser-v{viser.__version__}")],
        origin=None if origin is None else Origin(origin),
        max_size=None,
        compression=None,
    )


def send(client: ClientConnection, message: messages.Message) -> None:
    client.send(msgspec.msgpack.encode(message.as_serializable_dict([])))


def announce(client: ClientConnection) -> None:
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


def received(client: ClientConnection, seconds: float) -> list[dict]:
    """Messages the server sends until it is silent for so long."""
    out: list[dict] = []
    while True:
        try:
            data = client.recv(timeout=seconds)
        except TimeoutError:
            return out
        assert isinstance(data, bytes)
        # Two lengths of 8 bytes, then that much Zstandard; arrays follow.
        packed = zstandard.decompress(data[16 : 16 + int.from_bytes(data[8:16], "little")])
        out += msgspec.msgpack.decode(packed)["messages"]
