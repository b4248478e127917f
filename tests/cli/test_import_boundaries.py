"""Who may import whom, read off the source and tried in a fresh interpreter."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from sculpt_framework.registry import load_method
from sculpt_plugins.builtin import BUILTIN, EXPORTERS
from sculpt_plugins.builtin import METHODS as METHOD_TABLE

REGISTERED = [value for table in (*BUILTIN.values(), EXPORTERS) for value in table.values()]
ROOT = Path(__file__).parents[2]
FRAMEWORK = ROOT / "sculpt_framework"
PLUGINS = ROOT / "plugins" / "sculpt_plugins"
METHODS = ROOT / "method_configs" / "sculpt_methods"
TOPS = (FRAMEWORK, PLUGINS, METHODS)
HEAVY = ("torch", "viser", "trimesh", "cv2", "numpy", "scipy", "numba")
SLOT_FOLDERS = sorted(path.name for path in PLUGINS.iterdir() if (path / "__init__.py").exists())

# To choose among its slot's plug-ins is what "auto" is for; a demo scene is a folder in the layout of "blender". They
# may name their neighbours, by their configs.
NAME_NEIGHBOURS = {("rasterizers", "auto"), ("datasets", "auto"), ("datasets", "demo")}


def imports(path: Path) -> Iterator[tuple[int, str]]:
    """Line and absolute module name of every import statement in a file, also those inside functions."""
    package = next(path.relative_to(top.parent).parent.parts for top in TOPS if path.is_relative_to(top))
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else ()
            module = ".".join((*above, *((node.module,) if node.module else ())))
            yield node.lineno, module
            yield from ((node.lineno, f"{module}.{alias.name}") for alias in node.names)


def offences(folder: Path, *forbidden: str, allowed: tuple[str, ...] = ()) -> list[str]:
    return [
        f"{path.relative_to(ROOT)}:{line} imports {name}"
        for path in sorted(folder.rglob("*.py"))
        for line, name in imports(path)
        if any(name == each or name.startswith(f"{each}.") for each in forbidden)
        and not any(name == each or name.startswith(f"{each}.") for each in allowed)
    ]


def loaded(statement: str) -> set[str]:
    """Modules there are in a fresh interpreter after ``statement``."""
    script = f"{statement}\nimport sys\nprint(*sys.modules)"
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False, encoding="utf-8"
    )
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split())


@pytest.mark.parametrize(
    "module",
    ["cli.train", "cli.exit_codes", "cli.report", "cli.export", "command_line.request", "command_line.options"],
)
def test_the_command_line_imports_nothing_heavy(module: str):
    assert not loaded(f"import sculpt_framework.{module}") & set(HEAVY)


def test_no_config_module_imports_anything_heavy():
    modules = sorted({value.partition(":")[0] for value in REGISTERED})
    assert not loaded("\n".join(f"import {module}" for module in modules)) & set(HEAVY)


def test_no_method_imports_anything_heavy():
    modules = [f"sculpt_methods.{path.stem}" for path in METHODS.glob("*.py") if path.stem != "__init__"]
    assert not loaded("\n".join(f"import {module}" for module in modules)) & set(HEAVY)


def test_methods_share_the_framework_alone():
    for path in sorted((PLUGINS / "methods").iterdir()):
        if path.is_dir():
            assert not offences(path, "sculpt_plugins", allowed=(f"sculpt_plugins.methods.{path.name}",))


def test_the_framework_names_no_plug_in_but_for_the_table():
    table = ("sculpt_plugins.builtin",)
    assert not offences(FRAMEWORK, "sculpt_plugins", "sculpt_methods", allowed=table)
    naming = [path.name for path in FRAMEWORK.rglob("*.py") if any(n.startswith(table) for _, n in imports(path))]
    assert naming == ["registry.py"]


@pytest.mark.parametrize("folder", ["geometry", "rendering", "encodings"])
def test_pure_functions_know_nothing_of_the_engine(folder: str):
    above = ("engine", "command_line", "registry", "config", "evaluation", "observers")
    assert not offences(FRAMEWORK / folder, *(f"sculpt_framework.{name}" for name in above))


@pytest.mark.parametrize("folder", TOPS, ids=lambda folder: folder.name)
def test_nothing_imports_the_commands(folder: Path):
    found = offences(folder, "sculpt_framework.cli")
    assert not [each for each in found if not each.startswith("sculpt_framework/cli/")]


def test_the_engine_knows_neither_command_line_nor_viewer_nor_the_method():
    assert not offences(
        FRAMEWORK / "engine", "sculpt_framework.command_line", "sculpt_framework.sculpting", "viser", "rich", "tyro"
    )
    assert not offences(FRAMEWORK / "evaluation", "sculpt_framework.engine", "sculpt_framework.sculpting")


@pytest.mark.parametrize("folder", SLOT_FOLDERS)
def test_plug_ins_import_no_sibling_slot(folder: str):
    siblings = [f"sculpt_plugins.{name}" for name in SLOT_FOLDERS if name != folder]
    assert not offences(PLUGINS / folder, *siblings, "sculpt_methods", "sculpt_plugins.builtin")


@pytest.mark.parametrize("folder", SLOT_FOLDERS)
def test_plug_ins_import_no_other_plug_in_of_their_slot(folder: str):
    names = sorted(path.name for path in (PLUGINS / folder).iterdir() if (path / "__init__.py").exists())
    for name in names:
        others = [f"sculpt_plugins.{folder}.{other}" for other in names if other != name]
        configs = tuple(f"{other}.config" for other in others) if (folder, name) in NAME_NEIGHBOURS else ()
        assert not offences(PLUGINS / folder / name, *others, allowed=configs)


def test_every_plug_in_folder_is_in_the_table():
    configs = {value.partition(":")[0] for value in REGISTERED}
    found = {
        f"sculpt_plugins.{path.parent.parent.name}.{path.parent.name}.config" for path in PLUGINS.glob("*/*/config.py")
    }
    methods = {f"sculpt_plugins.methods.{path.parent.name}.config" for path in PLUGINS.glob("methods/*/config.py")}
    # What a configuration has that says nothing of it: no background.
    assert found - methods == configs - {"sculpt_framework.config"}
    assert methods <= {type(load_method(name)()).__module__ for name in METHOD_TABLE}


def test_no_file_is_long():
    sources = [path for top in TOPS for path in top.rglob("*.py")]
    long = {path.name: lines for path in sources if (lines := path.read_text(encoding="utf-8").count("\n")) > 420}
    assert not long
