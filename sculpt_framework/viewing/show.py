"""Serve the page of a run until told to end."""

import threading
from collections.abc import Callable
from pathlib import Path

import viser

from sculpt_framework.commands import Command
from sculpt_framework.errors import SculptError
from sculpt_framework.types import Scene
from sculpt_framework.viewing.controls import Controls
from sculpt_framework.viewing.page import Overview
from sculpt_framework.viewing.run_folder import RunFolder
from sculpt_framework.viewing.server import start_server, stop_server
from sculpt_framework.viewing.stage import Stage

_POLL_SECONDS = 0.15


class Show:
    """The page of the run in ``folder``. ``send`` takes the commands; without it the page only shows.

    Raises CheckpointError if the folder is not a run directory.
    """

    def __init__(self, folder: Path, host: str, port: int, send: Callable[[Command], None] | None = None):
        self.run = RunFolder(folder, alive=send is not None)
        self.server: viser.ViserServer = start_server(host, port)
        self.server.scene.set_up_direction("+z")
        self.overview = Overview(self.server, self.run)
        tabs = self.server.gui.add_tab_group()
        self.stage = Stage(self.server, self.run, tabs)
        self.controls = None if send is None else Controls(self.server, tabs, self.run.config, self.stage, send)
        self.overview.add_tabs(tabs)
        self._scene: Scene | SculptError | None = None
        """The views, or why there are none, from the thread that reads them to the one that shows them."""
        threading.Thread(target=self._load_scene, name="views", daemon=True).start()

    @property
    def port(self) -> int:
        return self.server.get_port()

    @property
    def watching(self) -> int:
        """Browsers that have the page open."""
        return len(self.server.get_clients())

    def update(self) -> None:
        """Show what is new. To be called again and again, from one thread."""
        scene, self._scene = self._scene, None
        if isinstance(scene, SculptError):
            self.stage.do_without_scene(str(scene))
        elif scene is not None:
            self.stage.set_scene(scene)
        self.overview.hear(self.run.read_news())
        self.stage.update()
        if self.controls is not None:
            self.controls.update()

    def loop(self, ended: threading.Event, told: Callable[[int], None] = lambda watching: None) -> None:
        """Update until ``ended``, and once more then; ``told`` hears how many browsers look when that changes."""
        watching = 0
        while not ended.wait(_POLL_SECONDS):
            self.update()
            if self.watching != watching:
                watching = self.watching
                told(watching)
        self.update()
        self.server.flush()

    def close(self) -> None:
        stop_server(self.server)

    def _load_scene(self) -> None:
        try:
            self._scene = self.run.load_scene()
        except SculptError as error:
            self._scene = error
