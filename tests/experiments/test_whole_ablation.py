"""The command with the real sculpt-train behind it, as small as it goes."""

import csv
import os
import subprocess
import sys
from pathlib import Path

import pytest

WORDS = (
    "--method gaussian-sculpting-tiny --scenes demo --factors constraints isolation --equal steps --budget 8 --out out "
    "-- --dataset demo --dataset.resolution 48 --dataset.train-views 10 --dataset.test-views 2 "
    "--trainer.fit-steps 30 --trainer.polish-steps 4 --binder.gaussians-per-face 3"
)


@pytest.mark.slow
def test_an_ablation_is_run_and_not_run_again(tmp_path: Path):
    command = [sys.executable, "-m", "sculpt_framework.cli.ablate", *WORDS.split()]
    environment = {**os.environ, "OMP_NUM_THREADS": "2"}
    for _ in range(2):
        done = subprocess.run(
            command,
            cwd=tmp_path,
            env=environment,
            capture_output=True,
            text=True,
            timeout=600,
            check=False,
            encoding="utf-8",
        )
        assert done.returncode == 0, done.stderr
    assert "6 of 6 runs were done before." in done.stdout
    with open(tmp_path / "out" / "results.csv", encoding="utf-8") as lines:
        rows = {row["setting"]: row for row in csv.DictReader(lines)}
    assert {row["status"] for row in rows.values()} == {"finished"}
    assert {row["outer"] for row in rows.values()} == {"8"}
    assert len({rows[name]["chamfer"] for name in ("default", "none", "no-isolation")}) == 3
