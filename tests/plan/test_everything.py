"""The yardstick stays what it was, whatever becomes of defaults."""

from pathlib import Path

from sculpt_framework import registry
from sculpt_framework.serialization import config_from_json

STORED = Path(__file__).with_name("everything.json")


def test_the_yardstick_is_frozen() -> None:
    assert (
        config_from_json(STORED.read_text(encoding="utf-8")) == registry.load_method("gaussian-sculpting-everything")()
    )
