"""What stands in the scene, and the tab of the page that says what of it is shown."""

import logging
import threading
from pathlib import Path

import numpy as np
import viser

from sculpt_framework.errors import SculptError
from sculpt_framework.evaluation.geometry import MeasuredMesh
from sculpt_framework.evaluation.mesh import load_mesh
from sculpt_framework.types import Scene
from sculpt_framework.viewing.cameras import CameraTab
from sculpt_framework.viewing.colors import COLORS, MODES, paint
from sculpt_framework.viewing.frames import Frame, read_frame, step_files
from sculpt_framework.viewing.layers import show_box, show_cells, show_mesh, show_splats, show_wireframe
from sculpt_framework.viewing.markdown import plain
from sculpt_framework.viewing.run_folder import RunFolder
from sculpt_framework.viewing.server import look_from_aside

_log = logging.getLogger("sculpt")
SPLATS_AT_MOST = {"100 thousand": 100_000, "300 thousand": 300_000, "1 million": 1_000_000, "all": 1 << 60}
USUAL_SPLATS = "300 thousand"


class Stage:
    """Shows one frame at a time: the newest, or the recorded step the slider is on.

    The switches only note what is wanted; ``update``, called again and again from one thread, does it.
    """

    def __init__(self, server: viser.ViserServer, run: RunFolder, tabs: viser.GuiTabGroupHandle):
        self._server, self._run = server, run
        self._changed = threading.Event()
        gui = server.gui
        with tabs.add_tab("Scene"):
            self._mesh_on = gui.add_checkbox("Mesh", initial_value=True)
            self._paint = gui.add_dropdown("Coloured by", MODES, initial_value=COLORS)
            self._legend = gui.add_markdown("")
            self._wire_on = gui.add_checkbox("Wireframe", initial_value=False)
            self._splats_on = gui.add_checkbox("Gaussians", initial_value=False)
            self._most = gui.add_dropdown(
                "At most",
                tuple(SPLATS_AT_MOST),
                initial_value=USUAL_SPLATS,
                hint="Of more Gaussians a part is shown.",
            )
            self._cells_on = gui.add_checkbox("Grid cells", initial_value=False)
            self._reference_on = gui.add_checkbox("Reference mesh", initial_value=False)
            self._box_on = gui.add_checkbox("Box of the object", initial_value=True)
            self._step = gui.add_slider(
                "Step", min=0, max=1, step=1, initial_value=1, hint="Recorded steps; at the right end the newest."
            )
            self._step_text = gui.add_markdown("Waiting for the first surface.")
        self.switches = {
            "mesh": self._mesh_on,
            "wireframe": self._wire_on,
            "gaussians": self._splats_on,
            "cells": self._cells_on,
            "reference": self._reference_on,
            "box": self._box_on,
        }
        for control in (*self.switches.values(), self._paint, self._most, self._step):
            control.on_update(lambda _: self._changed.set())
        self._cameras = CameraTab(server, run, tabs)
        self._nodes: dict[str, viser.SceneNodeHandle] = {}
        self._made: dict[str, object] = {}
        """Of each layer, what it was made from: it is made again when that is another."""
        self._stamp: tuple[str, int] = ("", 0)
        self._newest: Frame | None = None
        self._shown: Frame | None = None
        self._recorded: list[tuple[int, object]] = []
        self._follows = True
        self._reference: MeasuredMesh | None = None
        self._reference_path: object = None
        self.scene: Scene | None = None

    @property
    def box(self) -> np.ndarray | None:
        """Lowest and highest corner of the object's box, as the run said; None before it did."""
        box = self._run.started.get("box")
        return None if box is None else np.array(box, dtype=np.float64)

    def set_scene(self, scene: Scene) -> None:
        """Called once the views have been read, which may take a while."""
        self.scene = scene
        self._cameras.set_scene(scene)
        self._changed.set()

    def do_without_scene(self, reason: str) -> None:
        """Called instead if they cannot be read."""
        self._cameras.text.content = f"No photographs: {plain(reason)}"

    def hide_gaussians(self) -> None:
        """Show the mesh in place of the Gaussians, which a page paints over the handles of a box."""
        if self._splats_on.value:
            self._splats_on.value, self._mesh_on.value = False, True

    def update(self) -> None:
        """Bring the scene up to date with the run's files and the switches."""
        changed = self._changed.is_set()
        self._changed.clear()
        self._read_reference()
        frame = self._choose()
        if frame is not None and (frame is not self._shown or changed):
            self._draw(frame)
        self._cameras.update(frame)

    # -- which frame ---------------------------------------------------------------------------------------------

    def _choose(self) -> Frame | None:
        files = step_files(self._run.folder)
        if len(files) != len(self._recorded):
            at_end = self._step.value >= self._step.max
            self._recorded = list(files)
            self._step.max = max(1, len(files))
            if at_end:
                self._step.value = self._step.max
        index = int(self._step.value)
        try:
            if index < self._step.max and index < len(files):
                if self._shown is None or self._follows or self._shown.outer != files[index][0]:
                    self._follows = False
                    return read_frame(files[index][1])
                return self._shown
            self._follows = True
            stamp = self._run.live_stamp
            if stamp != self._stamp:
                # Noted first: what cannot be read now is not tried again until it is another.
                self._stamp = stamp
                self._newest = self._run.newest()
        except SculptError as error:
            self._step_text.content = f"**{plain(error)}**"
        return self._newest

    def _read_reference(self) -> None:
        path = self._run.started.get("reference")
        if path == self._reference_path:
            return
        self._reference_path = path
        try:
            self._reference = None if path is None else MeasuredMesh(load_mesh(Path(path)), samples=1)
        except SculptError as error:
            _log.warning("%s", error)

    # -- drawing it ----------------------------------------------------------------------------------------------

    def _draw(self, frame: Frame) -> None:
        if len(frame.faces) == 0:
            return
        first = self._shown is None
        on = {name: bool(switch.value) for name, switch in self.switches.items()}
        mode, most = self._paint.value, SPLATS_AT_MOST[self._most.value]
        api = self._server.scene
        cameras = [] if self.scene is None else [view.camera for view in self.scene.train]
        with self._server.atomic():
            if on["mesh"] and self._is_other("mesh", (frame, mode, len(cameras) if mode == "seen" else 0)):
                painted = paint(frame, mode, self._reference, cameras)
                self._nodes["mesh"] = show_mesh(api, painted)
                self._legend.content = painted.legend
            if on["wireframe"] and self._is_other("wireframe", frame):
                self._nodes["wireframe"] = show_wireframe(api, frame)
            if on["gaussians"] and self._is_other("gaussians", (frame, most)):
                if frame.gaussians is None:
                    self._drop("gaussians")
                else:
                    self._nodes["gaussians"] = show_splats(api, frame.gaussians, most)
            if on["cells"] and self._is_other("cells", frame):
                if frame.cells is None:
                    self._drop("cells")
                else:
                    self._nodes["cells"] = show_cells(api, frame.cells)
            self._draw_fixed(on)
            for name, node in self._nodes.items():
                if node.visible != on[name]:
                    node.visible = on[name]
        self._shown = frame
        self._step_text.content = _words(frame, on)
        if first:
            self._look_at(frame.vertices.min(axis=0), frame.vertices.max(axis=0))

    def _draw_fixed(self, on: dict[str, bool]) -> None:
        api = self._server.scene
        box = self.box
        if on["box"] and box is not None and self._is_other("box", box.tolist()):
            low, high = box
            self._nodes["box"] = show_box(api, "/box", low, high)
        if on["reference"] and self._reference is not None and self._is_other("reference", self._reference):
            mesh = self._reference.mesh
            self._nodes["reference"] = api.add_mesh_simple(
                "/reference",
                mesh.vertices.astype(np.float32),
                mesh.faces.astype(np.uint32),
                color=(205, 150, 60),
                opacity=0.5,
                side="double",
            )

    def _is_other(self, name: str, source: object) -> bool:
        """Whether a layer has to be made anew, noting that it is."""
        if name in self._made and self._made[name] == source:
            return False
        self._made[name] = source
        return True

    def _drop(self, name: str) -> None:
        node = self._nodes.pop(name, None)
        if node is not None:
            node.remove()

    def _look_at(self, lowest: np.ndarray, highest: np.ndarray) -> None:
        """Let a page that opens, and those that are open, see the whole object, from above and aside."""
        position = look_from_aside(self._server, lowest, highest)
        for client in self._server.get_clients().values():
            client.camera.position, client.camera.look_at = position, 0.5 * (lowest + highest)


def _words(frame: Frame, on: dict[str, bool]) -> str:
    if frame.outer < 0:
        text = "The result"
    else:
        text = f"After {frame.outer} steps, {frame.t_train:.1f} s of training"
    text += f": {len(frame.faces)} faces"
    if frame.gaussians is not None:
        text += f", {len(frame.gaussians)} Gaussians"
    elif on["gaussians"]:
        text += "; of recorded steps only the surface is kept, not its Gaussians"
    if on["cells"] and frame.cells is None:
        text += "; its grid cells are not known"
    return text + "."
