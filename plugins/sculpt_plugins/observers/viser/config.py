from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from sculpt_framework.config import ObserverConfig
from sculpt_framework.ranges import at_least, between

if TYPE_CHECKING:
    from sculpt_plugins.observers.viser.observer import ViserObserver


@dataclass(frozen=True, kw_only=True)
class ViserConfig(ObserverConfig):
    """A page in the browser that shows the surface while it is sculpted, and steers the run."""

    host: str = "127.0.0.1"
    """Address to listen on: one of this machine's own. Other machines come through an SSH tunnel."""
    port: Annotated[int, between(0, 65_535)] = 7007
    """Port to listen on; 0: any that is free."""
    seconds: Annotated[float, at_least(0)] = 2.0
    """Least seconds between two updates of the scene, while a browser looks."""

    def check_start(self) -> None:
        """Raise ConfigError if the page cannot be offered at ``host`` and ``port``."""
        from sculpt_framework.viewing.address import check_address

        check_address(self.host, self.port, "--observers.viser.port")

    def build(self, run_dir: Path) -> "ViserObserver":
        from sculpt_plugins.observers.viser.observer import ViserObserver

        return ViserObserver(self, run_dir)
