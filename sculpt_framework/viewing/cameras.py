"""The tab of cameras: frustums one can click, and a view's photograph beside the rendering."""

import threading

import numpy as np
import viser
import viser.transforms

from sculpt_framework.types import Scene
from sculpt_framework.viewing.comparison import compare, rasterizer_here
from sculpt_framework.viewing.frames import Frame
from sculpt_framework.viewing.layers import camera_pose, show_cameras, vertical_fov
from sculpt_framework.viewing.markdown import plain
from sculpt_framework.viewing.run_folder import RunFolder

_FLIGHT_STEPS = 12
_FLIGHT_SECONDS = 0.4
_FRUSTUM_SHARE = 0.12
"""Of the box's longest half side."""
_NOTHING = np.full((8, 12, 3), 255, dtype=np.uint8)


class CameraTab:
    """Click a camera to look from there; the pictures below are of the one clicked last."""

    def __init__(self, server: viser.ViserServer, run: RunFolder, tabs: viser.GuiTabGroupHandle):
        self._server, self._run = server, run
        gui = server.gui
        with tabs.add_tab("Cameras"):
            self.show = gui.add_checkbox("Show cameras", initial_value=False)
            self.view = gui.add_slider("View", min=0, max=1, step=1, initial_value=0)
            self.look = gui.add_button("Look from there")
            self.text = gui.add_markdown("Reading the photographs.")
            self.pictures = [
                gui.add_image(_NOTHING, label=label, visible=False, format="jpeg")
                for label in ("Photograph", "Rendering", "Difference, four times as strong")
            ]
        self._scene: Scene | None = None
        self._frustums: list[viser.CameraFrustumHandle] = []
        self._rasterizer = None
        self._wanted: int | None = None
        self._compared: tuple[int, Frame | None] | None = None
        self.look.on_click(lambda event: self._go(int(self.view.value), event.client))

    def set_scene(self, scene: Scene) -> None:
        self._scene = scene
        self.view.max = max(1, len(scene.train) - 1)
        self.text.content = f"{len(scene.train)} views to learn from. Click a camera in the scene, or choose one here."

    def update(self, frame: Frame | None) -> None:
        """Make what is wanted by now."""
        if self._scene is None:
            return
        if self.show.value and not self._frustums:
            size = _FRUSTUM_SHARE * self._scene.box.scale
            self._frustums = show_cameras(self._server.scene, self._scene.train, size)
            for index, frustum in enumerate(self._frustums):
                frustum.on_click(lambda event, index=index: self._go(index, event.client))
        for frustum in self._frustums:
            if frustum.visible != self.show.value:
                frustum.visible = self.show.value
        if self._wanted is not None and frame is not None and self._compared != (self._wanted, frame):
            self._compare(self._wanted, frame, self._scene)

    def _go(self, index: int, client: viser.ClientHandle | None) -> None:
        if self._scene is None or index >= len(self._scene.train):
            return
        self.view.value = index
        self._wanted = index
        if client is not None:
            threading.Thread(target=self._fly, args=(client, index), daemon=True).start()

    def _fly(self, client: viser.ClientHandle, index: int) -> None:
        assert self._scene is not None  # noqa: S101
        camera = self._scene.train[index].camera
        wxyz, position = camera_pose(camera)
        start, goal = viser.transforms.SO3(client.camera.wxyz), viser.transforms.SO3(wxyz)
        turn, begin = (start.inverse() @ goal).log(), client.camera.position
        pause = threading.Event()
        for step in range(1, _FLIGHT_STEPS + 1):
            share = step / _FLIGHT_STEPS
            share = share * share * (3 - 2 * share)
            with client.atomic():
                client.camera.wxyz = (start @ viser.transforms.SO3.exp(share * turn)).wxyz
                client.camera.position = begin + share * (position - begin)
            pause.wait(_FLIGHT_SECONDS / _FLIGHT_STEPS)
        client.camera.fov = vertical_fov(camera)

    def _compare(self, index: int, frame: Frame, scene: Scene) -> None:
        self._compared = (index, frame)
        name = plain(scene.train[index].name)
        if frame.gaussians is None:
            self.text.content = f"{name}: of recorded steps the Gaussians are not kept, so there is nothing to render."
            return
        if self._rasterizer is None:
            self.text.content = f"{name}: rendering."
            self._rasterizer = rasterizer_here()
        found = compare(self._rasterizer, self._run.low_pass_px2, scene, index, frame.gaussians)
        error = found.difference.astype(np.float64).mean() / 4
        self.text.content = f"{name}: mean difference {error:.1f} of 255."
        for picture, image in zip(self.pictures, (found.photograph, found.rendering, found.difference), strict=True):
            picture.image, picture.visible = image, True
