"""The suite's own cases that take no training, and what the suite promises about itself."""

import json
import math
from dataclasses import replace

import pytest

from sculpt_framework.cli.stress import stress
from sculpt_framework.stress import chain, faces, splats, surfaces
from sculpt_framework.stress.cases import Case, Measured, run_cases
from sculpt_framework.stress.stiff import BOUND, curves, safe_range, standard
from sculpt_framework.stress.suite import GROUPS, chosen_cases


@pytest.mark.parametrize(
    "module",
    [pytest.param(faces.face_cases, marks=pytest.mark.slow), splats.splat_cases, surfaces.surface_cases],
)
def test_operators_are_within_their_limits(module):
    results = list(run_cases(module()))
    assert [(result.id, result.measured, result.note) for result in results if not result.ok] == []
    assert all(result.float32_error is not None for result in results)


@pytest.mark.parametrize("case", list(chain.chain_cases()), ids=lambda case: case.id)
def test_the_whole_chain(case: Case):
    (result,) = run_cases([case])
    assert result.ok, (result.measured, result.note)


def test_gradients_of_the_chain_are_not_zero():
    import torch

    from sculpt_framework import registry

    found = chain.walk(registry.load_method("gaussian-sculpting")(), "hash-grid", torch.float32)
    assert all(float(slopes.norm()) > 1e-6 for slopes in found.gradients.values())


def test_cases_have_distinct_names_and_say_what_they_do():
    cases = chosen_cases(tuple(GROUPS))
    names = [case.id for case in cases]
    assert len(set(names)) == len(names)
    assert len(names) > 200
    assert all(case.done and case.expected and case.unit for case in cases)
    assert all(case.group in GROUPS for case in cases)


@pytest.mark.parametrize(
    ("value", "limit", "at_least", "ok"),
    [(1.0, 2.0, False, True), (3.0, 2.0, False, False), (3.0, 2.0, True, True), (1.0, 2.0, True, False)],
)
def test_limits(value: float, limit: float, at_least: bool, ok: bool):
    case = _case(lambda: Measured(value=value), limit=limit, at_least=at_least)
    (result,) = run_cases([case])
    assert result.ok == ok


def test_what_is_not_finite_or_raises_has_failed():
    def fails() -> Measured:
        raise IndexError("one\ntwo")

    results = list(
        run_cases([_case(lambda: Measured(value=math.nan)), _case(fails), _case(lambda: Measured(value=0.0))])
    )
    assert [result.ok for result in results] == [False, False, True]
    assert results[1].note == "raised IndexError: one"


def _case(measure, limit: float = 1.0, at_least: bool = False) -> Case:
    return Case(id="x", group="life", done="", expected="", unit="", limit=limit, measure=measure, at_least=at_least)


def test_the_safe_range_is_the_longest_stretch():
    points = [(0.01, 1.0), (0.1, 9.0), (1.0, 1.05), (10.0, 1.0), (100.0, 1.02), (1000.0, math.inf)]
    assert safe_range(points, 1.0) == (1.0, 100.0)
    assert safe_range([(1.0, 5.0), (10.0, 1.0)], 1.0) == (10.0, 10.0)
    assert safe_range([(1.0, math.nan), (10.0, 1.0), (100.0, 1.0)], 1.0) == (10.0, 100.0)


def test_every_weight_of_the_method_has_a_curve():
    from sculpt_framework import registry

    method = registry.load_method("gaussian-sculpting")()
    terms = {registry.name_of(part) for part in (*method.losses, *method.constraints)} - {"photometric", "silhouette"}
    assert {f"weight-{name}" for name in terms} <= {curve.name for curve in curves()}


def test_the_bounded_curve_bounds_steps_and_nothing_else():
    plain, bounded = (next(each for each in curves() if each.name == f"rate-field{end}") for end in ("", "-bounded"))
    assert set(plain.factors) < set(bounded.factors)
    free, held = plain.change(standard(), 10.0), bounded.change(standard(), 10.0)
    assert held.field == free.field != standard().field
    assert replace(held, trainer=replace(held.trainer, trust_cells=free.trainer.trust_cells)) == free
    assert held.trainer.trust_cells == BOUND != free.trainer.trust_cells


def test_the_command_prints_json(capsys: pytest.CaptureFixture[str]):
    stress(["--group", "operators", "--only", "crossing-", "--json"])
    cases = json.loads(capsys.readouterr().out)["cases"]
    assert len(cases) == 6
    required = {"id", "group", "expected", "measured", "unit", "limit", "ok", "seconds"}
    assert all(required <= set(case) for case in cases)


def test_the_command_ends_with_one_for_a_failure(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    failing = _case(lambda: Measured(value=2.0, note="too much"))
    monkeypatch.setattr("sculpt_framework.stress.suite.chosen_cases", lambda groups, only: [failing])
    with pytest.raises(SystemExit) as ended:
        stress([])
    assert ended.value.code == 1
    said = capsys.readouterr()
    assert "too much" in said.out
    assert said.err.count("\n") == 1


def test_a_name_nobody_has_is_one_line():
    from sculpt_framework.errors import ConfigError

    with pytest.raises(ConfigError, match="no case of life has that"):
        stress(["--group", "life", "--only", "nothing-like-it"])
