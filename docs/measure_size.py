"""How large the project is: what a person sees of its command line, lines of code and tests, words of documents.

    python docs/measure_size.py REVISION ...

A column for each revision of this repository's history.
"""

import argparse
import io
import re
import subprocess
import sys
import tarfile
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ("sculpt_framework", "plugins", "method_configs")
ASKED = "from sculpt_framework.cli.train import main; main()"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("revisions", nargs="+", metavar="REVISION")
    columns = {revision: measured(revision) for revision in parser.parse_args().revisions}
    rows = list(dict.fromkeys(name for column in columns.values() for name in column))
    print(f"| | {' | '.join(columns)} |\n|---|{'---|' * len(columns)}")
    for name in rows:
        print(f"| {name} | {' | '.join(str(column.get(name, '–')) for column in columns.values())} |")


def measured(revision: str) -> dict[str, int]:
    packed = subprocess.run(["git", "archive", revision], cwd=ROOT, capture_output=True, check=True).stdout
    with TemporaryDirectory() as folder, tarfile.open(fileobj=io.BytesIO(packed)) as files:
        files.extractall(folder, filter="data")
        return sizes(Path(folder))


def sizes(tree: Path) -> dict[str, int]:
    commands = re.search(r"\[project\.scripts\]\n(.*?)\n\n", (tree / "pyproject.toml").read_text("utf-8"), re.DOTALL)
    source = [path for name in SOURCE for path in (tree / name).rglob("*.py")]
    tests = list((tree / "tests").rglob("*.py"))
    found = {
        "options in --help": options(tree, "--help"),
        "options in --help-all": options(tree, "--help-all"),
        "commands": len(commands[1].splitlines()) if commands else 0,
        "source files": len(source),
        "source lines": lines(source),
        "test lines": lines(tests),
        "test functions": sum(path.read_text(encoding="utf-8").count("\ndef test_") for path in tests),
    }
    pages: dict[str, list[Path]] = {}
    for page in (*tree.glob("*.md"), *(tree / "docs").rglob("*.md")):
        inside = page.relative_to(tree).parts
        pages.setdefault(f"words, {inside[1] if len(inside) > 2 else 'front pages'}", []).append(page)
    return found | {
        section: sum(len(page.read_text(encoding="utf-8").split()) for page in group)
        for section, group in sorted(pages.items())
    }


def options(tree: Path, asked: str) -> int:
    """How many options the default method's help names."""
    path = ":".join(str(tree / part) for part in ("", "plugins", "method_configs"))
    command = [sys.executable, "-c", ASKED, "gaussian-sculpting", asked]
    environment = {"PYTHONPATH": path, "PYTHONSAFEPATH": "1", "COLUMNS": "300", "TERM": "dumb", "PATH": ""}
    said = subprocess.run(
        command, capture_output=True, text=True, check=False, env=environment, cwd=tree, encoding="utf-8"
    ).stdout
    return len(set(re.findall(r"│ (--[a-z][\w.-]*)", said)))


def lines(paths: list[Path]) -> int:
    return sum(len(path.read_text(encoding="utf-8").splitlines()) for path in paths)


if __name__ == "__main__":
    main()
