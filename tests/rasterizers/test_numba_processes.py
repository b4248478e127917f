"""The CPU kernels in processes of their own: on narrower vectors, from a read-only folder, from the cache.

Each compiles the rasteriser anew, which takes its time.
"""

import json
import os
import platform
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
SSE = ("sse", "sse2", "sse3", "ssse3", "sse4.1", "sse4.2", "popcnt", "cx16", "sahf")
AVX2 = (*SSE, "avx", "avx2", "fma", "f16c", "bmi", "bmi2", "lzcnt", "movbe")

CONTRACT = """
import sys
import pytest
failed = pytest.main(["-q", "-p", "no:cacheprovider", "tests/rasterizers/test_backends.py", "-k", sys.argv[1]])
from sculpt_plugins.rasterizers.numba import backward, forward
kernels = (forward.composite, backward.composite_backward)
code = "".join(text for kernel in kernels for text in kernel.inspect_asm().values())
print("registers", *(name for name in ("zmm", "ymm", "xmm") if name in code))
sys.exit(failed)
"""

FIRST_RENDERING = """
import json
import sculpt_framework
import torch
from sculpt_framework.types import Camera
from sculpt_plugins.rasterizers.numba.config import NumbaRasterizerConfig
rasterizer = NumbaRasterizerConfig().build(torch.device("cpu"))
pose = torch.eye(4)
pose[2, 3] = 2.0
camera = Camera(world_to_camera=pose, fx=32.0, fy=32.0, cx=16.0, cy=16.0, width=32, height=32)
means = torch.zeros(1, 3, requires_grad=True)
output = rasterizer.rasterize(
    means, torch.full((1, 3), 0.2), torch.eye(3)[None], torch.full((1,), 0.9), torch.ones(1, 3), camera, torch.zeros(3),
    low_pass_px2=0.3, alpha_max=0.999,
)
output.features.square().sum().backward()
from numba.core.dispatcher import Dispatcher
from sculpt_plugins.rasterizers.numba import backward, forward, projection, sorting
kernels = {f"{module.__name__}.{name}": kernel for module in (projection, sorting, forward, backward)
           for name, kernel in vars(module).items() if isinstance(kernel, Dispatcher) and kernel.signatures}
print(json.dumps({
    "package": sculpt_framework.__file__,
    "alpha": float(output.alpha.max().detach()),
    "loaded": sum(sum(kernel.stats.cache_hits.values()) for kernel in kernels.values()),
    "compiled": [name for name, kernel in kernels.items() if kernel.stats.cache_misses],
}))
"""


def _run(script: str, folder: Path, *words: str, **environment: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", script, *words],
        capture_output=True,
        text=True,
        timeout=1200,
        check=False,
        cwd=folder,
        env={**os.environ, **environment},
        encoding="utf-8",
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="these are names of x86 processors")
@pytest.mark.parametrize(
    ("processor", "features", "registers", "cases"),
    [
        ("haswell", AVX2, ["ymm", "xmm"], "numba"),
        # Without fused multiply-adds, which NEON has, gradients of this one sliver are off by 2e-3 instead of 1e-3.
        ("nehalem", SSE, ["xmm"], "numba and not sliver_across_the_whole_screen"),
    ],
    ids=["256-bit", "128-bit"],
)
def test_contract_on_narrower_vectors(
    processor: str, features: tuple[str, ...], registers: list[str], cases: str, tmp_path: Path
):
    """AVX2, and 128 bits at a time, as NEON has them. 512 bits are what the suite itself runs on where there are."""
    printed = _run(
        CONTRACT,
        ROOT,
        cases,
        NUMBA_CPU_NAME=processor,
        NUMBA_CPU_FEATURES=",".join(f"+{feature}" for feature in features),
        NUMBA_CACHE_DIR=str(tmp_path),
    )
    assert printed.splitlines()[-1].split() == ["registers", *registers]


def test_a_second_process_compiles_nothing_also_from_a_read_only_folder(tmp_path: Path):
    """The package as an installation that its user may not write to: kernels are kept in the user's cache."""
    site, cache = tmp_path / "site", tmp_path / "cache"
    for package in ("sculpt_framework", "plugins/sculpt_plugins", "method_configs/sculpt_methods"):
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / package, site / Path(package).name, ignore=ignored)
    folders = [path for path in (site, *site.rglob("*")) if path.is_dir()]
    before = sorted(site.rglob("*"))
    for folder in folders:
        folder.chmod(0o555)
    try:
        environment = {"PYTHONPATH": str(site), "XDG_CACHE_HOME": str(cache), "PYTHONDONTWRITEBYTECODE": "1"}
        first, second = (json.loads(_run(FIRST_RENDERING, tmp_path, **environment).splitlines()[-1]) for _ in range(2))
    finally:
        for folder in folders:
            folder.chmod(0o755)
    assert Path(first["package"]).is_relative_to(site)
    # Those who may write everywhere must not have either.
    assert sorted(site.rglob("*")) == before
    assert list(cache.rglob("*.nbi"))
    assert first["alpha"] == second["alpha"] > 0.5
    assert first["loaded"] == 0
    assert second["compiled"] == []
    assert len(first["compiled"]) >= second["loaded"] > 0
