"""PSNR, SSIM and mask IoU on images whose answer is known, and against scikit-image."""

import math

import numpy as np
import pytest
import torch
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from sculpt_framework.evaluation.images import fitted_psnr, mask_iou, psnr, ssim
from sculpt_framework.rendering.photometric import ssim as differentiable_ssim


def test_psnr_of_a_constant_difference():
    image = torch.full((4, 5, 3), 0.5)
    assert psnr(image + 0.1, image) == pytest.approx(20, abs=1e-4)
    assert psnr(image, image) == math.inf


def test_fitted_light_does_not_count():
    """Each channel darker by a factor and an offset of its own within a mask: all of it is light, but for the rest."""
    image = torch.rand(20, 30, 3, generator=torch.Generator().manual_seed(1)) * 0.5 + 0.25
    mask = torch.zeros(20, 30)
    mask[5:15, 5:25] = 1
    inside = mask[..., None] > 0
    target = torch.where(inside, image * torch.tensor([0.8, 1.1, 0.9]) + torch.tensor([0.1, -0.1, 0.05]), image)
    assert psnr(image, target) < 35
    assert fitted_psnr(image, target, mask) > 100
    outside = torch.where(inside, target, target + 0.1)
    assert fitted_psnr(image, outside, mask) == pytest.approx(psnr(target, outside), abs=1e-3)
    assert fitted_psnr(image, target, torch.zeros(20, 30)) == psnr(image, target)
    assert fitted_psnr(torch.full_like(image, 0.5), target, None) == pytest.approx(
        -10 * float(target.var(dim=(0, 1), unbiased=False).mean().log10()), abs=1e-3
    )


def test_psnr_agrees_with_scikit_image_and_takes_arrays():
    generator = np.random.default_rng(0)
    image, target = generator.random((2, 16, 12, 3))
    expected = peak_signal_noise_ratio(target, image, data_range=1)
    assert psnr(image, target) == pytest.approx(expected)
    assert psnr(torch.from_numpy(image), torch.from_numpy(target)) == pytest.approx(expected)


def test_psnr_clips_as_a_display_does():
    image = torch.full((2, 2, 3), 1.5)
    assert psnr(image, torch.ones(2, 2, 3)) == math.inf


def test_ssim_agrees_with_scikit_image():
    """Where images are 0 around their rim, padding does not matter; scikit-image leaves the rim out of its mean."""
    generator = np.random.default_rng(1)
    image, target = np.zeros((2, 40, 36, 3))
    image[11:-11, 11:-11], target[11:-11, 11:-11] = generator.random((2, 18, 14, 3))
    expected = structural_similarity(
        image, target, data_range=1, channel_axis=2, gaussian_weights=True, sigma=1.5, use_sample_covariance=False
    )
    inner = (40 - 10) * (36 - 10)
    assert ssim(image, target) == pytest.approx((expected * inner + 40 * 36 - inner) / (40 * 36), abs=1e-4)
    assert ssim(image, image) == pytest.approx(1)


def test_mask_iou():
    one, other = torch.zeros(4, 4), torch.zeros(4, 4)
    assert mask_iou(one, other) == 1
    one[:2], other[1:3] = 1, 0.8
    assert mask_iou(one, other) == pytest.approx(4 / 12)
    assert mask_iou(one.numpy(), 0 * other.numpy()) == 0


@pytest.mark.parametrize("shape", [(40, 36), (7, 5), (1, 13), (120, 90)])
def test_ssim_is_the_differentiable_one(shape: tuple[int, int]):
    """Up to the rim, where padding matters, and for images smaller than the window."""
    generator = np.random.default_rng(2)
    image = generator.random((*shape, 3)).astype(np.float32)
    target = np.clip(image + 0.1 * generator.normal(size=image.shape), 0, 1).astype(np.float32)
    expected = float(differentiable_ssim(torch.from_numpy(image), torch.from_numpy(target)))
    assert ssim(image, target) == pytest.approx(expected, abs=2e-5)
    assert ssim(torch.from_numpy(image), target) == ssim(image, target)


def test_ssim_of_flat_images_is_their_luminance_term():
    """Away from the rim the variances are 0: what is left is (2 a b + C) / (a^2 + b^2 + C)."""
    one, other = np.full((400, 400, 3), 0.8), np.full((400, 400, 3), 0.4)
    expected = (2 * 0.8 * 0.4 + 1e-4) / (0.8**2 + 0.4**2 + 1e-4)
    assert ssim(one, other) == pytest.approx(expected, abs=0.01)
    assert ssim(one, one) == pytest.approx(1, abs=1e-6)
