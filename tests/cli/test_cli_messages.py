"""The texts of mistakes: one line each, that says what was given, what was expected and what to do."""

from pathlib import Path

import pytest

from sculpt_framework.cli.train import main
from sculpt_framework.command_line.request import parse, read_request
from sculpt_framework.errors import SculptError
from sculpt_plugins import builtin

METHODS = ", ".join(builtin.METHODS)
BUILT_IN = "mlp, hash-grid, dense-grid, fancy, plain"

MISTAKES = {
    "fake": "--data is missing: give a folder, as in --data DIR, or --data demo.",
    "fkae --data x": (f"there is no method 'fkae'. Did you mean 'fake'? Available: {METHODS}, fake."),
    "--data x fake": (f"sculpt-train starts with a method, not with --data. Methods: {METHODS}, fake."),
    "": (
        "sculpt-train starts with a method, as in sculpt-train gaussian-sculpting --data demo. Methods: "
        f"{METHODS}, fake."
    ),
    "fake --data x --field fncy": (
        f"--field fncy: there is no field 'fncy'. Did you mean 'fancy'? Available: {BUILT_IN}."
    ),
    "fake --data x --field": f"--field expects a name. Available: {BUILT_IN}.",
    "fake --data x --field= --seed 1": f"--field expects a name. Available: {BUILT_IN}.",
    "fake --data x --field plain --field fancy": "--field is given twice. Give it once.",
    "fake --data x --losses outline --losses likeness": "--losses is given twice. Give it once, with all names.",
    "fake --data x --losses outline outline": "--losses outline outline: 'outline' is named twice.",
    "fake --data x --losses none outline": "--losses none outline: 'none' stands alone, for an empty list.",
    "fake --data x --constraints": (
        "--constraints expects names. Available: mee-scale, boundary, spacing, coverage, even, tight, none."
    ),
    "fake --data x --field.num-levels 8": (
        "--field.num-levels belongs to field 'hash-grid' and 'fancy', but this run uses 'plain'. "
        "Add --field hash-grid or --field fancy."
    ),
    "fake --data x --field.octaves 8": (
        "--field.octaves belongs to field 'fancy', but this run uses 'plain'. Add --field fancy."
    ),
    "fake --data x --field.no-coarse_to_fine": (
        "--field.coarse-to-fine belongs to field 'fancy', but this run uses 'plain'. Add --field fancy."
    ),
    "fake --data x --constraints.even.weight=2": (
        "--constraints.even.weight belongs to constraint 'even', which this run does not use. "
        "Add --constraints tight even."
    ),
    "fake --data x --trainer.base-cell 3": (
        "there is no option --trainer.base-cell. Did you mean --trainer.base-cells? --help-all lists them all."
    ),
    "fake --data x --losses.outline.wieght=3": (
        "there is no option --losses.outline.wieght. Did you mean --losses.outline.weight? --help-all lists them all."
    ),
    "fake --data x --xyzzy 3": "there is no option --xyzzy. --help-all lists them all.",
    "fake --data x y": "'y' belongs to no option. Options start with two dashes; --help-all lists them.",
    "fake --data x --max-time -3": "--max-time is -3.0; expected seconds above 0.",
    "fake --data x --max-time 0": "--max-time is 0.0; expected seconds above 0.",
    "fake --data x --max-time nan": "--max-time is nan; expected a finite number.",
    "fake --data x --max-time inf": "--max-time is inf; expected a finite number.",
    "fake --data x --seed -1": "--seed is -1; expected 0 or more, below 2^63.",
    "fake --data x --threads 0": "--threads is 0; expected 1 or more.",
    "fake --data x --losses.outline.weight nan": "--losses.outline.weight is nan; expected a finite number.",
    "fake --data x --field fancy --field.num-levels 0": "--field.num-levels is 0; expected 1 or more.",
    "fake --data x --field fancy --field.octaves 1 0": "--field.octaves.1 is 0.0; expected above 0.",
    "fake --data x --field fancy --field.limit -1": "--field.limit is -1.0; expected 0 or more.",
    "fake --data x --losses.outline.weight -1": "--losses.outline.weight is -1.0; expected 0 or more.",
    "fake --data x --trainer.stages.1.share 0": "--trainer.stages.1.share is 0.0; expected above 0.",
    "fake --data x --trainer.final-rate 2": "--trainer.final-rate is 2.0; expected above 0, at most 1.",
    "fake --data x --reference no.ply": "--reference no.ply is not a file. Give a mesh: .ply, .obj, .glb or .stl.",
    "--resume": "--resume expects a run directory, as in --resume outputs/SCENE/METHOD/TIME.",
}


@pytest.mark.usefixtures("fake")
@pytest.mark.parametrize("words", MISTAKES)
def test_the_message(words: str):
    with pytest.raises(SculptError) as caught:
        read_request(words.split())
    assert str(caught.value) == MISTAKES[words]


@pytest.mark.usefixtures("fake")
@pytest.mark.parametrize("words", ["--max-time soon", "--seed", "--seed 1.5", "--device tpu", "--trainer.base-cells x"])
def test_values_of_a_wrong_type_are_answered_by_tyro_with_exit_code_2(words: str, capsys: pytest.CaptureFixture[str]):
    with pytest.raises(SystemExit) as caught:
        parse(["fake", "--data", "x", *words.split()])
    assert caught.value.code == 2
    assert words.split()[0] in capsys.readouterr().err


@pytest.mark.usefixtures("fake")
def test_main_prints_one_line_and_exits_with_2(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.setattr("sys.argv", ["sculpt-train", "fake", "--data", "x", "--max-time", "-3"])
    with pytest.raises(SystemExit) as caught:
        main()
    assert caught.value.code == 2
    assert capsys.readouterr() == ("", "error: --max-time is -3.0; expected seconds above 0.\n")


@pytest.mark.usefixtures("fake")
def test_an_output_that_cannot_be_used_is_told_before_anything_else(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
):
    (tmp_path / "precious.txt").write_text("x", encoding="utf-8")
    monkeypatch.setattr("sys.argv", ["sculpt-train", "fake", "--data", "x", "--output", str(tmp_path)])
    with pytest.raises(SystemExit) as caught:
        main()
    assert caught.value.code == 2
    assert capsys.readouterr().err.startswith(f"error: --output {tmp_path} is not empty. Give a new folder, or")
    assert [path.name for path in tmp_path.iterdir() if path.is_file()] == ["precious.txt"]
