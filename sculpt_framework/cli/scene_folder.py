"""The scene in a folder, as the commands that look at one before a run read it."""

from dataclasses import replace
from typing import TYPE_CHECKING, cast

from sculpt_framework import registry
from sculpt_framework.validation import check_component

if TYPE_CHECKING:
    from sculpt_framework.config import DatasetConfig
    from sculpt_framework.datasets import Dataset


def open_folder(folder: str, downscale: int | None, **options: object) -> "Dataset":
    """In the layout it is recognised by, with options of ``--dataset``; ``downscale`` where it is not None.

    Raises ConfigError where the layout has no such option, DataError.
    """
    config = cast("DatasetConfig", registry.default("dataset", "auto"))
    config = replace(config, **options, **({} if downscale is None else {"downscale": downscale}))
    check_component(config)
    return config.build(folder)
