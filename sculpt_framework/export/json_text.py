"""JSON that every reader accepts: no NaN, no Infinity."""

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any


def json_text(value: Any, indent: int | None = None) -> str:
    """``value`` as JSON. Numbers that are not finite become null; whatever is not a JSON value becomes its text."""
    return json.dumps(_plain(value), indent=indent, allow_nan=False, default=str)


def _plain(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str | bytes):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
