"""PSNR, SSIM and mask IoU on images whose answer is known, and against scikit-image."""

import math

import numpy as np
import pytest
import torch
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from sculpt_framework.evaluation.images import mask_iou, psnr, ssim


def test_psnr_of_a_constant_difference():
    image = torch.full((4, 5, 3), 0.5)
    assert psnr(image + 0.1, image) == pytest.approx(20, abs=1e-4)
    assert psnr(image, image) == math.inf


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
