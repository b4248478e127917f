"""docs/guide/writing-a-plugin.md, tried: its files are written, installed by pip into a folder, and used from there."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from sculpt_framework.demo_scenes.folder import DemoSettings, write_scene
from sculpt_framework.demo_scenes.objects import demo_object

GUIDE = Path(__file__).parents[2] / "docs" / "guide" / "writing-a-plugin.md"


def guide_files() -> dict[str, str]:
    """The files of the guide by path: a line with the path in backticks, then a block."""
    pattern = r"^`([\w/.]+)`\n\n```\w+\n(.*?)^```$"
    return dict(re.findall(pattern, GUIDE.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL))


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An import folder that pip has installed the guide's package into."""
    source, target = tmp_path_factory.mktemp("sculpt-siren"), tmp_path_factory.mktemp("site")
    for name, content in guide_files().items():
        (source / name).parent.mkdir(exist_ok=True)
        (source / name).write_text(content, encoding="utf-8")
    options = ["--no-deps", "--no-build-isolation", "--no-index", "--quiet", "--disable-pip-version-check"]
    pip = [sys.executable, "-m", "pip", "install", *options, "--target", str(target), str(source)]
    done = subprocess.run(pip, capture_output=True, text=True, timeout=120, check=False, encoding="utf-8")
    assert done.returncode == 0, done.stderr
    return target


def sculpt_train(words: str, path: Path, folder: Path) -> subprocess.CompletedProcess[str]:
    script = "from sculpt_framework.cli.train import main; main()"
    # What is on the path already stays: it says which checkout is tested.
    paths = os.pathsep.join([str(path), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)
    changes = {"PYTHONPATH": paths, "COLUMNS": "100", "NO_COLOR": "1"}
    command = [sys.executable, "-c", script, *words.split()]
    return subprocess.run(
        command,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        env=os.environ | changes,
        cwd=folder,
        encoding="utf-8",
    )


def test_the_guide_lists_its_files():
    tree = GUIDE.read_text(encoding="utf-8").partition("    sculpt-siren/\n")[2].partition("\n\n")[0]
    listed = set(tree.split())
    assert set(guide_files()) == listed


def test_its_method_is_listed_with_its_docstring(installed: Path, tmp_path: Path):
    done = sculpt_train("--help", installed, tmp_path)
    assert re.search(r"siren-sculpting +The tiny method with a field of sine waves\.\n", done.stdout)


def test_its_field_is_offered_with_its_options(installed: Path, tmp_path: Path):
    done = sculpt_train("gaussian-sculpting --field siren --help", installed, tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert "--field {mlp,hash-grid,dense-grid,siren}" in done.stdout
    assert "Frequency of the first layer, in radians per object unit. (default: 6.0)" in done.stdout


def test_its_option_without_it_is_answered_with_the_flag_to_add(installed: Path, tmp_path: Path):
    done = sculpt_train("gaussian-sculpting --data demo --field.frequency 10", installed, tmp_path)
    assert done.returncode == 2
    assert done.stderr == (
        "error: --field.frequency belongs to field 'siren', but this run uses 'hash-grid'. Add --field siren.\n"
    )


def test_its_ranges_are_checked(installed: Path, tmp_path: Path):
    done = sculpt_train("siren-sculpting --data demo --field.frequency 0", installed, tmp_path)
    assert (done.returncode, done.stderr) == (2, "error: --field.frequency is 0.0; expected above 0.\n")


@pytest.mark.slow
def test_it_trains(installed: Path, tmp_path: Path):
    settings = DemoSettings(train_views=12, test_views=1, resolution=48, reference_cells=16)
    write_scene(demo_object("blob"), settings, tmp_path / "scene")
    (tmp_path / "scene" / "gt_mesh.ply").unlink()  # measuring against it takes longer than the rest
    short = "--steps 2 --trainer.fit-steps 100 --trainer.polish-steps 1 --trainer.base-cells 10"
    done = sculpt_train(
        f"siren-sculpting --data scene --output run --rasterizer reference {short}", installed, tmp_path
    )
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "run" / "mesh.ply").stat().st_size > 1000
    assert '"type": "siren"' in (tmp_path / "run" / "config.json").read_text(encoding="utf-8")


def test_a_broken_copy_disturbs_nothing_until_it_is_chosen(installed: Path, tmp_path: Path):
    broken = tmp_path / "site"
    shutil.copytree(installed, broken)
    (broken / "sculpt_siren" / "config.py").write_text("import sculpt_no_such_library\n", encoding="utf-8")

    overview = sculpt_train("--help", broken, tmp_path)
    assert re.search(r"siren-sculpting +\(not available: No module named 'sculpt_no_such_library'\)", overview.stdout)
    other = sculpt_train("gaussian-sculpting --help", broken, tmp_path)
    assert (other.returncode, other.stderr) == (0, "")

    chosen = sculpt_train("gaussian-sculpting --data demo --field siren", broken, tmp_path)
    assert chosen.returncode == 2
    assert chosen.stderr.startswith(
        "error: field 'siren' of package 'sculpt-siren' cannot be imported from 'sculpt_siren.config:SirenFieldConfig' "
        "(ModuleNotFoundError: No module named 'sculpt_no_such_library')."
    )
    assert chosen.stderr.count("\n") == 1
