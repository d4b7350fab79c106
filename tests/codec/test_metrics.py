import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import convolve2d
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from cogsplat.codec.metrics import psnr, ssim


def _pictures(seed, shape=(40, 33, 3), noise=0.1):
    rng = np.random.default_rng(seed)
    smooth = np.cumsum(np.cumsum(rng.normal(size=shape), axis=0), axis=1)
    first = 0.5 + smooth / np.abs(smooth).max() / 2
    second = np.clip(first + rng.normal(0, noise, size=shape), 0, 1)
    return first.astype(np.float32), second.astype(np.float32)


@pytest.mark.parametrize("seed", range(3))
def test_psnr_equals_skimage(seed):
    first, second = _pictures(seed)
    expected = peak_signal_noise_ratio(
        first.astype(np.float64), second.astype(np.float64), data_range=1
    )
    assert psnr(first, second) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("noise", [0.001, 0.05, 0.5])
def test_ssim_equals_skimage_with_an_11x11_window(noise):
    first, second = _pictures(1, noise=noise)
    # truncate 3.5 at σ 1.5 gives a radius of 5, so 11x11.
    expected = structural_similarity(
        first.astype(np.float64),
        second.astype(np.float64),
        gaussian_weights=True,
        sigma=1.5,
        truncate=3.5,
        use_sample_covariance=False,
        data_range=1,
        channel_axis=2,
    )
    assert ssim(first, second) == pytest.approx(expected, abs=1e-9)


def test_ssim_padded_with_zeros_equals_a_plain_convolution():
    # As the evaluation of 3DGS: torch's conv2d with padding 5 is this sum over a padded picture.
    first, second = (p.astype(np.float64) for p in _pictures(4, shape=(21, 18, 3)))
    axis = np.exp(-np.square(np.arange(-5, 6)) / (2 * 1.5**2))
    window = np.outer(axis, axis) / axis.sum() ** 2

    def blurred(image):
        return np.stack(
            [convolve2d(image[..., c], window, mode="same", boundary="fill") for c in range(3)], 2
        )

    a, b = blurred(first), blurred(second)
    var_a, var_b = blurred(first**2) - a * a, blurred(second**2) - b * b
    cov = blurred(first * second) - a * b
    likeness = (2 * a * b + 1e-4) * (2 * cov + 9e-4)
    likeness /= (a * a + b * b + 1e-4) * (var_a + var_b + 9e-4)
    assert ssim(first, second, border="zero") == pytest.approx(likeness.mean(), abs=1e-12)
    assert abs(ssim(first, second) - likeness.mean()) > 1e-4
    with pytest.raises(ValueError, match="border 'mirror'"):
        ssim(first, second, border="mirror")


def test_identical_pictures_are_at_the_cap():
    first, _ = _pictures(2)
    assert psnr(first, first) == 100.0
    assert psnr(first, first + np.float32(1e-7)) == 100.0
    assert ssim(first, first) == pytest.approx(1.0, abs=1e-12)


def test_pictures_are_clipped_first():
    black, white = np.zeros((16, 16, 3)), np.ones((16, 16, 3))
    assert psnr(black - 5, white + 5) == pytest.approx(0.0, abs=1e-12)
    assert psnr(white + 0.5, white) == 100.0
    assert ssim(white * 3, white) == pytest.approx(1.0, abs=1e-12)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.0, 0.5))
def test_metrics_are_symmetric_and_bounded(seed, noise):
    first, second = _pictures(seed, shape=(12, 13, 3), noise=noise)
    assert psnr(first, second) == psnr(second, first)
    assert 0.0 <= psnr(first, second) <= 100.0
    assert ssim(first, second) == pytest.approx(ssim(second, first), abs=1e-12)
    assert -1.0 <= ssim(first, second) <= 1.0 + 1e-12


def test_unlike_or_empty_pictures_are_misuse():
    for metric in (psnr, ssim):
        with pytest.raises(ValueError, match="shape"):
            metric(np.zeros((4, 4, 3)), np.zeros((4, 5, 3)))
        with pytest.raises(ValueError, match="shape"):
            metric(np.zeros((0, 4, 3)), np.zeros((0, 4, 3)))
    with pytest.raises(ValueError, match="at least 11 px"):
        ssim(np.zeros((10, 20, 3)), np.zeros((10, 20, 3)))
