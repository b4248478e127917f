"""Which of a scene's train views are learned from."""

from collections.abc import Collection, Sequence
from dataclasses import replace

from sculpt_framework.errors import ConfigError
from sculpt_framework.types import Scene


def without_views(scene: Scene, names: Collection[str]) -> Scene:
    """The scene without train views of these names. Raises ConfigError for a name it has not, or if none is left."""
    known = {view.name for view in scene.train}
    for name in names:
        if name not in known:
            raise ConfigError(f"--skip-views {name}: the scene has no train view of that name.")
    kept = tuple(view for view in scene.train if view.name not in names)
    if not kept:
        raise ConfigError("--skip-views names all train views; a run needs some.")
    return scene if len(kept) == len(scene.train) else replace(scene, train=kept)


def split_views(count: int, every: int) -> tuple[Sequence[int], Sequence[int]]:
    """Indices to train on and to hold out: one of every ``every``, from the middle of each run of that length."""
    if every <= 1 or count < every:
        return range(count), ()
    held = set(range(every // 2, count, every))
    return [index for index in range(count) if index not in held], sorted(held)
