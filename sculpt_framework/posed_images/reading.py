"""Values from JSON that may be anything, with errors that say where."""

import difflib
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from sculpt_framework.errors import DataError


def read_text(path: Path, expected: str) -> str:
    """A text file in UTF-8. Raises DataError, with what was ``expected``, where it cannot be read or is no text."""
    try:
        return path.read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise DataError(f"{path}: cannot be read ({error.strerror}).") from None
    except UnicodeDecodeError:
        raise DataError(f"{path}: not text; expected {expected}.") from None


def read_json(path: Path, keys: str = "camera_angle_x and frames") -> dict[str, object]:
    """The object in a JSON file. Raises DataError if the file is unreadable, cut, or holds something else; ``keys`` are
    what the message says that it should hold.
    """
    text = read_text(path, "JSON in UTF-8")
    if not text.strip():
        raise DataError(f"{path}: the file is empty; expected JSON with {keys}.")
    try:
        value = json.loads(text)
    except json.JSONDecodeError as error:
        cut = "cut off" if error.pos >= len(text.rstrip()) - 1 or "Unterminated" in error.msg else "not valid"
        raise DataError(f"{path}: the JSON is {cut} at line {error.lineno} ({error.msg}); write it again.") from None
    except (RecursionError, ValueError) as error:
        raise DataError(f"{path}: the JSON cannot be read ({type(error).__name__}); write it again.") from None
    if not isinstance(value, dict):
        raise DataError(f"{path}: holds a {_kind(value)}; expected an object with {keys}.")
    return value


def required(entries: Mapping[str, object], key: str, where: str) -> object:
    """The value of a key. Raises DataError, with the key that was probably meant, if it is missing."""
    if key in entries:
        return entries[key]
    close = nearest_key(key, entries)
    hint = f"; did you mean it by '{close}'?" if close else f"; found {_listing(entries)}."
    raise DataError(f"{where}: no '{key}'{hint}")


def number(value: object, where: str) -> float:
    """A finite number. Raises DataError otherwise."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        try:
            real = float(value)
        except OverflowError:
            real = math.inf
        if math.isfinite(real):
            return real
        raise DataError(f"{where} is {real}; expected a finite number.")
    raise DataError(f"{where} is a {_kind(value)}; expected a number.")


def nearest_key(key: str, entries: Iterable[str]) -> str | None:
    """The key somebody may have meant; None if nothing is close."""
    candidates = {name.lower().replace("-", "_"): name for name in entries if name != key}
    close = difflib.get_close_matches(key.lower(), candidates, n=1, cutoff=0.75)
    return candidates[close[0]] if close else None


def in_short(names: Sequence[str], most: int = 3) -> str:
    """The first few of many names."""
    return ", ".join(names[:most]) + (", ..." if len(names) > most else "")


def in_line(text: str, most: int = 200) -> str:
    """A name from a file, so that it can be shown: without what is no letter, and not longer than a line."""
    shown = "".join(letter if letter.isprintable() else "?" for letter in text)
    return shown if len(shown) <= most else f"{shown[: most // 2]}...{shown[-most // 2 :]}"


def _listing(entries: Iterable[str]) -> str:
    names = sorted(entries)
    return in_short(names, 6) if names else "nothing"


def _kind(value: object) -> str:
    kinds = {dict: "object", list: "list", str: "text", bool: "truth value", int: "number", float: "number"}
    return kinds.get(type(value), "null")
