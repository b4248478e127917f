"""A page on which a person chooses the box of a scene: it is drawn into photographs as it is moved."""

import math
import threading

import numpy as np
import viser

from sculpt_framework.posed_images.contact_sheet import with_box
from sculpt_framework.types import Box, Scene
from sculpt_framework.viewing.layers import show_cameras
from sculpt_framework.viewing.movable_box import MovableBox
from sculpt_framework.viewing.server import look_from_aside, start_server, stop_server

_PICTURES = 6
_PICTURE_PIXELS = 420
_FRUSTUM_SHARE = 0.15
"""Of the box's longest half side."""
_POLL_SECONDS = 0.15


class BoxPage:
    """The scene's cameras and its box in the browser, until a person is content with it.

    Photographs are redrawn by whoever calls ``wait``: moves come in faster than pictures can be made.
    """

    def __init__(self, scene: Scene, host: str, port: int):
        self._scene = scene
        self._moved, self._content = threading.Event(), threading.Event()
        self.server: viser.ViserServer = start_server(host, port)
        self.server.scene.set_up_direction("+z")
        gui, count = self.server.gui, len(scene.train)
        low, high = (corner.double().numpy() for corner in (scene.box.minimum, scene.box.maximum))
        gui.add_markdown("Move the box by its arrows until it holds the object in every photograph, and little else.")
        smallest = 1e-4 * float((high - low).max())
        least = (smallest, smallest, smallest)
        x, y, z = np.maximum(high - low, smallest).tolist()
        sides = gui.add_vector3("Sides", (x, y, z), min=least, step=10 * smallest)
        self._words = gui.add_markdown("")
        gui.add_button("Use this box").on_click(lambda _: self._content.set())
        chosen = np.unique(np.linspace(0, count - 1, min(count, _PICTURES)).round().astype(int)).tolist()
        self._shown: list[int] = chosen
        self._view = gui.add_slider("First photograph", min=0, max=max(1, count - 1), step=1, initial_value=chosen[0])
        self._pictures = [gui.add_image(self._drawn(view, scene.box), format="jpeg") for view in chosen]
        for index, frustum in enumerate(show_cameras(self.server.scene, scene.train, _FRUSTUM_SHARE * scene.box.scale)):
            frustum.on_click(lambda _, index=index: self._choose(index))
        self._view.on_update(lambda _: self._choose(int(self._view.value)))
        self._box = MovableBox(self.server.scene, sides, low, high, self._moved.set)
        look_from_aside(self.server, low, high, away=3.0)
        self._words.content = f"`{self.words}`"

    @property
    def port(self) -> int:
        return self.server.get_port()

    @property
    def box(self) -> Box:
        """As it is now, world frame."""
        low, high = self._box.corners
        return Box.between(low, high)

    @property
    def words(self) -> str:
        """The option that gives this box to a run."""
        low, high = self._box.corners
        decimals = max(0, 4 - math.floor(math.log10(max(float((high - low).max()), 1e-300))))
        return f"--dataset.box {' '.join(f'{value:.{decimals}f}' for corner in (low, high) for value in corner)}"

    def wait(self) -> Box:
        """Until a person is content. Returns the box."""
        while not self._content.wait(_POLL_SECONDS):
            if self._moved.is_set():
                self._moved.clear()
                self._draw()
        return self.box

    def close(self) -> None:
        self._content.set()
        stop_server(self.server)

    def _choose(self, index: int) -> None:
        if index < len(self._scene.train):
            self._shown[0] = index
            self._moved.set()

    def _draw(self) -> None:
        box = self.box
        self._words.content = f"`{self.words}`"
        for picture, view in zip(self._pictures, self._shown, strict=True):
            picture.image = self._drawn(view, box)

    def _drawn(self, view: int, box: Box) -> np.ndarray:
        return with_box(self._scene.train[view], box, _PICTURE_PIXELS)
