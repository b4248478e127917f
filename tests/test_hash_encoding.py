"""The hash grid's kernels against the torch twin, and the twin against finite differences."""

import os

import pytest
import torch

from sculpt_framework.encodings.hash_grid import HashEncoding, corner_entries, encode_in_torch, triton_on
from tests.interpreting import spare_the_interpreter

# Where there is no GPU, Triton's kernels run in its interpreter, which has to be said before triton is imported.
if not torch.cuda.is_available():
    os.environ.setdefault("TRITON_INTERPRET", "1")
ACCELERATOR = torch.device("cuda" if torch.cuda.is_available() else "cpu")


def _encoding(
    levels: int = 4, features: int = 2, log2_table: int = 10, seed: int = 0, sum_levels: bool = False
) -> HashEncoding:
    """Coarse levels dense, fine ones hashed: 5^3 corners fit 2^10 entries, 33^3 do not."""
    torch.manual_seed(seed)
    return HashEncoding(
        levels=levels,
        features_per_level=features,
        log2_table=log2_table,
        base_resolution=4,
        finest_resolution=32,
        init_scale=1.0,
        sum_levels=sum_levels,
    )


def _points(count: int = 500) -> torch.Tensor:
    generator = torch.Generator().manual_seed(1)
    inside = torch.rand(count, 3, generator=generator) * 2.0 - 1.0
    special = torch.tensor(
        [
            [1.0, 1.0, 1.0],
            [-1.0, -1.0, -1.0],
            [0.0, 0.0, 0.0],
            [1.0, -1.0, 0.5],
            [3.0, 0.1, -0.2],
            [-7.0, 9.0, 1e30],
            [float("inf"), 0.0, 0.0],
        ]
    )
    return torch.cat([inside, special])


@pytest.mark.parametrize("features", [1, 2, 3, 4, 5])
def test_points_that_nobody_asks_teach_nothing(features: int):
    """Rows of no gradient are passed over in the kernel; rows with a gradient in one feature only are not."""
    encoding = _encoding(features=features)
    points = _points()
    asked = torch.arange(len(points)) % 3 == 0
    weights = torch.randn(len(points), 4 * features, generator=torch.Generator().manual_seed(2))
    weights[asked, : 4 * features - 1] = 0.0
    weights[~asked] = 0.0
    (encoding(points) * weights).sum().backward()
    among_all = [table.grad.clone() for table in encoding.tables]
    encoding.zero_grad()
    (encoding(points[asked]) * weights[asked]).sum().backward()
    for table, expected in zip(encoding.tables, among_all, strict=True):
        assert torch.equal(table.grad, expected)
    assert bool(among_all[-1].any())


@pytest.mark.parametrize("features", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("log2_table", [4, 10, 16])
@pytest.mark.parametrize("sum_levels", [False, True])
def test_compiled_is_the_twin(features: int, log2_table: int, sum_levels: bool):
    encoding = _encoding(features=features, log2_table=log2_table, sum_levels=sum_levels)
    points = _points().requires_grad_(True)
    twin_points = points.detach().double().requires_grad_(True)
    twin_tables = [table.detach().double().requires_grad_(True) for table in encoding.tables]
    encoded = encoding(points)
    expected = encode_in_torch(twin_points, twin_tables, encoding.resolutions, sum_levels)
    torch.testing.assert_close(encoded.double(), expected, rtol=0.0, atol=2e-5)
    weights = torch.randn(encoded.shape, generator=torch.Generator().manual_seed(2))
    (encoded * weights).sum().backward()
    (expected * weights.double()).sum().backward()
    # The last point is at infinity, where the twin has no gradient.
    torch.testing.assert_close(points.grad[:-1].double(), twin_points.grad[:-1], rtol=1e-4, atol=1e-3)
    for table, twin in zip(encoding.tables, twin_tables, strict=True):
        torch.testing.assert_close(table.grad.double(), twin.grad, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("features", [1, 3, 4])
@pytest.mark.parametrize("log2_table", [10, 16])
@pytest.mark.parametrize("sum_levels", [False, True])
def test_the_kernels_for_cuda_are_the_twin(features: int, log2_table: int, sum_levels: bool):
    pytest.importorskip("triton", reason="triton is not installed; it comes with the extra 'dev' on Linux")
    from sculpt_framework.encodings.hash_grid_triton import TritonEncoding

    if ACCELERATOR.type == "cpu":
        spare_the_interpreter()
    # A dense level and, in small tables, a hashed one.
    encoding = _encoding(levels=2, features=features, log2_table=log2_table, sum_levels=sum_levels).to(ACCELERATOR)
    some = torch.cat([_points(140), torch.full((1, 3), float("nan"))]).to(ACCELERATOR)
    points = some.clone().requires_grad_(True)
    encoded = TritonEncoding.apply(points, encoding.resolutions, sum_levels, *encoding.tables)
    assert encoded[-1].isnan().all()
    # The twin would have the point that is none teach, too, however little it is asked.
    twin_points = points.detach()[:-1].double().requires_grad_(True)
    twin_tables = [table.detach().double().requires_grad_(True) for table in encoding.tables]
    expected = encode_in_torch(twin_points, twin_tables, encoding.resolutions, sum_levels)
    torch.testing.assert_close(encoded[:-1].double(), expected, rtol=0.0, atol=2e-5)
    weights = torch.randn(encoded.shape, generator=torch.Generator().manual_seed(2))
    weights[::3] = 0.0
    weights = weights.to(ACCELERATOR)
    (encoded[:-1] * weights[:-1]).sum().backward()
    (expected * weights[:-1].double()).sum().backward()
    # The last of the others is at infinity, where the twin has no gradient.
    torch.testing.assert_close(points.grad[:-2].double(), twin_points.grad[:-1], rtol=1e-4, atol=1e-3)
    for table, twin in zip(encoding.tables, twin_tables, strict=True):
        torch.testing.assert_close(table.grad.double(), twin.grad, rtol=1e-4, atol=1e-4)


@pytest.mark.gpu
def test_cuda_takes_them():
    device = torch.device("cuda")
    encoding, points = _encoding(), _points()
    expected = encoding(points)
    encoding = encoding.to(device)
    encoded = encoding(points.to(device))
    assert type(encoded.grad_fn).__name__ == "TritonEncodingBackward"
    torch.testing.assert_close(encoded.cpu(), expected, rtol=0.0, atol=2e-5)


def test_where_triton_does_not_run_torch_does(monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture):
    triton = pytest.importorskip("triton", reason="triton is not installed; it comes with the extra 'dev' on Linux")
    from sculpt_framework.encodings import hash_grid_triton

    assert triton_on(ACCELERATOR.type) is hash_grid_triton.TritonEncoding
    assert not caplog.records

    def launched(*_: object) -> None:
        raise RuntimeError("Failed to find C compiler. Please specify via CC environment variable.\nmore")

    with monkeypatch.context() as patch:
        patch.setattr(hash_grid_triton, "_launch", launched)
        assert triton_on(ACCELERATOR.type) is None
    assert "hash grid: torch does it" in caplog.text
    assert "Failed to find C compiler" in caplog.text
    caplog.clear()
    monkeypatch.setattr(triton, "__version__", "3.4.0")
    assert triton_on(ACCELERATOR.type) is None
    assert "the hash grid needs Triton 3.5 or later, but this is 3.4.0" in caplog.text


def test_twin_by_finite_differences():
    encoding = _encoding(levels=3, log2_table=6).double()
    generator = torch.Generator().manual_seed(3)
    points = (torch.rand(6, 3, dtype=torch.float64, generator=generator) * 1.8 - 0.9).requires_grad_(True)
    tables = [table.detach().requires_grad_(True) for table in encoding.tables]
    assert torch.autograd.gradcheck(
        lambda where, *given: encode_in_torch(where, list(given), encoding.resolutions), (points, *tables)
    )


def test_dense_level_interpolates_a_linear_function_exactly():
    encoding = HashEncoding(
        levels=1, features_per_level=1, log2_table=10, base_resolution=5, finest_resolution=5, init_scale=0.0
    )
    assert encoding.tables[0].shape == (6**3, 1)
    axis = torch.linspace(-1.0, 1.0, 6)
    z, y, x = torch.meshgrid(axis, axis, axis, indexing="ij")
    with torch.no_grad():
        encoding.tables[0].copy_((x + 2.0 * y - 3.0 * z).reshape(-1, 1))
    points = (torch.rand(200, 3) * 2.0 - 1.0).requires_grad_(True)
    encoded = encoding(points)
    torch.testing.assert_close(encoded[:, 0], points @ torch.tensor([1.0, 2.0, -3.0]), rtol=0.0, atol=1e-5)
    encoded.sum().backward()
    torch.testing.assert_close(points.grad, torch.tensor([1.0, 2.0, -3.0]).expand(200, 3), rtol=1e-4, atol=1e-4)


def test_dense_levels_have_no_collisions_and_hashed_ones_stay_in_their_table():
    corners = torch.cartesian_prod(*[torch.arange(6)] * 3)
    assert corner_entries(corners, 5, 2**8).unique().shape[0] == 6**3
    assert corner_entries(corners, 5, 2**7).max() < 2**7


def test_clamped_points_have_no_gradient_outwards():
    encoding = _encoding()
    points = torch.tensor([[1.5, 0.3, -0.2]], requires_grad=True)
    encoding(points).sum().backward()
    assert points.grad[0, 0] == 0.0
    assert (points.grad[0, 1:] != 0.0).all()
    torch.testing.assert_close(encoding(points), encoding(points.clamp(-1.0, 1.0)))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_idle_levels_are_zero_and_get_no_gradient(dtype: torch.dtype):
    encoding = _encoding().to(dtype)
    points = _points().to(dtype)
    encoded = encoding(points, active_levels=2)
    assert encoded.shape == (points.shape[0], 8)
    assert (encoded[:, 4:] == 0).all()
    torch.testing.assert_close(encoded[:, :4], encoding(points)[:, :4])
    encoded.sum().backward()
    assert [table.grad is None for table in encoding.tables] == [False, False, True, True]
    assert (encoding(points, active_levels=0) == 0).all()


def test_points_need_no_gradient_and_neither_do_frozen_tables():
    encoding = _encoding()
    encoding.tables[1].requires_grad_(False)
    points = _points().requires_grad_(True)
    encoding(points).sum().backward()
    assert encoding.tables[1].grad is None
    assert encoding.tables[0].grad is not None
    encoding(points.detach()).sum().backward()


def test_repeats_to_the_last_bit_on_any_number_of_threads():
    threads = torch.get_num_threads()
    encoding, results = _encoding(), []
    for count in (1, 2, 2):
        torch.set_num_threads(count)
        encoding.zero_grad()
        encoded = encoding(_points())
        encoded.square().sum().backward()
        results.append([encoded.detach(), *(table.grad.clone() for table in encoding.tables)])
    torch.set_num_threads(threads)
    for other in results[1:]:
        assert all(torch.equal(one, two) for one, two in zip(results[0], other, strict=True))


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_not_a_number_is_not_hidden(dtype: torch.dtype):
    points = torch.tensor([[0.1, float("nan"), 0.2], [0.1, 0.2, 0.3]], dtype=dtype)
    encoded = _encoding().to(dtype)(points)
    assert torch.isnan(encoded[0]).all()
    assert torch.isfinite(encoded[1]).all()


def test_no_points():
    encoding = _encoding()
    encoded = encoding(torch.zeros(0, 3))
    assert encoded.shape == (0, 8)
    encoded.sum().backward()


@pytest.mark.parametrize(
    "wrong",
    [
        {"levels": 0},
        {"features_per_level": 0},
        {"log2_table": 40},
        {"base_resolution": 64},
        {"base_resolution": 0},
        {"levels": 1},
    ],
)
def test_impossible_grids(wrong: dict[str, int]):
    options = {
        "levels": 2,
        "features_per_level": 2,
        "log2_table": 8,
        "base_resolution": 4,
        "finest_resolution": 8,
        **wrong,
    }
    with pytest.raises(ValueError, match="hash grid"):
        HashEncoding(init_scale=0.0, **options)


def test_too_many_active_levels():
    with pytest.raises(ValueError, match="5 active levels"):
        _encoding()(torch.zeros(1, 3), active_levels=5)
