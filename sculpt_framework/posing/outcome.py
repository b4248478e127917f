"""What came of posing: who has a camera, who has not and why; in words and as JSON."""

import json
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from sculpt_framework.errors import DataError
from sculpt_framework.posing.colmap import Matched

NAME = "posing.json"
_FEW_FEATURES = 50
_NAMED = 6


@dataclass(frozen=True, kw_only=True)
class Outcome:
    photographs: int
    registered: int
    error_px: float
    """Mean reprojection error of the points, in pixels of the photographs."""
    points: int
    cameras: tuple[str, ...]
    """The lenses, in words."""
    compared: str
    """Which photographs were compared with which."""
    models: tuple[int, ...]
    """Photographs in each model that could not be joined with the others, most first."""
    left_out: Mapping[str, str]
    """Why a photograph has no camera, by its name."""
    notes: tuple[str, ...]
    seconds: float
    """Of all calls together."""

    def lines(self, folder: Path) -> list[str]:
        """A card, one fact a line."""
        out = [
            f"posed      {self.registered} of {self.photographs} photographs",
            f"error      {self.error_px:.2f} px at {self.points} points",
            *(f"lens       {camera}" for camera in self.cameras),
            f"compared   {self.compared}",
            *(f"note       {note}" for note in self.notes),
        ]
        if len(self.models) > 1:
            sizes = ", ".join(str(size) for size in self.models)
            out.append(
                f"pieces     {len(self.models)} that could not be joined, of {sizes} photographs; the first is taken"
            )
        for reason, number in Counter(self.left_out.values()).most_common():
            names = [name for name, why in self.left_out.items() if why == reason]
            out.append(f"left out   {number}: {reason} ({listed(names)})")
        return [*out, f"seconds    {self.seconds:.0f}", f"scene      {folder}"]

    def to_json(self) -> str:
        return json.dumps(asdict(self), indent=1) + "\n"


def listed(names: Sequence[str]) -> str:
    """The first of them."""
    return ", ".join(names[:_NAMED]) + (", ..." if len(names) > _NAMED else "")


def read_outcome(folder: Path) -> Outcome:
    """Of a posed scene. Raises DataError where it cannot be read."""
    path = folder / NAME
    try:
        said = json.loads(path.read_text(encoding="utf-8"))
        listed = {key: tuple(said[key]) for key in ("cameras", "models", "notes")}
        return Outcome(**{**said, **listed})
    except (OSError, ValueError, TypeError, KeyError) as error:
        raise DataError(f"{path}: cannot be read ({error}); remove {folder} and pose again.") from error


def reasons(matches: Matched, models: Sequence[Sequence[str]]) -> dict[str, str]:
    """Why each image that is not in the first model has no camera, by its name in the database."""
    placed = set(models[0]) if models else set()
    elsewhere = {name: index for index, names in reversed(list(enumerate(models))) for name in names if index}
    out = {}
    for name, features in matches.features.items():
        if name in placed:
            continue
        if name in elsewhere:
            out[name] = f"only in piece {elsewhere[name] + 1}, which overlaps too little with the first"
        elif features < _FEW_FEATURES:
            out[name] = "hardly any features: blurred, or without texture"
        elif matches.partners[name] == 0:
            out[name] = "no matches with any other"
        else:
            out[name] = "too few matches with those that are placed"
    return out


def nothing_placed(folder: Path, matches: Matched, unreadable: int, masked: bool) -> DataError:
    """The error where no camera could be found, with what was seen and what would help."""
    features = sorted(matches.features.values())
    pairs = sum(matches.partners.values()) // 2
    typical = features[len(features) // 2] if features else 0
    seen = f"{typical} features in the middle one of {len(features)} photographs, {pairs} pairs that match"
    seen += f", {unreadable} files that cannot be read" if unreadable else ""
    if typical < _FEW_FEATURES:
        helps = "sharper photographs, and texture on the object or under it, such as newspaper"
    else:
        helps = "more overlap (a photograph every 10 degrees or so), and texture under the object"
    helps += "; with --ignore-masks, features outside the masks count too" if masked else ""
    return DataError(f"{folder}: no cameras were found: {seen}. What helps: {helps}.")
