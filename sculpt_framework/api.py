"""What a notebook or a program needs, in one place; ``sculpt_framework`` offers it under the same names."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import cast

from sculpt_framework import registry
from sculpt_framework.config import DatasetConfig
from sculpt_framework.config import MethodConfig as MethodConfig
from sculpt_framework.engine.session import Report as Report
from sculpt_framework.engine.session import Session as Session
from sculpt_framework.evaluation.painted import PaintedMesh as PaintedMesh
from sculpt_framework.reconstructor import Host as Host
from sculpt_framework.reconstructor import Moment as Moment
from sculpt_framework.reconstructor import Reconstructor as Reconstructor
from sculpt_framework.reconstructor import StepReport as StepReport
from sculpt_framework.types import Box as Box
from sculpt_framework.types import Camera as Camera
from sculpt_framework.types import Scene as Scene
from sculpt_framework.types import View as View
from sculpt_framework.validation import check_component


def load(data: str | Path, dataset: DatasetConfig | None = None) -> Scene:
    """The scene in a folder, or ``demo`` or ``demo:NAME``. The layout is recognised where no ``dataset`` says it;
    photographs without cameras, and a video, are posed first (docs/guide/posing.md).

    Raises ConfigError for options out of range, DataError for data that cannot be used, with what was found and what is
    expected.
    """
    chosen = dataset or cast(DatasetConfig, registry.default("dataset", "auto"))
    where = str(Path(data).absolute()) if Path(data).exists() else str(data)
    check_component(chosen)
    scene = chosen.build(where).load()
    return replace(scene, data=scene.data or where)


class Methods(Mapping[str, Callable[[], MethodConfig]]):
    """Every method that is installed, by name: what makes its config, which ``dataclasses.replace`` changes."""

    def __getitem__(self, name: str) -> Callable[[], MethodConfig]:
        """Raises KeyError for a name there is not."""
        if registry.spelled(name, registry.method_names()) is None:
            raise KeyError(name)
        return registry.load_method(name)

    def __iter__(self) -> Iterator[str]:
        return iter(registry.method_names())

    def __len__(self) -> int:
        return len(registry.method_names())


methods: Mapping[str, Callable[[], MethodConfig]] = Methods()
