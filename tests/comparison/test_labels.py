"""Runs are found, read and told apart by what differs in their configurations."""

from pathlib import Path
from typing import Any

import pytest
from written_runs import CONFIG, row, write_run

from sculpt_framework.comparison.labels import read_runs
from sculpt_framework.errors import DataError

ROWS = [row(1.0, 0.1)]


def changed(slot: str, **values: Any) -> dict[str, Any]:
    return {slot: {**CONFIG[slot], **values}}


def methods(*folders: Path | str) -> list[str]:
    return [run.method for run in read_runs([str(folder) for folder in folders])]


def test_seeds_and_places_are_no_other_method(tmp_path: Path):
    write_run(tmp_path / "a", ROWS)
    write_run(tmp_path / "b", ROWS, config={"seed": 7, "data": "elsewhere", "output": "x", "threads": 4})
    assert methods(tmp_path / "a", tmp_path / "b") == ["sculpting", "sculpting"]


def test_a_swapped_component_is_named_alone(tmp_path: Path):
    """Its options differ too, which says nothing more."""
    write_run(tmp_path / "a", ROWS)
    write_run(tmp_path / "b", ROWS, config={"field": {"type": "mlp", "units": 64}})
    write_run(tmp_path / "c", ROWS, config={"extractor": {"type": "tetrahedra"}})
    assert methods(tmp_path) == ["hash-grid, flexicubes", "mlp, flexicubes", "hash-grid, tetrahedra"]


def test_an_option_is_named_with_its_value(tmp_path: Path):
    write_run(tmp_path / "a", ROWS)
    write_run(tmp_path / "b", ROWS, config=changed("trainer", warm_start=False))
    write_run(tmp_path / "c", ROWS, config={**CONFIG, "steps": 9})
    assert methods(tmp_path) == [
        "steps 4, warm-start on",
        "steps 4, warm-start off",
        "steps 9, warm-start on",
    ]


def test_a_term_more_or_less(tmp_path: Path):
    write_run(tmp_path / "a", ROWS)
    more = {"losses": [{"type": "eikonal", "weight": 0.1}, *CONFIG["losses"]]}
    write_run(tmp_path / "b", ROWS, config=more)
    assert methods(tmp_path) == ["without eikonal", "with eikonal"]


def test_with_other_methods_beside_it_the_name_stays(tmp_path: Path):
    write_run(tmp_path / "a", ROWS)
    write_run(tmp_path / "b", ROWS, config={"field": {"type": "mlp"}})
    write_run(tmp_path / "c", ROWS, config={"method": "paper"})
    assert methods(tmp_path) == ["sculpting (hash-grid)", "sculpting (mlp)", "paper"]


def test_many_differences_are_counted(tmp_path: Path):
    for index in range(3):
        settings = {name: index for name in ("p", "q", "r", "s")}
        write_run(tmp_path / str(index), ROWS, config={"trainer": settings})
    assert methods(tmp_path)[1] == "variant 2: p 1, q 1, r 1, ..."
    assert len(set(methods(tmp_path))) == 3


def test_many_differences_may_hold_lists(tmp_path: Path):
    for index in range(2):
        settings = {"p": index, "q": [index, 1], "r": index, "s": {"levels": [index]}}
        write_run(tmp_path / str(index), ROWS, config={"trainer": settings})
    assert methods(tmp_path) == ["variant 1: p 0, q [0, 1], r 0, ...", "variant 2: p 1, q [1, 1], r 1, ..."]


def test_a_label_is_a_method_and_may_hold_several_seeds(tmp_path: Path):
    write_run(tmp_path / "a" / "0", ROWS)
    write_run(tmp_path / "a" / "1", ROWS, config={"seed": 1, "field": {"type": "mlp"}})
    write_run(tmp_path / "b=c", ROWS)
    assert methods(f"mine={tmp_path / 'a'}", str(tmp_path / "b=c")) == ["mine", "mine", "sculpting"]


def test_every_run_has_a_name_of_its_own(tmp_path: Path):
    for path in ("x/one", "y/one", "y/two"):
        write_run(tmp_path / path, ROWS)
    assert [run.name for run in read_runs([str(tmp_path)])] == ["x/one", "y/one", "two"]


def test_a_run_given_twice_counts_once(tmp_path: Path):
    write_run(tmp_path / "a", ROWS)
    assert len(read_runs([str(tmp_path), str(tmp_path / "a")])) == 1


@pytest.mark.parametrize(
    ("word", "message"),
    [("nowhere", "no such folder"), ("empty", "no run in it"), ("=x", r"expected RUN_DIR or LABEL=RUN_DIR")],
)
def test_where_there_is_no_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, word: str, message: str):
    (tmp_path / "empty").mkdir()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(DataError, match=message):
        read_runs([word])


def test_what_was_set_aside_is_no_run(tmp_path: Path):
    write_run(tmp_path / "runs" / "jar" / "seed-0", ROWS)
    write_run(tmp_path / "runs" / "jar" / "seed-0.aside-1", ROWS, status="stopped")
    assert [run.folder for run in read_runs([str(tmp_path)])] == [tmp_path / "runs" / "jar" / "seed-0"]
    # Unless it is asked for.
    assert len(read_runs([str(tmp_path / "runs" / "jar" / "seed-0.aside-1")])) == 1
