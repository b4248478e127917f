"""What only the Triton kernels promise, and their parts one by one; the rest is in test_backends.py."""

import ast
import itertools
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch
from torch import Tensor

from sculpt_framework.errors import ComponentImportError, DeviceError
from sculpt_framework.rasterizers import Rasterizer
from sculpt_framework.rendering.projection import JACOBIAN_MARGIN, project
from sculpt_framework.types import Camera
from sculpt_plugins.rasterizers.auto.config import AutoRasterizerConfig
from sculpt_plugins.rasterizers.gsplat.rasterizer import GsplatRasterizer
from sculpt_plugins.rasterizers.numba.config import NumbaRasterizerConfig
from sculpt_plugins.rasterizers.reference.config import ReferenceRasterizerConfig
from sculpt_plugins.rasterizers.reference.rasterizer import ReferenceRasterizer
from sculpt_plugins.rasterizers.triton.config import TritonRasterizerConfig
from tests.rasterizers.backends import CPU, INTERPRETED
from tests.rasterizers.splats import Splats, facing_splats, random_splats, rendered

triton = pytest.importorskip("triton", reason="triton is not installed; it comes with the extra 'dev' on Linux")
tl = pytest.importorskip("triton.language")

from sculpt_plugins.rasterizers.triton import layout, measure, projection, scenes, tiles  # noqa: E402
from sculpt_plugins.rasterizers.triton.compositing import split  # noqa: E402
from sculpt_plugins.rasterizers.triton.rasterizer import TritonRasterizer  # noqa: E402
from sculpt_plugins.rasterizers.triton.splatting import Screen  # noqa: E402

pytestmark = INTERPRETED
DEVICE = torch.device("cuda" if torch.cuda.is_available() else "cpu")
FOLDER = Path(measure.__file__).parent
ROOT = Path(__file__).parents[2]


def _lists(splats: Splats) -> tiles.TileLists:
    """Tile lists of a scene with one feature, as the rasteriser makes them."""
    camera = splats.camera
    screen = Screen(
        fx=camera.fx,
        fy=camera.fy,
        cx=camera.cx,
        cy=camera.cy,
        width=camera.width,
        height=camera.height,
        low_pass_px2=splats.low_pass_px2,
        alpha_max=splats.alpha_max,
        jacobian_margin=JACOBIAN_MARGIN,
    )
    names = ("means", "scales", "rotations", "opacities", "features")
    inputs = [getattr(splats, name).to(DEVICE, torch.float32).contiguous() for name in names]
    count = inputs[0].shape[0]
    records = torch.empty(count, layout.record_width(1), device=DEVICE)
    depths, counts = torch.empty(count, device=DEVICE), torch.empty(count, dtype=torch.int32, device=DEVICE)
    projection.project[(triton.cdiv(count, layout.GAUSSIANS.value),)](
        *inputs, camera.world_to_camera.to(inputs[0]).contiguous(), *screen.lens, screen.low_pass_px2,
        screen.width, screen.height, count, records, depths, counts, CHANNELS=1, RECORD=records.shape[1],
    )  # fmt: skip
    return tiles.tile_lists(records, depths, counts, screen.width, screen.height)


def _least(conics: Tensor, dx: tuple[Tensor, Tensor], dy: tuple[Tensor, Tensor]) -> Tensor:
    """Least d^T K d over rectangles of d; convex, so it is at the origin or on an edge."""
    a, b, c = conics.unbind(dim=-1)
    best = torch.full_like(dx[0] + a, float("inf"))
    for x in dx:
        y = torch.clamp(-b * x / c, dy[0], dy[1])
        best = torch.minimum(best, a * x * x + 2 * b * x * y + c * y * y)
    for y in dy:
        x = torch.clamp(-b * y / a, dx[0], dx[1])
        best = torch.minimum(best, a * x * x + 2 * b * x * y + c * y * y)
    inside = (dx[0] <= 0) & (dx[1] >= 0) & (dy[0] <= 0) & (dy[1] >= 0)
    return torch.where(inside, 0.0, best)


def _tiles_reached(splats: Splats) -> tuple[Tensor, Tensor, Tensor]:
    """By brute force in float64: (tile, Gaussian) pairs with a pixel that is drawn, with a point that is; camera z."""
    camera, side = splats.camera, layout.TILE.value
    screen = project(splats.means, splats.scales, splats.rotations, camera, splats.low_pass_px2)
    drawn = (screen.depths >= Rasterizer.NEAR) & (splats.opacities >= Rasterizer.ALPHA_MIN)
    reach = torch.where(drawn, 2.0 * torch.log(splats.opacities / Rasterizer.ALPHA_MIN), -1.0)
    columns, rows = -(-camera.width // side), -(-camera.height // side)
    left = (torch.arange(columns) * side).repeat(rows)[:, None].double()
    top = (torch.arange(rows) * side).repeat_interleave(columns)[:, None].double()
    mean_x, mean_y = screen.means.unbind(dim=1)
    x0, y0 = left + 0.5 - mean_x, top + 0.5 - mean_y
    x1 = (left + side).clamp(max=camera.width) - 0.5 - mean_x
    y1 = (top + side).clamp(max=camera.height) - 0.5 - mean_y
    by_points = _least(screen.conics, (x0, x1), (y0, y1))
    a, b, c = screen.conics.unbind(dim=1)
    by_pixels = torch.full_like(by_points, float("inf"))
    for i in range(side):
        for j in range(side):
            x, y = x0 + i, y0 + j
            q = torch.where((x <= x1) & (y <= y1), a * x * x + 2 * b * x * y + c * y * y, float("inf"))
            by_pixels = torch.minimum(by_pixels, q)
    return by_pixels < reach - 1e-3, by_points < reach + 2e-2, screen.depths


def _tangled() -> Splats:
    """Round ones, slivers, one that fills the screen, sub-pixel ones, and some off the screen or behind it."""
    splats = random_splats(count=90, channels=1, width=44, height=37, seed=4)
    scales = splats.scales.clone()
    scales[20:45] *= torch.tensor([1e-4, 4.0, 1e-4], dtype=torch.float64)
    scales[45:50] = 1e-6
    scales[50] = 5.0
    means = splats.means.clone()
    means[60:70] *= 5.0
    return replace(splats, means=means, scales=scales, low_pass_px2=0.1)


def test_a_splat_is_listed_where_it_reaches_and_nowhere_else():
    splats = _tangled()
    lists = _lists(splats)
    starts = lists.starts.tolist()
    must, may, depths = _tiles_reached(splats)
    assert len(starts) == must.shape[0] + 1
    listed = torch.zeros_like(must)
    for tile, (begin, end) in enumerate(itertools.pairwise(starts)):
        here = lists.gaussians[begin:end].long().cpu()
        listed[tile, here] = True
        assert here.unique().shape == here.shape
        assert (depths[here].diff() > -1e-6).all()
    assert not (must & ~listed).any()
    assert not (listed & ~may).any()
    # The two bounds are close to each other, and a bounding box is not.
    assert int(may.sum()) < 1.1 * int(must.sum())
    assert int(listed.sum()) == starts[-1] == int(lists.counts.sum())


def test_entries_of_a_gaussian_lie_together_before_the_sort_by_tile():
    lists = _lists(_tangled())
    sources, gaussians = lists.sources.long().cpu(), lists.gaussians.long().cpu()
    first, count = lists.first_entries.long().cpu()[gaussians], lists.counts.long().cpu()[gaussians]
    assert ((sources >= first) & (sources < first + count)).all()
    assert torch.equal(sources.sort().values, torch.arange(len(sources)))


def test_more_tiles_than_sixteen_bits_count():
    """A long strip: 40 000 tiles, the splat in the last of them."""
    splats = facing_splats(torch.tensor([[0.0, 0.0, 1.0]]), torch.full((1, 3), 1e-3), size=8, focal=8.0)
    camera = replace(splats.camera, width=320_000, height=1, cx=319_997.0, cy=0.5)
    lists = _lists(replace(splats, camera=camera, features=splats.features[:, :1]))
    assert lists.starts[-2:].tolist() == [0, 1]


@triton.jit
def _split_all(values, high, low, count: tl.constexpr):
    at = tl.arange(0, count)
    parts = split(tl.load(values + at))
    tl.store(high + at, parts[0])
    tl.store(low + at, parts[1])


def _fits_matrix_units(values: Tensor) -> bool:
    """Whether ten bits after the leading one are all there are."""
    return bool(((values.view(torch.int32) & 0x1FFF) == 0).all())


def test_sums_on_matrix_units_lose_nothing_that_counts():
    values = (torch.randn(64, device=DEVICE) * torch.logspace(-20, 20, 64, device=DEVICE)).contiguous()
    high, low = torch.empty_like(values), torch.empty_like(values)
    _split_all[(1,)](values, high, low, count=64)
    assert torch.equal(high + low, values)
    assert _fits_matrix_units(high)
    # The unit drops the low part's last bits: 22 are left in all.
    left = (low.view(torch.int32) & ~0x1FFF).view(torch.float32)
    assert ((high + left - values).abs() <= 2.0**-21 * values.abs()).all()
    # A pixel's place in its tile, and the products of two, need no splitting.
    places = torch.arange(layout.TILE.value) + 0.5 - layout.TILE.value / 2
    assert _fits_matrix_units(places)
    assert _fits_matrix_units(places[:, None] * places)


@pytest.mark.skipif(torch.cuda.is_available(), reason="kernels are compiled here, and no interpreter is to be had")
def test_gradients_as_matrix_units_form_them(monkeypatch: pytest.MonkeyPatch):
    """The interpreter multiplies matrices in float32; here it forgets what a matrix unit does not read."""
    from triton.runtime.interpreter import InterpreterBuilder, TensorHandle

    whole, forgotten = InterpreterBuilder.create_dot, []

    def create_dot(self, a, b, *others):
        cut = [TensorHandle((each.data.view(np.int32) & ~0x1FFF).view(np.float32), each.dtype) for each in (a, b)]
        forgotten.append(any((each.data != other.data).any() for each, other in zip(cut, (a, b), strict=True)))
        return whole(self, *cut, *others)

    monkeypatch.setattr(InterpreterBuilder, "create_dot", create_dot)
    splats = random_splats(count=40, width=14, height=11, focal=14.0)
    _, expected = rendered(ReferenceRasterizerConfig().build(CPU), splats, torch.float64)
    _, gradients = rendered(TritonRasterizerConfig().build(CPU), splats, torch.float32)
    assert any(forgotten)
    for name, value in expected.items():
        assert (gradients[name] - value).norm() < 1e-5 * value.norm(), name


@pytest.mark.slow
@pytest.mark.parametrize("channels", [3, 6])
def test_many_splats_on_many_tiles(channels: int):
    splats = random_splats(count=1500, channels=channels, width=75, height=61, focal=75.0)
    expected, expected_gradients = rendered(ReferenceRasterizerConfig().build(CPU), splats, torch.float64)
    output, gradients = rendered(TritonRasterizerConfig().build(DEVICE), splats, torch.float32, DEVICE)
    assert (output.features - expected.features).abs().max() < 2e-5
    for name, value in expected_gradients.items():
        assert (gradients[name] - value).norm() < 2e-4 * value.norm(), name


def test_kernels_need_nothing_but_torch_and_triton():
    """So that the folder can be carried to any machine with a GPU, and measured there."""
    allowed = {"torch", "triton", "numpy", "numba", *sys.stdlib_module_names}
    for path in FOLDER.glob("*.py"):
        if path.name in ("config.py", "rasterizer.py"):
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [node.module or ""]
            for name in names:
                own = name.startswith("sculpt_plugins.rasterizers.triton.")
                assert own or name.partition(".")[0] in allowed, f"{path.name} imports {name}"


def _compile(capability: int, channels: int, folder: Path) -> dict[str, dict]:
    environment = {**os.environ, "TRITON_INTERPRET": "0", "TRITON_CACHE_DIR": str(folder)}
    command = [sys.executable, "-m", "tests.rasterizers.compile_kernels", str(capability), str(channels)]
    done = subprocess.run(
        command, env=environment, cwd=ROOT, capture_output=True, text=True, timeout=300, check=False, encoding="utf-8"
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.slow
def test_kernels_compile_without_a_gpu(tmp_path: Path):
    """The interpreter takes more than the compiler does."""
    kernels = _compile(80, 3, tmp_path)
    assert len(kernels) == 13
    assert kernels["composite_backward True"]["matrix_units"]


@pytest.mark.slow
@pytest.mark.parametrize(("capability", "channels"), [(75, 3), (80, 1), (86, 6), (90, 7), (120, 3)])
def test_kernels_compile_for_other_gpus(capability: int, channels: int, tmp_path: Path):
    assert len(_compile(capability, channels, tmp_path)) == 13


def test_errors_say_what_to_do(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv("TRITON_INTERPRET", raising=False)
    with pytest.raises(DeviceError, match="--rasterizer auto"):
        TritonRasterizerConfig().build(CPU)
    monkeypatch.setitem(sys.modules, "triton", None)
    with pytest.raises(ComponentImportError, match="comes with torch for CUDA on Linux"):
        TritonRasterizerConfig().build(torch.device("cuda"))


def test_a_missing_compiler_shows_before_anything_is_drawn(monkeypatch: pytest.MonkeyPatch):
    """Triton compiles a launcher at its first launch, in C."""

    def drawn(self: TritonRasterizer, device: torch.device) -> None:
        raise RuntimeError("Failed to find C compiler. Please specify via CC environment variable.\nmore")

    monkeypatch.setattr(TritonRasterizer, "draw_one", drawn)
    with pytest.raises(DeviceError, match=r"does not run on cuda \(RuntimeError: Failed to find C compiler\. .*gcc"):
        TritonRasterizerConfig().build(torch.device("cuda"))
    # So that another one is taken.
    assert isinstance(AutoRasterizerConfig().build(torch.device("cuda")), ReferenceRasterizer | GsplatRasterizer)
    monkeypatch.setattr(TritonRasterizer, "draw_one", lambda self, device: None)
    assert isinstance(TritonRasterizerConfig().build(torch.device("cuda")), TritonRasterizer)
    monkeypatch.setattr(triton, "__version__", "3.4.0")
    with pytest.raises(ComponentImportError, match=r"needs Triton 3\.5 or later, but this is 3\.4\.0"):
        TritonRasterizerConfig().build(torch.device("cuda"))


def test_one_gaussian_is_drawn_to_see_whether_kernels_run():
    TritonRasterizerConfig().build(DEVICE).draw_one(DEVICE)


def test_inputs_on_two_devices_are_refused():
    splats = random_splats(count=3)
    rasterizer = TritonRasterizerConfig().build(DEVICE)
    names = ("means", "scales", "rotations", "opacities", "features")
    inputs = [getattr(splats, name).to(DEVICE, torch.float32) for name in names]
    camera = splats.camera.to(DEVICE, torch.float32)
    with pytest.raises(TypeError, match=r"background is torch\.float32 on meta"):
        rasterizer.rasterize(*inputs, camera, torch.zeros(3, device="meta"), low_pass_px2=0.3, alpha_max=0.999)


# ---------------------------------------------------------------------------------------------------------- measurement


def test_measuring_needs_a_gpu(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(SystemExit) as ended:
        measure.main([])
    assert ended.value.code == 2
    assert "no CUDA device" in capsys.readouterr().err


def test_measuring_runs_as_a_file():
    """From a folder where none of this is on the path; the help text is enough to have imported everything."""
    command = [sys.executable, str(FOLDER / "measure.py"), "--help"]
    done = subprocess.run(
        command, cwd=FOLDER, capture_output=True, text=True, timeout=120, check=False, encoding="utf-8"
    )
    assert done.returncode == 0, done.stderr
    assert "--gaussians" in done.stdout


class PretendedEvent:
    """What torch.cuda.Event does, by a clock on which 2 ms pass from one event to the next."""

    milliseconds = itertools.count(0.0, 2.0)

    def __init__(self, enable_timing: bool):
        assert enable_timing

    def record(self) -> None:
        self.at = next(self.milliseconds)

    def elapsed_time(self, other: "PretendedEvent") -> float:
        return other.at - self.at


def test_rows_of_measurements(monkeypatch: pytest.MonkeyPatch):
    """Two backends in turn, on a device whose clock and memory are pretended."""
    monkeypatch.setattr(torch.cuda, "Event", PretendedEvent)
    for name in ("synchronize", "empty_cache", "reset_peak_memory_stats"):
        monkeypatch.setattr(torch.cuda, name, lambda: None)
    for name in ("memory_allocated", "memory_reserved"):
        monkeypatch.setattr(torch.cuda, name, lambda: 2**20)
    for name in ("max_memory_allocated", "max_memory_reserved"):
        monkeypatch.setattr(torch.cuda, name, lambda: 6 * 2**20)

    def rasterization(means, quats, scales, opacities, colors, viewmats, Ks, width, height, **options):
        assert quats.shape == (60, 4)
        assert options == {"near_plane": 0.01, "eps2d": 0.3, "packed": False}
        total = sum(value.sum() for value in (means, quats, scales, opacities, colors))
        return total.expand(1, height, width, 3), total.expand(1, height, width, 1), {}

    gsplat = ModuleType("gsplat")
    gsplat.rasterization = rasterization
    monkeypatch.setitem(sys.modules, "gsplat", gsplat)
    triton_row, gsplat_row = measure.measured_rows(60, 12, 1, DEVICE)
    assert (triton_row["backend"], gsplat_row["backend"]) == ("triton", "gsplat")
    assert triton_row["ratio"] == "triton / gsplat 1.00"
    for row in (triton_row, gsplat_row):
        assert (row["gaussians"], row["size"], row["peak_mib"], row["held_mib"]) == (60, 12, 5.0, 5.0)
        assert (row["forward_ms"], row["backward_ms"], row["total_ms"]) == (2.0, 2.0, 4.0)


def test_measured_surface():
    """Frames are orthonormal and tangent, and a small one looks as the reference draws it."""
    means, scales, rotations, opacities, colors = scenes.bumpy_sphere(2000, CPU)
    torch.testing.assert_close(rotations.mT @ rotations, torch.eye(3).expand(2000, 3, 3), atol=1e-5, rtol=0.0)
    around = (means[:, None] - means).norm(dim=2)
    neighbours = around.topk(4, largest=False).indices[:, 1:]
    along = torch.nn.functional.normalize(means[neighbours] - means[:, None], dim=2)
    assert (along @ rotations[:, :, :1]).abs().mean() < 0.1
    # The standard deviation is half an edge, and neighbouring faces' centres are an edge / sqrt(3) apart.
    spacing = around.topk(2, largest=False).values[:, 1]
    assert 0.5 < (spacing / (2.0 * scales[:, 1] / 3.0**0.5)).median() < 2.0
    pose, screen = scenes.camera(24, CPU)
    lens = {name: getattr(screen, name) for name in ("fx", "fy", "cx", "cy", "width", "height")}
    camera = Camera(world_to_camera=pose, **lens)
    reference = ReferenceRasterizerConfig().build(CPU)
    inputs = means, scales, rotations, opacities, colors, camera, torch.zeros(3)
    covered = reference.rasterize(*inputs, low_pass_px2=0.3, alpha_max=0.999).alpha > 0.5
    assert 0.3 < covered.float().mean() < 0.6


def test_quaternions_of_rotations():
    generator = torch.Generator().manual_seed(0)
    quaternions = torch.nn.functional.normalize(torch.randn(200, 4, generator=generator), dim=1)
    quaternions[:4] = torch.eye(4)
    w, x, y, z = quaternions.unbind(dim=1)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    rotations = torch.stack([torch.stack(row, dim=1) for row in rows], dim=1)
    agreement = (scenes.quaternions(rotations) * quaternions).sum(dim=1).abs()
    torch.testing.assert_close(agreement, torch.ones(200))


@pytest.mark.gpu
def test_compiled_like_interpreted(capsys: pytest.CaptureFixture[str]):
    measure.main(["--check", "--gaussians", "20000", "--repeats", "2"])
    assert "agree with the interpreter" in capsys.readouterr().out


@pytest.mark.gpu
def test_large_scene_like_on_the_cpu():
    """A hundred thousand Gaussians in 400 x 400 pixels, where the reference would take hours."""
    device = torch.device("cuda")
    means, scales, rotations, opacities, colors = (each.double() for each in scenes.bumpy_sphere(100_000, CPU))
    pose, screen = scenes.camera(400, CPU)
    lens = {name: getattr(screen, name) for name in ("fx", "fy", "cx", "cy", "width", "height")}
    camera = Camera(world_to_camera=pose.double(), **lens)
    splats = Splats(
        means=means,
        scales=scales,
        rotations=rotations,
        opacities=opacities,
        features=colors,
        camera=camera,
        background=torch.zeros(3, dtype=torch.float64),
    )
    expected, expected_gradients = rendered(NumbaRasterizerConfig().build(CPU), splats, torch.float32)
    output, gradients = rendered(TritonRasterizerConfig().build(device), splats, torch.float32, device)
    assert (output.features - expected.features).abs().mean() < 1e-5
    for name, value in expected_gradients.items():
        assert (gradients[name] - value).norm() < 1e-2 * value.norm(), name
