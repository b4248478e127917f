"""The yardstick stays what it was, whatever becomes of defaults."""

import json
from pathlib import Path
from typing import Any

from sculpt_framework import registry
from sculpt_framework.serialization import config_to_json

STORED = Path(__file__).with_name("everything.json")


def same(stored: Any, now: Any, path: str = "") -> list[str]:
    """Where what was stored is no longer so. Options that came later are not stored."""
    if isinstance(stored, dict):
        return [line for key in stored for line in same(stored[key], now.get(key, "missing"), f"{path}.{key}")]
    if isinstance(stored, list):
        if len(stored) != len(now):
            return [path]
        return [line for index, each in enumerate(stored) for line in same(each, now[index], f"{path}[{index}]")]
    return [] if stored == now else [f"{path}: {stored} became {now}"]


def test_the_yardstick_is_frozen() -> None:
    now = json.loads(config_to_json(registry.load_method("gaussian-sculpting-everything")()))
    assert same(json.loads(STORED.read_text()), now) == []
