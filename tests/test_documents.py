"""What the documents say is what there is."""

import re
import subprocess
import sys
from pathlib import Path
from typing import get_args

import pytest
import torch

from sculpt_framework.events import EventName
from sculpt_framework.export.gaussian_files import write_gaussians_ply
from sculpt_framework.types import Gaussians

ROOT = Path(__file__).parents[1]
PAGES = sorted(
    page for page in (*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")) if "generated" not in page.relative_to(ROOT).parts
)


def test_the_tables_of_choices_are_those_of_the_code():
    command = [sys.executable, ROOT / "docs" / "make_tables.py", "--check"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False, encoding="utf-8")
    assert done.returncode == 0, done.stderr


def test_every_event_and_every_property_of_a_gaussian_is_described(tmp_path: Path):
    page = (ROOT / "docs" / "reference" / "file-formats.md").read_text(encoding="utf-8")
    described = {word for code in re.findall(r"`([^`]*)`", page) for word in code.split()}
    assert set(get_args(EventName)) <= described
    one = Gaussians(
        means=torch.zeros(1, 3),
        rotations=torch.eye(3)[None],
        scales=torch.ones(1, 3),
        opacities=torch.full((1,), 0.5),
        sh=torch.zeros(1, 4, 3),
        face=torch.zeros(1, dtype=torch.int64),
    )
    write_gaussians_ply(tmp_path / "one.ply", one)
    header = (tmp_path / "one.ply").read_bytes().partition(b"end_header")[0].decode()
    names = re.findall(r"^property \w+ (\w+)$", header, flags=re.M)
    assert len(names) > 20
    runs = {re.sub(r"(\d\.\.\d|\*)$", "", word) for word in described if word.endswith((*"0123456789", "*"))}
    assert [name for name in names if name not in described and name.rstrip("0123456789") not in runs] == []


def headings(page: Path) -> set[str]:
    """The places of a page that links may lead to: its headings as GitHub and the site write them."""
    text = re.sub(r"^ *```.*?^ *```$", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    found: dict[str, int] = {}
    # docs/conf.py: myst_heading_anchors.
    for heading in re.findall(r"^#{1,3} +(.*?) *#*$", text, flags=re.MULTILINE):
        shown = re.sub(r"\[([^\]]*)\]\([^)]*\)|`", r"\1", heading)
        slug = re.sub(r"[^\w\- ]", "", shown.lower()).replace(" ", "-")
        found[slug] = found.get(slug, -1) + 1
    return {slug if number == 0 else f"{slug}-{number}" for slug, most in found.items() for number in range(most + 1)}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path):
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.S)
    targets = [target for target in re.findall(r"\]\(([^)\s]+)[^)]*\)", text) if "://" not in target]
    places = [
        (page.parent / path if path else page, place) for path, _, place in (each.partition("#") for each in targets)
    ]
    assert [path for path, _ in places if not path.exists()] == []
    assert [(path.name, place) for path, place in places if place and place not in headings(path)] == []


def test_files_that_pages_and_messages_name_are_there():
    named = re.compile(
        r"(?<![\w./~-])(?:docs|docker|examples|tests|plugins|sculpt_framework|method_configs)/[\w./-]*\w"
    )
    code = [file for part in ("sculpt_framework", "plugins", "method_configs") for file in (ROOT / part).rglob("*.py")]
    found = {(page.name, path) for page in (*PAGES, *code) for path in named.findall(page.read_text(encoding="utf-8"))}
    missing = {path for _, path in found if not (ROOT / path).exists()}
    # Words in capitals stand for any name, and a guide has readers write a plug-in of their own.
    assert [each for each in sorted(found) if each[1] in missing and not re.search("[A-Z]{2}|/siren", each[1])] == []


def test_headings_are_written_as_github_writes_them(tmp_path: Path):
    page = tmp_path / "page.md"
    page.write_text(
        "# What `a.b` is, [here](there.md)\n## Twice\n```sh\n# no heading\n```\n### Twice\n#### Too deep\n", "utf-8"
    )
    assert headings(page) == {"what-ab-is-here", "twice", "twice-1"}
