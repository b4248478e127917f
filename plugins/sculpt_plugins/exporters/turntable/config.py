from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import tyro

from sculpt_framework.config import ExporterConfig
from sculpt_framework.errors import ConfigError
from sculpt_framework.export.options import DataOption, FacesOption, UpOption, parse_up

if TYPE_CHECKING:
    from sculpt_plugins.exporters.turntable.exporter import TurntableExporter


@dataclass(frozen=True, kw_only=True)
class TurntableExporterConfig(ExporterConfig):
    """The mesh as it turns, GIF or with --out FILE.mp4 a video."""

    frames: Annotated[int, tyro.conf.arg(metavar="N")] = 60
    """Pictures in a turn."""
    size: Annotated[int, tyro.conf.arg(metavar="PIXELS")] = 480
    """Side of a picture."""
    up: UpOption = None
    """Which direction of the scene is up; COLMAP's models often have -Y. Default: what frame.json of the run or the
    scene says, or Z."""
    texture: bool = False
    """In a texture baked from the photographs of the run, instead of vertex colours."""
    texture_size: Annotated[int, tyro.conf.arg(metavar="TEXELS")] = 2048
    """About how wide and high the texture is."""
    data: DataOption = None
    """Where the photographs are, if not where the run found them."""
    target_faces: FacesOption = None
    """Simplify the mesh to at most so many faces; it stays closed."""

    @property
    def file_name(self) -> str:
        return f"turntable{'-textured' if self.texture else ''}.gif"

    def build(self) -> "TurntableExporter":
        from sculpt_plugins.exporters.turntable.exporter import TurntableExporter

        if not 1 <= self.frames <= 3600:
            raise ConfigError(f"--frames is {self.frames}; expected 1 to 3600.")
        if not 16 <= self.size <= 4096:
            raise ConfigError(f"--size is {self.size}; expected 16 to 4096 pixels.")
        if self.up is not None:
            parse_up(self.up)
        return TurntableExporter(self)
