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
PAGES = sorted((*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")))


def test_the_tables_of_choices_are_those_of_the_code():
    command = [sys.executable, ROOT / "docs" / "make_tables.py", "--check"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
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


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path):
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.S)
    targets = [target for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", text) if "://" not in target]
    missing = [target for target in targets if not (page.parent / target).exists()]
    assert not missing
