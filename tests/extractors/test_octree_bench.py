"""``sculpt-bench extract``."""

import json

import pytest

from sculpt_framework.cli.bench import bench
from sculpt_framework.cli.bench_extract import exponent
from sculpt_framework.errors import ConfigError


def test_one_case_as_json(capsys: pytest.CaptureFixture[str]):
    bench(["extract", "--ways", "flexicubes-octree", "--resolutions", "64", "--repeats", "1", "--json"])
    result = json.loads(capsys.readouterr().out)
    (row,) = result["rows"]
    assert row["faces"] > row["cells"] > 4000
    assert 0 < row["extract_ms"] < row["step_ms"]
    # What the kernel has already given the process is not given again: a small step may need no more.
    assert 0 <= row["step_mb"] < row["peak_mb"]
    assert result["exponents"] == [
        {"way": "flexicubes-octree", "extract_ms": None, "step_ms": None, "cpu_ms": None, "step_mb": None}
    ]


def test_exponent():
    assert exponent([64.0, 128.0, 256.0], [3.0, 12.0, 48.0]) == pytest.approx(2)
    assert exponent([64.0, 64.0], [3.0, 12.0]) is None


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--resolutions", "100"], "--resolutions 100: expected 32 times a power of 2"),
        (["--resolutions", "32"], "--resolutions 32: expected"),
        (["--repeats", "0"], "--repeats and --threads"),
    ],
)
def test_errors(words: list[str], message: str):
    with pytest.raises(ConfigError, match=message):
        bench(["extract", *words])
