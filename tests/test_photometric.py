"""The compiled loss against its torch twin, the twin against finite differences and scikit-image."""

import pytest
import torch
from skimage.metrics import structural_similarity

from sculpt_framework.rendering.photometric import l1_dssim, l1_dssim_in_torch, ssim


def _pair(height: int, width: int, channels: int = 3, seed: int = 0) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(seed)
    target = torch.rand(height, width, channels, dtype=torch.float64, generator=generator)
    noise = torch.randn(height, width, channels, dtype=torch.float64, generator=generator)
    return (target + 0.1 * noise).clamp(0, 1), target


def test_twin_by_finite_differences():
    image, target = (side.requires_grad_(True) for side in _pair(7, 5, 2))
    assert torch.autograd.gradcheck(lambda x, y: l1_dssim_in_torch(x, y, 0.2), (image, target))


def test_ssim_is_that_of_scikit_image():
    """With zeros around the images the treatment of the border is the same, too."""
    image, target = _pair(21, 17, 1)
    around = torch.nn.functional.pad(torch.stack([image, target])[..., 0], (11, 11, 11, 11)).numpy()
    options = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False, "data_range": 1.0, "full": True}
    _, similarities = structural_similarity(*around, **options)
    assert float(ssim(image, target)) == pytest.approx(similarities[11:-11, 11:-11].mean(), abs=1e-12)


def test_equal_images_have_no_loss():
    image, _ = _pair(13, 11)
    assert float(ssim(image, image)) == pytest.approx(1.0)
    assert float(l1_dssim(image.float(), image.float(), 0.2)) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("weight", [0.0, 0.2, 1.0])
@pytest.mark.parametrize(
    ("height", "width", "channels"), [(1, 1, 3), (3, 2, 3), (40, 33, 3), (12, 60, 1), (25, 25, 4), (80, 7, 3)]
)
def test_compiled_is_the_twin(height: int, width: int, channels: int, weight: float):
    image, target = _pair(height, width, channels)
    image[: height // 3], target[: height // 3] = 1.0, 1.0  # plain background: variances are 0, differences too
    leaf, twin = image.float().requires_grad_(True), image.float().double().requires_grad_(True)
    value = 3.0 * l1_dssim(leaf, target.float(), weight)
    expected = 3.0 * l1_dssim_in_torch(twin, target.float().double(), weight)
    value.backward()
    expected.backward()
    assert value.item() == pytest.approx(expected.item(), abs=1e-5)
    error = (leaf.grad.double() - twin.grad).norm() / twin.grad.norm().clamp(min=1e-9)
    assert float(error) < 1e-4


def test_compiled_takes_any_memory_layout():
    image, target = (side.float() for side in _pair(20, 30))
    turned = image.permute(1, 0, 2).contiguous().permute(1, 0, 2).requires_grad_(True)
    l1_dssim(turned, target.flip(0).flip(0), 0.2).backward()
    straight = image.clone().requires_grad_(True)
    l1_dssim(straight, target, 0.2).backward()
    torch.testing.assert_close(turned.grad, straight.grad)


def test_threads_do_not_change_the_result():
    threads = torch.get_num_threads()
    image, target = (side.float() for side in _pair(64, 40))
    results = []
    for count in (1, 2):
        torch.set_num_threads(count)
        leaf = image.clone().requires_grad_(True)
        value = l1_dssim(leaf, target, 0.2)
        value.backward()
        results.append((value.item(), leaf.grad))
    torch.set_num_threads(threads)
    assert results[0][0] == results[1][0]
    assert torch.equal(results[0][1], results[1][1])


def test_value_without_gradient_is_the_same():
    image, target = (side.float() for side in _pair(30, 20))
    with torch.no_grad():
        value = l1_dssim(image.clone().requires_grad_(True), target, 0.2)
    assert value.item() == l1_dssim(image.clone().requires_grad_(True), target, 0.2).item()


def test_gradient_by_the_target_takes_the_twin():
    image, target = (side.float().requires_grad_(True) for side in _pair(9, 9))
    l1_dssim(image, target, 0.2).backward()
    assert float(target.grad.abs().sum()) > 0


def test_not_a_number_is_not_hidden():
    image, target = (side.float() for side in _pair(30, 30))
    image[10, 10, 1] = float("nan")
    assert torch.isnan(l1_dssim(image, target, 0.2))
