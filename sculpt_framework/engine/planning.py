"""The scene's plan, made once for all processes of a run."""

from sculpt_framework.config import MethodConfig
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
