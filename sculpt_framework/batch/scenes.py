"""Which scenes a batch has: those of a folder, or those of a list."""

from collections.abc import Sequence
from pathlib import Path

from sculpt_framework.command_line.request import parse
from sculpt_framework.errors import ConfigError
from sculpt_framework.experiments.matrix import Cell, Matrix, MatrixScene, folder_name, matrix_scenes

REFUSED_OPTIONS = ("--data", "--output", "--resume", "--viewer", "--refine-box", "--config")
"""What a batch sets itself, run by run, or what makes no sense for many runs."""
_MARKS = ("transforms*.json", "cameras*.npz", "sparse", "render/transforms.json")
"""What lies in a folder that is one scene, in the layouts of docs/guide/data.md."""


def find_scenes(given: str) -> tuple[MatrixScene, ...]:
    """The scenes that SCENE_DIR_OR_LIST stands for, each with a short name of its own.

    A folder stands for the folders in it, but for hidden ones: whether a scene can be read is for its run to find
    out, so that one that cannot is a failure with a name. A file has a scene per line, a folder or ``demo:NAME``,
    relative to the file; empty lines, and lines that begin with ``#``, are passed over. Raises ConfigError where that
    gives no scene, a scene twice, or a folder that is not there.
    """
    path = Path(given).expanduser()
    if path.is_dir():
        found = [str(each) for each in sorted(path.iterdir()) if each.is_dir() and not each.name.startswith(".")]
        if any(True for mark in _MARKS for _ in path.glob(mark)):
            raise ConfigError(f"{given} is one scene; give the folder it is in, or use sculpt-train --data {given}.")
        if not found:
            raise ConfigError(f"{given} has no folders in it; expected one folder per scene.")
        return matrix_scenes(found)
    if not path.is_file():
        raise ConfigError(f"{given}: no such folder or file; expected a folder of scenes, or a list with one per line.")
    try:
        lines = [line.strip() for line in path.read_text(encoding="utf-8").splitlines()]
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{given} cannot be read as a list of scenes ({error}).") from error
    words = [line for line in lines if line and not line.startswith("#")]
    if not words:
        raise ConfigError(f"{given} names no scenes; expected one folder or demo:NAME per line.")
    return matrix_scenes([word if _is_demo(word) else str(path.parent / Path(word).expanduser()) for word in words])


def check_options(extra: Sequence[str]) -> None:
    """Raise ConfigError where words for all runs set what differs from run to run."""
    for word in extra:
        option = word.partition("=")[0].replace("_", "-")
        if option in REFUSED_OPTIONS:
            raise ConfigError(f"{option} cannot be given to all runs of a batch; leave it out.")


def batch_matrix(scenes: Sequence[MatrixScene], method: str, extra: Sequence[str]) -> Matrix:
    """One run per scene, all with the options of ``extra``.

    Raises ConfigError where a command line would not be valid; that is found without torch.
    """
    config = parse((method, "--data", scenes[0].data, *extra))
    cells = tuple(
        Cell(
            name=folder_name(scene.label),
            scene=scene.label,
            setting=config.method,
            budget=None,
            seed=config.seed,
            words=(method, "--data", scene.data, *extra),
        )
        for scene in scenes
    )
    return Matrix(title=f"{config.method} on {len(cells)} scenes", cells=cells, warm_ups={})


def _is_demo(word: str) -> bool:
    return word.partition(":")[0] == "demo"
