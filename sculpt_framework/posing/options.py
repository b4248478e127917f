"""What a user may set about posing; free of heavy imports, for help."""

from dataclasses import dataclass
from typing import Literal

from sculpt_framework.errors import ConfigError

Cameras = Literal["one", "per-image", "per-folder"]
CAMERAS: tuple[Cameras, ...] = ("one", "per-image", "per-folder")


@dataclass(frozen=True, kw_only=True)
class PosingOptions:
    """Raises ConfigError for values out of range."""

    cameras: Cameras = "one"
    """Which photographs share a lens: all of the same size, none, or those of the same folder and size."""
    image_size: int = 1600
    """Longest side at which features are looked for, in pixels; the photographs keep their size."""
    features: int = 4096
    """Most features of a photograph."""
    frames: int = 80
    """Frames taken out of a video."""
    ignore_masks: bool = False
    """Use features of the whole photograph though there are masks."""
    seed: int = 0
    threads: int | None = None
    """None: as many as torch has."""

    def __post_init__(self) -> None:
        for option, value, low, high in (
            ("--image-size", self.image_size, 64, 100_000),
            ("--features", self.features, 100, 100_000),
            ("--frames", self.frames, 3, 10_000),
            ("--threads", 1 if self.threads is None else self.threads, 1, 4096),
            ("--seed", self.seed, 0, 2**31 - 1),
        ):
            if not low <= value <= high:
                raise ConfigError(f"{option} {value}: expected {low} to {high}.")
        if self.cameras not in CAMERAS:
            raise ConfigError(f"--cameras {self.cameras}: expected one of {', '.join(CAMERAS)}.")
