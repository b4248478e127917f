"""All cases there are."""

from collections.abc import Callable, Iterator, Mapping, Sequence

from sculpt_framework.stress.cases import Case, Group
from sculpt_framework.stress.chain import chain_cases
from sculpt_framework.stress.faces import face_cases
from sculpt_framework.stress.guard import guard_cases
from sculpt_framework.stress.life import life_cases
from sculpt_framework.stress.scenes import scene_cases
from sculpt_framework.stress.splats import splat_cases
from sculpt_framework.stress.stiff import stiff_cases
from sculpt_framework.stress.surfaces import surface_cases

GROUPS: Mapping[Group, Sequence[Callable[[], Iterator[Case]]]] = {
    "operators": (face_cases, splat_cases, surface_cases, chain_cases),
    "life": (life_cases,),
    "scenes": (scene_cases,),
    "stiff": (stiff_cases,),
    "guard": (guard_cases,),
}


def chosen_cases(groups: Sequence[Group], only: str = "") -> list[Case]:
    """The cases of the groups, each once, whose names contain the text."""
    chosen = [makers for group, makers in GROUPS.items() if group in groups]
    return [case for makers in chosen for make in makers for case in make() if only in case.id]
