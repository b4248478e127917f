"""Whatever bytes a file holds, reading it succeeds or raises one typed error of one line, soon."""

import contextlib
import io
import random
import re
import shutil
import sys
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest
from fuzzing import Target, answered_soon, is_one_line, mutated, outcome
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from sculpt_framework.cli import exit_codes
from sculpt_framework.cli.evaluate import evaluate
from sculpt_framework.cli.export import export
from sculpt_framework.command_line.request import read_request
from sculpt_framework.errors import SculptError

FILES = (
    "mesh.ply",
    "gaussians.ply",
    "latest.safetensors",
    "config.json",
    "picture.png",
    "curve.csv",
    "transforms_train.json",
    "train/r_0.png",
)
IN_PROCESS = 5000
THROUGH_COMMANDS = 100
JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=12,
)


def answered(target: Target, seeds: range) -> Counter[str]:
    """How often each outcome; the file is put back."""
    try:
        return Counter(outcome(target, seed) for seed in seeds)
    finally:
        target.path.write_bytes(target.original)


@pytest.mark.parametrize("name", FILES)
def test_a_few_mutations(targets: dict[str, Target], name: str):
    counts = answered(targets[name], range(25))
    assert counts.total() == 25
    assert counts["refused"] > 0


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_five_thousand_mutations(targets: dict[str, Target], name: str):
    each = -(-IN_PROCESS // len(FILES))
    assert answered(targets[name], range(1000, 1000 + each)).total() == each


@pytest.mark.parametrize("key", ["field", "trainer", "losses", "seed", "max_time", "data", "refine_box"])
@given(value=JSON)
@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_any_value_in_a_config(key: str, value: object):
    from sculpt_framework import registry
    from sculpt_framework.serialization import config_from_values, config_to_values
    from sculpt_framework.validation import check

    values = config_to_values(registry.load_method("gaussian-sculpting")())
    try:
        check(config_from_values({**values, key: value}))
    except SculptError as error:
        if not is_one_line(error):
            raise


# -- through the commands ------------------------------------------------------------------------------------------


def ended(main: Callable[[], object]) -> tuple[int, str]:
    """Exit code and stderr of a command; what is no clean end comes through."""

    def run() -> None:
        main()

    said = io.StringIO()
    with contextlib.redirect_stderr(said), contextlib.redirect_stdout(io.StringIO()), answered_soon():
        try:
            exit_codes.run(run)
        except SystemExit as exit_:
            code = exit_.code if isinstance(exit_.code, int) else 1
            return code, said.getvalue()
    return 0, said.getvalue()


@pytest.fixture
def run_dir(targets: dict[str, Target], tmp_path: Path) -> Path:
    """What a finished run leaves, as far as commands read it."""
    for name in ("mesh.ply", "gaussians.ply", "config.json", "curve.csv"):
        (tmp_path / name).write_bytes(targets[name].original)
    (tmp_path / "checkpoints").mkdir()
    shutil.copy(targets["latest.safetensors"].path, tmp_path / "checkpoints" / "latest.safetensors")
    return tmp_path


def test_commands_answer_bad_files(run_dir: Path):
    commands: dict[str, Callable[[], object]] = {
        "mesh.ply": lambda: evaluate(["--mesh", str(run_dir / "mesh.ply"), "--samples", "50"]),
        "config.json": lambda: read_request(["--resume", str(run_dir)]),
        "gaussians.ply": lambda: export([str(run_dir), "--format", "gaussians", "--out", str(run_dir / "out.ply")]),
    }
    exports = ("obj", "glb")
    chance, codes = random.Random(0), Counter[int]()
    for seed in range(THROUGH_COMMANDS):
        name = chance.choice([*commands, *exports])
        file = run_dir / ("mesh.ply" if name in exports else name)
        original = file.read_bytes()
        file.write_bytes(mutated(original, seed))
        command = commands.get(name) or (lambda kind=name: export([str(run_dir), "--format", kind]))
        code, said = ended(command)
        file.write_bytes(original)
        codes[code] += 1
        assert code in (0, 2), (name, seed, said)
        assert said.count("\n") == (1 if code else 0), (name, seed, said)
        assert "Traceback" not in said
    assert codes[2] > 10
    assert codes.total() == THROUGH_COMMANDS


@pytest.mark.parametrize("path", ["../../secret", "/etc/hostname", "..\\..\\secret", "C:/x", "a/../../../b", "a\0b"])
def test_paths_in_transforms_stay_in_the_folder(targets: dict[str, Target], path: str):
    import json

    target = targets["transforms_train.json"]
    document = json.loads(target.original)
    document["frames"][0]["file_path"] = path
    target.path.write_text(json.dumps(document), encoding="utf-8")
    try:
        with pytest.raises(SculptError, match=r"1 of \d+ images are not there .*in .* alone"):
            target.read()
    finally:
        target.path.write_bytes(target.original)


def test_nothing_of_ours_reads_pickle():
    root = Path(sys.modules["sculpt_framework"].__file__ or "").parents[1]
    sources = [path for top in ("sculpt_framework", "plugins", "method_configs") for path in (root / top).rglob("*.py")]
    assert len(sources) > 100
    lines = [line for path in sources for line in path.read_text(encoding="utf-8").splitlines()]
    readers = re.compile(r"import pickle|torch\.load\((?!.*weights_only=True)|allow_pickle=True|yaml\.load\(")
    assert not [line for line in lines if readers.search(line)]
