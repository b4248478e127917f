"""Packages of the npm registry that check our files: nothing the product needs."""

import shutil
import subprocess
from pathlib import Path

import pytest


def install(folder: Path, package: str, version: str) -> Path:
    """The folder of a package; skips the test, saying why, where there is no npm or no network."""
    npm = shutil.which("npm")
    if npm is None or shutil.which("node") is None:
        pytest.skip("no npm on PATH; on Debian: apt-get install npm")
    words = [npm, "install", "--no-audit", "--no-fund", "--ignore-scripts", "--prefix", folder, f"{package}@{version}"]
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=300, check=False, encoding="utf-8")
    except subprocess.TimeoutExpired:
        pytest.skip(f"npm does not get {package} in five minutes")
    if done.returncode != 0:
        lines = [line for line in done.stderr.splitlines() if "error" in line.lower()]
        pytest.skip(f"npm does not get {package}: {lines[0] if lines else done.stderr[-200:]}")
    return folder / "node_modules" / package
