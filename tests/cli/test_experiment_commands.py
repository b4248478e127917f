"""``sculpt-ablate`` and ``sculpt-bench suite`` as a user calls them; what they start is a stand-in for sculpt-train."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from sculpt_framework.cli.ablate import ablate, main, split_extra
from sculpt_framework.cli.bench import bench
from sculpt_framework.errors import ConfigError, SculptError, TrainingFailed

FAKE = (sys.executable, "-S", str(Path(__file__).parents[1] / "experiments" / "fake_train.py"))
HEAVY = ("torch", "viser", "trimesh", "cv2", "numpy", "scipy", "numba")
TWO = ("--factors", "isolation", "--scenes", "demo:dents", "--equal", "steps")


@pytest.fixture(autouse=True)
def place(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    monkeypatch.setattr("sculpt_framework.experiments.runner.TRAIN", FAKE)
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setenv("NO_COLOR", "1")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("words", ["ablate --help", "bench suite --help", "bench --help"])
def test_help_imports_nothing_heavy(words: str):
    module, *rest = words.split()
    script = (
        f"import sys\nsys.argv = ['sculpt', *{rest!r}]\n"
        f"from sculpt_framework.cli.{module} import main\n"
        "try:\n    main()\n"
        f"finally:\n    sys.stderr.write(','.join(sorted(set({HEAVY!r}) & set(sys.modules))))"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False, encoding="utf-8"
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert "usage: sculpt-" in done.stdout


def test_an_ablation_from_words_to_tables(place: Path, capsys: pytest.CaptureFixture[str]):
    words = [*TWO, "--budget", "9", "--seeds", "0", "1", "10", "--out", "out", "--", "--threads", "1"]
    ablate(words)
    text = capsys.readouterr().out
    assert "[6/6] dents/9steps/no-isolation/seed-10: failed: the data are no good" in text
    assert re.search(r"\[1/6\] dents/9steps/default/seed-0: Chamfer 0\.01000, 30\.00 dB \(\d+ s\)", text)
    page = (place / "out" / "tables.md").read_text(encoding="utf-8")
    assert page.startswith("# Ablation of gaussian-sculpting\n\n    sculpt-ablate --factors isolation")
    # Medians of two results that differ by a percent and a failure: the worse of the two.
    assert "| default | yes | yes | yes | 1.010 [1.000 to failed] (1 of 3 failed) | 1.00 | 1.16 | 1.00 |" in page
    assert "| no-isolation | yes | yes | yes | 5.050 [5.000 to failed] (1 of 3 failed) | 5.00 | – | – |" in page
    assert (place / "out" / "results.csv").read_text(encoding="utf-8").count("\n") == 7
    lines = (place / "out" / "started.txt").read_text(encoding="utf-8").splitlines()
    assert len(lines) == 7, "a warm-up and six runs"
    assert all(" --threads 1 " in line for line in lines)

    ablate(words)
    again = capsys.readouterr().out
    assert "6 of 6 runs were done before, 2 of them failed (--retry-failed runs those again)." in again
    assert len((place / "out" / "started.txt").read_text(encoding="utf-8").splitlines()) == 7


def test_show_runs_nothing(place: Path, capsys: pytest.CaptureFixture[str]):
    show = [*TWO, "--out", "out", "--show"]
    with pytest.raises(ConfigError, match="there is no experiment in out"):
        ablate(show)
    (place / "out").mkdir()
    with pytest.raises(ConfigError, match="there is no experiment in out"):
        ablate(show)
    assert list((place / "out").iterdir()) == []
    ablate([*TWO, "--out", "out", "--scenes", "demo:blob"])
    tables, started = ((place / "out" / name).read_text(encoding="utf-8") for name in ("tables.md", "started.txt"))
    for other in (show, [*TWO, "--scenes", "demo:blob", "--out", "out", "--show", "--", "--threads", "1"]):
        with pytest.raises(ConfigError, match="out holds another experiment"):
            ablate(other)
    assert (place / "out" / "tables.md").read_text(encoding="utf-8") == tables
    ablate([*show, "--scenes", "demo:dents", "demo:blob"])
    assert "| default | yes | yes | yes | – | 1.000 |" in (place / "out" / "tables.md").read_text(encoding="utf-8")
    assert (place / "out" / "started.txt").read_text(encoding="utf-8") == started


def test_a_suite_from_words_to_tables(place: Path, capsys: pytest.CaptureFixture[str]):
    for name in ("chair", "mic"):
        (place / "nerf" / name).mkdir(parents=True)
        (place / "nerf" / name / "transforms_train.json").touch()
    bench(["suite", "blender", "nerf", "--max-time", "20"])
    text = capsys.readouterr().out
    folder = place / "outputs" / "suite-blender"
    page = (folder / "tables.md").read_text(encoding="utf-8")
    assert "| gaussian-sculpting | 1.00 | – | – | – | 1.00 | 1.00 | 1.00 | 0 | – |" in page
    assert "| Ours 128 | 0.71 | 1.76 | 1.29 | 0.93 | 1.12 | 1.16 | 1.12 | 0 | 3 |" in page
    assert "not in the folder: hotdog, lego, drums." in text
    started = (folder / "started.txt").read_text(encoding="utf-8").splitlines()[-1]
    assert started.startswith(f"gaussian-sculpting --data {place / 'nerf' / 'mic'} --max-time 20 --seed 0 --output ")


def test_a_suite_at_equal_seconds_and_at_each_method_s_own_length(place: Path):
    words = ["suite", "demo", "--objects", "dents", "--methods", "gaussian-sculpting", "neus", "--own-length"]
    with pytest.raises(ConfigError, match="--own-length is for runs beside those of --max-time or --steps"):
        bench(words)
    bench([*words, "--max-time", "20"])
    folder = place / "outputs" / "suite-demo"
    timed = [
        " --max-time 20 " in line for line in (folder / "started.txt").read_text(encoding="utf-8").splitlines()[1:]
    ]
    assert timed == [True, True, False, False]
    tables, page = (
        (folder / "tables.md").read_text(encoding="utf-8"),
        (folder / "report.html").read_text(encoding="utf-8"),
    )
    methods, lengths = ("gaussian-sculpting", "neus"), ("20 s", "its own length")
    for name in (f"{method}, {length}" for method in methods for length in lengths):
        assert f"\n| {name} |" in tables
        assert page.count(name) > 2, "two tables, and beside its curve"
    assert "<svg" in page


def test_when_everything_fails_the_command_does(capsys: pytest.CaptureFixture[str]):
    with pytest.raises(TrainingFailed, match="all 2 runs failed; the first said: the data are no good"):
        ablate([*TWO, "--seeds", "10", "--out", "out"])


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("--equal seconds steps --budget 3", "--budget has 1 numbers for --equal seconds steps; expected one for each"),
        ("--equal steps --budget 2.5", "expected whole steps above 0"),
        ("--budget 0", "expected seconds above 0"),
        ("--budget nan", "expected seconds above 0"),
        ("--seeds 1 1", "--seeds 1 1: expected numbers from 0 upwards, each once"),
        ("--jobs 0", "--jobs is 0; expected 1 or more"),
        ("--factors field field", "each once"),
        ("--scenes nowhere", "scene nowhere: no such folder"),
        ("-- --max-time 3", "--max-time cannot be given after --"),
        ("-- --fieldd mlp", "default: there is no option --fieldd"),
        ("--method nothing", "there is no method 'nothing'"),
    ],
)
def test_mistakes_cost_nothing(words: str, message: str, place: Path):
    with pytest.raises(SculptError, match=re.escape(message)):
        ablate(words.split())
    assert not (place / "outputs").exists()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("blender", "the suite blender needs the folder of the data"),
        ("demo --methods a a", "each once"),
        ("demo --max-time 3 --steps 4", "expected one of the two"),
        ("demo --max-time inf", "expected seconds above 0"),
        ("demo --steps 0", "expected 1 or more"),
        ("demo --methods gaussian-sculpting nothing", "there is no method 'nothing'"),
    ],
)
def test_mistakes_of_a_suite(words: str, message: str, place: Path):
    with pytest.raises(SculptError, match=re.escape(message)):
        bench(["suite", *words.split()])
    assert not (place / "outputs").exists()


def test_main_ends_with_one_line(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]):
    monkeypatch.setattr("sys.argv", ["sculpt-ablate", "--jobs", "0"])
    with pytest.raises(SystemExit) as caught:
        main()
    assert caught.value.code == 2
    assert capsys.readouterr() == ("", "error: --jobs is 0; expected 1 or more.\n")


def test_words_after_two_dashes():
    assert split_extra(["--jobs", "1", "--", "--field", "mlp", "--", "x"]) == (
        ["--jobs", "1"],
        ["--field", "mlp", "--", "x"],
    )
    assert split_extra(["--jobs"]) == (["--jobs"], [])
