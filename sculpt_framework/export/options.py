"""Options that formats of meshes share, and what their words mean."""

import math
import re
from abc import ABC
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

from sculpt_framework.config import ExporterConfig
from sculpt_framework.errors import ConfigError

Unit = Literal["mm", "cm", "m", "in"]
METRES: Mapping[str, float] = {"mm": 0.001, "cm": 0.01, "m": 1.0, "in": 0.0254}

UpOption = Annotated[str | None, tyro.conf.arg(metavar='X|Y|Z|-X|-Y|-Z|"x y z"', help_behavior_hint="")]
UnitOption = Annotated[Unit | None, tyro.conf.arg(metavar="mm|cm|m|in", help_behavior_hint="")]
FacesOption = Annotated[int | None, tyro.conf.arg(metavar="N", help_behavior_hint="")]
DataOption = Annotated[str | None, tyro.conf.arg(metavar="DIR", help_behavior_hint="")]


@dataclass(frozen=True, kw_only=True)
class MeshExporterConfig(ExporterConfig, ABC):
    """Base of formats that hold the mesh: how many faces, how large, which way up, where."""

    target_faces: FacesOption = None
    """Simplify the mesh to at most so many faces; it stays closed."""
    size: Annotated[str | None, tyro.conf.arg(metavar="LENGTH", help_behavior_hint="")] = None
    """Longest side of the mesh's box, as 80mm, 8cm, 0.08m or 3.1in; a number alone counts in the file's unit. Default:
    the scene's true scale where that is known, its own numbers where not."""
    up: UpOption = None
    """Which direction of the scene is up; COLMAP's models often have -Y. Default: what frame.json of the run or the
    scene says, or Z."""
    origin: Literal["world", "bottom-center"] = "world"
    """Where the file's origin is: the scene's, or below the middle of the mesh's box, which then stands on the
    ground."""
    flat_base: bool = False
    """Cut off the lowest 0.5 mm (without a real size 0.5 % of the height) and close the mesh with a flat face."""

    @property
    def needs_up(self) -> bool:
        """Whether an option speaks of what is up and what is below."""
        return self.up is not None or self.origin != "world" or self.flat_base

    @property
    def is_placed(self) -> bool:
        """Whether something else than the scene's own frame is asked for."""
        return self.needs_up or self.size is not None

    def stem(self, *parts: str) -> str:
        """A file name without ending that says what was asked for."""
        faces = () if self.target_faces is None else (str(self.target_faces),)
        return "-".join(("mesh", *faces, *parts))

    def check(self) -> None:
        """Raises ConfigError for words that mean nothing."""
        if self.size is not None:
            parse_length(self.size)
        if self.up is not None:
            parse_up(self.up)


@dataclass(frozen=True, kw_only=True)
class TexturedExporterConfig(MeshExporterConfig, ABC):
    """Base of formats of meshes that can have a texture."""

    texture: bool = False
    """A texture baked from the photographs of the run, instead of vertex colours."""
    texture_size: Annotated[int, tyro.conf.arg(metavar="TEXELS")] = 2048
    """About how wide and high the texture is."""
    data: DataOption = None
    """Where the photographs are, if not where the run found them."""

    @property
    def textured_stem(self) -> str:
        """``stem``, and whether there is a texture."""
        return self.stem(*(("textured",) if self.texture else ()))


@dataclass(frozen=True, kw_only=True)
class Length:
    value: float
    unit: Unit | None
    """None: whatever unit the file is in."""


def parse_length(text: str) -> Length:
    """``80mm`` and the like. Raises ConfigError."""
    match = re.fullmatch(r"\s*([0-9.eE+]+(?:[eE]-[0-9]+)?)\s*(mm|cm|m|in)?\s*", text)
    try:
        value = float(match[1]) if match else math.nan
    except ValueError:
        value = math.nan
    if match is None or not 0 < value < math.inf:
        raise ConfigError(f"--size is {text!r}; expected a length above 0 such as 80mm, 8cm, 0.08m or 3.1in.")
    unit: Unit | None = match[2]  # pyright: ignore[reportAssignmentType]
    return Length(value=value, unit=unit)


def parse_up(text: str) -> Sequence[float]:
    """A direction, not yet of length 1: an axis' name or three numbers. Raises ConfigError."""
    match = re.fullmatch(r"\s*([+-]?)([xyzXYZ])\s*", text)
    if match:
        sign = -1.0 if match[1] == "-" else 1.0
        return tuple(sign if match[2].lower() == axis else 0.0 for axis in "xyz")
    try:
        numbers = [float(word) for word in text.replace(",", " ").split()]
    except ValueError:
        numbers = []
    if len(numbers) != 3 or not all(map(math.isfinite, numbers)) or not any(numbers):
        raise ConfigError(f'--up is {text!r}; expected X, Y, Z, -X, -Y, -Z or three numbers as in "0 -1 0.1".')
    return numbers
