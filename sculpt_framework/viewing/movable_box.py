"""A box in the scene that a person moves by its arrows and sizes by numbers."""

from collections.abc import Callable

import numpy as np
import viser
from jaxtyping import Float

from sculpt_framework.viewing.layers import show_box

_COLOR = np.array([230, 60, 120], dtype=np.uint8)


class MovableBox:
    """``sides`` is the control for the lengths along the axes; ``changed`` is called, from a thread of the server,
    after each move."""

    def __init__(
        self,
        scene: viser.SceneApi,
        sides: viser.GuiVector3Handle,
        low: Float[np.ndarray, " 3"],
        high: Float[np.ndarray, " 3"],
        changed: Callable[[], None] = lambda: None,
    ):
        self._sides, self._changed = sides, changed
        x, y, z = (high - low).tolist()
        sides.value = (x, y, z)
        self._gizmo = scene.add_transform_controls(
            "/gizmo",
            scale=max(x, y, z),
            disable_rotations=True,
            position=tuple((0.5 * (low + high)).tolist()),
            depth_test=False,
        )
        half = np.full(3, 0.5)
        self._outline = show_box(scene, "/gizmo/box", -half, half)
        self._outline.colors = _COLOR
        self._outline.scale = (x, y, z)
        self._gizmo.on_update(lambda _: self._changed())
        sides.on_update(lambda _: self._resize())

    @property
    def corners(self) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
        """Lowest and highest corner, in the scene's frame."""
        center, half = np.asarray(self._gizmo.position, dtype=np.float64), 0.5 * np.asarray(self._sides.value)
        return center - half, center + half

    def _resize(self) -> None:
        x, y, z = self._sides.value
        self._outline.scale = (x, y, z)
        self._changed()
