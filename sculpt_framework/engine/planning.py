"""What a run is made of: the scene's plan, made once for all processes, and the views that are learned from."""

from collections.abc import Collection, Sequence
from dataclasses import replace

from sculpt_framework.config import MethodConfig
from sculpt_framework.errors import ConfigError
from sculpt_framework.parallel.processes import Processes
from sculpt_framework.plan.decision import ScenePlan
from sculpt_framework.serialization import config_from_json, config_to_json
from sculpt_framework.types import Scene
from sculpt_framework.validation import check


def planned(config: MethodConfig, scene: Scene, processes: Processes) -> tuple[MethodConfig, ScenePlan | None]:
    """What to train, after a look at the scene (``MethodConfig.planned``).

    The first process has the plan, all have the config that follows from it. Raises ConfigError for values that no run
    can use.
    """
    check(config)
    if processes.count == 1:
        return config.planned(scene)
    made: list[ScenePlan | None] = []

    def decide() -> str:
        decided, plan = config.planned(scene)
        made.append(plan)
        return config_to_json(decided)

    return config_from_json(processes.first(decide)), made[0] if made else None


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


def as_trained(scene: Scene, config: MethodConfig) -> Scene:
    """The scene without the views that a run of this config left out, as far as it still has them."""
    return without_views(scene, {view.name for view in scene.train} & set(config.skip_views))


def split_views(count: int, every: int) -> tuple[Sequence[int], Sequence[int]]:
    """Indices to train on and to hold out: one of every ``every``, from the middle of each run of that length."""
    if every <= 1 or count < every:
        return range(count), ()
    held = set(range(every // 2, count, every))
    return [index for index in range(count) if index not in held], sorted(held)
