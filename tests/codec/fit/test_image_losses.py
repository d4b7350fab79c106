from functools import partial

import numpy as np
import pytest

from cogsplat.codec.fit.image_losses import LOSSES
from cogsplat.codec.metrics import psnr, ssim


def pictures(seed, height=23, width=17):
    rng = np.random.default_rng(seed)
    smooth = np.linspace(0.2, 0.8, height * width * 3).reshape(height, width, 3)
    picture = (smooth + 0.05 * rng.normal(size=smooth.shape)).astype(np.float32)
    target = np.clip(smooth + 0.1 * rng.normal(size=smooth.shape), 0, 1).astype(np.float32)
    return picture, target


def l1_and_ssim(picture, target, ssim_share=0.2):
    dissimilarity = picture.size * (1 - ssim(picture, target, border="zero"))
    return (1 - ssim_share) * np.abs(picture - target).sum() + ssim_share * dissimilarity


VALUES = {
    "squared": lambda picture, target: 0.5 * np.sum(np.square(picture - target)),
    "photo": l1_and_ssim,
    "structure": partial(l1_and_ssim, ssim_share=0.8),
}


@pytest.mark.parametrize("name", list(LOSSES))
def test_gradients_are_finite_differences(name):
    picture, target = pictures(1)
    _, found = LOSSES[name](picture, target)
    rng = np.random.default_rng(2)
    for _ in range(5):
        direction = np.sign(rng.normal(size=picture.shape))
        # No pixel difference may change its sign within the step.
        direction *= np.abs(picture - target) > 2e-4
        step = 1e-4 * direction
        wide = picture.astype(np.float64)
        wanted = (
            VALUES[name](wide + step, target.astype(np.float64))
            - VALUES[name](wide - step, target.astype(np.float64))
        ) / 2e-4
        assert np.sum(found * direction) == pytest.approx(wanted, rel=0.01, abs=0.05)


@pytest.mark.parametrize("name", list(LOSSES))
def test_the_error_is_that_of_the_clipped_picture(name):
    picture, target = pictures(3)
    picture[:4] += 2.0
    error, _ = LOSSES[name](picture, target)
    assert -10 * np.log10(error) == pytest.approx(psnr(picture, target), abs=1e-3)


def test_pixels_clipped_to_the_ground_truth_have_no_gradient():
    target = np.array([[[1.0, 0.0, 0.5]]], np.float32)
    error, found = LOSSES["squared"](np.array([[[1.5, -0.5, 0.75]]], np.float32), target)
    np.testing.assert_array_equal(found, [[[0.0, 0.0, 0.25]]])
    assert error == pytest.approx(0.0625 / 3)
