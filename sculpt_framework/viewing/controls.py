"""The tab that steers a run: each control sends one command; what came of it stands in the plan."""

from collections.abc import Callable

import viser

from sculpt_framework.commands import (
    AddBox,
    ClearBoxes,
    Command,
    ExportMesh,
    Pause,
    Resume,
    SetRate,
    SetWeight,
    Stop,
    SwitchConstraint,
)
from sculpt_framework.config import MethodConfig
from sculpt_framework.registry import name_of
from sculpt_framework.sculpting.config import SculptingConfig
from sculpt_framework.viewing.movable_box import MovableBox
from sculpt_framework.viewing.server import TOWARDS_CAMERA
from sculpt_framework.viewing.stage import Stage

_FIRST_SHARE = 0.3
"""Side of a box that has just been placed, of the object's."""
_KINDS = (("Refine here", "refine"), ("Freeze here", "freeze"), ("Ignore here", "ignore"))


class Controls:
    def __init__(
        self,
        server: viser.ViserServer,
        tabs: viser.GuiTabGroupHandle,
        config: MethodConfig,
        stage: Stage,
        send: Callable[[Command], None],
    ):
        self._server, self._stage, self._send = server, stage, send
        self._place: viser.GuiButtonHandle | None = None
        with tabs.add_tab("Steer"):
            self._button("Pause", Pause())
            self._button("Go on", Resume())
            self._button("Export the mesh", ExportMesh())
            self._button("Stop and save", Stop())
            # What other methods can be told is not known here.
            if isinstance(config, SculptingConfig):
                self._add_terms(config)
                self._add_box()
        self._box: MovableBox | None = None

    def update(self) -> None:
        """Offer what can be done by now: boxes are placed in that of the object, which the run has to tell first."""
        if self._place is not None and not self._place.visible:
            self._place.visible = self._stage.box is not None

    def _add_terms(self, config: SculptingConfig) -> None:
        gui = self._server.gui
        with gui.add_folder("Weights", expand_by_default=False):
            for loss in config.losses:
                self._weight("losses", name_of(loss), loss.weight)
            for constraint in config.constraints:
                self._weight("constraints", name_of(constraint), constraint.weight)
        with gui.add_folder("Constraints", expand_by_default=False):
            for constraint in config.constraints:
                self._switch(name_of(constraint))
        with gui.add_folder("Learning rates", expand_by_default=False):
            self._rate("surface")
            self._rate("gaussians")

    def _add_box(self) -> None:
        gui = self._server.gui
        with gui.add_folder("A box"):
            self._place = gui.add_button("Place a box", visible=False)
            self._size = gui.add_vector3("Sides", (1.0, 1.0, 1.0), min=(1e-6, 1e-6, 1e-6), visible=False)
            self._actions = [self._box_button(label, kind) for label, kind in _KINDS]
            self._button("Take all boxes back", ClearBoxes())
        self._place.on_click(lambda _: self._place_box())

    def _button(self, label: str, command: Command) -> None:
        self._server.gui.add_button(label).on_click(lambda _: self._send(command))

    def _weight(self, slot: str, name: str, weight: float) -> None:
        number = self._server.gui.add_number(name, initial_value=float(weight), min=0.0)
        kind = "losses" if slot == "losses" else "constraints"
        number.on_update(lambda _: self._send(SetWeight(slot=kind, name=name, weight=float(number.value))))

    def _switch(self, name: str) -> None:
        box = self._server.gui.add_checkbox(name, initial_value=True)
        box.on_update(lambda _: self._send(SwitchConstraint(name=name, on=bool(box.value))))

    def _rate(self, part: str) -> None:
        slider = self._server.gui.add_slider(f"Of the {part}, times", min=0.0, max=4.0, step=0.05, initial_value=1.0)
        known = "surface" if part == "surface" else "gaussians"
        slider.on_update(lambda _: self._send(SetRate(part=known, factor=float(slider.value))))

    def _box_button(self, label: str, kind: str) -> viser.GuiButtonHandle:
        button = self._server.gui.add_button(label, visible=False)
        button.on_click(lambda _: self._send_box(kind))
        return button

    def _place_box(self) -> None:
        box = self._stage.box
        if box is None or self._box is not None:
            return
        self._stage.hide_gaussians()
        low, high = box
        side = _FIRST_SHARE * float((high - low).max())
        # Out of the middle, towards where a page looks from: there it is seen.
        place = 0.5 * (low + high) + 0.3 * (high - low) * TOWARDS_CAMERA
        self._box = MovableBox(self._server.scene, self._size, place - 0.5 * side, place + 0.5 * side)
        self._size.visible = True
        for button in self._actions:
            button.visible = True

    def _send_box(self, kind: str) -> None:
        if self._box is None:
            return
        (x0, y0, z0), (x1, y1, z1) = (corner.tolist() for corner in self._box.corners)
        known = {"refine": "refine", "freeze": "freeze"}.get(kind, "ignore")
        self._send(AddBox(kind=known, minimum=(x0, y0, z0), maximum=(x1, y1, z1)))  # pyright: ignore[reportArgumentType]
