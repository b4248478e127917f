from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from sculpt_framework.config import ObserverConfig

if TYPE_CHECKING:
    from sculpt_plugins.observers.viser.viewer import ViserViewer


@dataclass(frozen=True, kw_only=True)
class ViserConfig(ObserverConfig):
    """A page in the browser that shows mesh and Gaussians while they are optimised."""

    host: str = "127.0.0.1"
    """Address to listen on. There is no access control: other machines should come through an SSH tunnel."""
    port: int = 7007
    """Port to listen on."""
    seconds: float = 2.0
    """Least training seconds between two updates of the scene."""

    def build(self, run_dir: Path) -> "ViserViewer":
        from sculpt_plugins.observers.viser.viewer import ViserViewer

        return ViserViewer(self)
