"""Image losses: the error of a picture against ground truth, and its gradient."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.compiling import called_with
from cogsplat.codec.render.jit import kernel

from .train_config import LOSS_NAMES

F32 = NDArray[np.float32]

# Weight of 1 - SSIM in the loss of 3DGS, λ (Kerbl et al. 2023, section 5).
_PHOTO_SSIM_WEIGHT: Final = 0.2
# Weight of 1 - SSIM in the loss of LapisGS (Shi et al. 2025, section 3.2).
_STRUCTURE_SSIM_WEIGHT: Final = 0.8
# Window and constants of SSIM (Wang et al. 2004, section III.C), as in `metrics.ssim`.
_WINDOW: Final = 11
_SIGMA: Final = 1.5
_C1: Final = 0.01**2
_C2: Final = 0.03**2

Loss = Callable[[F32, F32], tuple[float, F32]]
"""Function of a picture and its ground truth, (H, W, 3) float32. Returns the mean squared error of
the picture clipped to 0 to 1, and the (H, W, 3) gradient of the loss. The loss is summed over
pixels."""


def _gaussian_window() -> F32:
    """Return the (11,) Gaussian weights of SSIM, with sum 1."""
    offsets = np.arange(_WINDOW) - _WINDOW // 2
    weights = np.exp(-0.5 * np.square(offsets / _SIGMA))
    normed: F32 = (weights / weights.sum()).astype(np.float32)
    return normed


@called_with("float32[:, :, ::1], float32[::1], float32[:, :, ::1], float32[:, :, ::1]")
@kernel
def _blur(image: F32, weights: F32, across: F32, out: F32) -> None:
    """Blur an image along rows, then columns, with zero padding; `across` is scratch space."""
    height, width, channels = image.shape
    reach = len(weights) // 2
    for y in range(height):
        for x in range(width):
            for c in range(channels):
                across[y, x, c] = 0.0
        for k in range(len(weights)):
            first = max(0, reach - k)
            last = min(width, width + reach - k)
            for x in range(first, last):
                for c in range(channels):
                    across[y, x, c] += weights[k] * image[y, x + k - reach, c]
    for y in range(height):
        for x in range(width):
            for c in range(channels):
                out[y, x, c] = 0.0
        for k in range(len(weights)):
            row = y + k - reach
            if 0 <= row < height:
                for x in range(width):
                    for c in range(channels):
                        out[y, x, c] += weights[k] * across[row, x, c]


def _blurred(image: F32, weights: F32) -> F32:
    """Return a blurred (H, W, C) image, with zero padding."""
    out = np.empty_like(image)
    _blur(np.ascontiguousarray(image), weights, np.empty_like(image), out)
    return out


def _ssim(picture: F32, target: F32) -> tuple[float, F32]:
    """Return SSIM summed over pixels and channels, and its gradient w.r.t. the picture."""
    weights = _gaussian_window()
    mean_a, mean_b = _blurred(picture, weights), _blurred(target, weights)
    square_a = _blurred(picture * picture, weights)
    square_b = _blurred(target * target, weights)
    product = _blurred(picture * target, weights)
    c1, c2 = np.float32(_C1), np.float32(_C2)
    luminance = 2 * mean_a * mean_b + c1
    structure = 2 * (product - mean_a * mean_b) + c2
    means = mean_a * mean_a + mean_b * mean_b + c1
    variances = (square_a - mean_a * mean_a) + (square_b - mean_b * mean_b) + c2
    ssim: F32 = np.divide(luminance * structure, means * variances)
    # Gradients w.r.t. the blurred picture, its blurred square and the blurred product.
    by_mean = 2 * mean_b * (structure - luminance) / (means * variances)
    by_mean -= np.float32(2.0) * mean_a * ssim * (variances - means) / (means * variances)
    by_square: F32 = np.divide(-ssim, variances)
    by_product = 2 * luminance / (means * variances)
    by_picture = _blurred(by_mean, weights)
    by_picture += np.float32(2.0) * picture * _blurred(by_square, weights)
    by_picture += target * _blurred(by_product, weights)
    return float(ssim.sum(dtype=np.float64)), by_picture


def _differences(picture: F32, target: F32) -> tuple[F32, float]:
    """Return the difference of two pictures, and their mean squared error after clipping."""
    difference = picture - target
    clipped = np.clip(picture, np.float32(0.0), np.float32(1.0)) - target
    return difference, float(np.mean(np.square(clipped, dtype=np.float64)))


def squared(picture: F32, target: F32) -> tuple[float, F32]:
    """Return the mean squared error, and the gradient of half the squared error.

    Pixels beyond black or white have no gradient where the ground truth is black or white.
    """
    difference, error = _differences(picture, target)
    difference[(target >= 1.0) & (picture > 1.0)] = 0.0
    difference[(target <= 0.0) & (picture < 0.0)] = 0.0
    return error, difference


def photo(picture: F32, target: F32) -> tuple[float, F32]:
    """Return the mean squared error, and the gradient of the 3DGS loss 0.8·L1 + 0.2·(1 - SSIM).

    Kerbl et al. 2023, section 5, summed over pixels.
    """
    difference, error = _differences(picture, target)
    _, by_picture = _ssim(picture, target)
    by_picture *= np.float32(-_PHOTO_SSIM_WEIGHT)
    by_picture += np.float32(1.0 - _PHOTO_SSIM_WEIGHT) * np.sign(difference)
    return error, by_picture


def structure(picture: F32, target: F32) -> tuple[float, F32]:
    """Return the mean squared error, and the gradient of the LapisGS loss 0.2·L1 + 0.8·(1 - SSIM).

    Shi et al. 2025, section 3.2, summed over pixels.
    """
    difference, error = _differences(picture, target)
    _, by_picture = _ssim(picture, target)
    by_picture *= np.float32(-_STRUCTURE_SSIM_WEIGHT)
    by_picture += np.float32(1.0 - _STRUCTURE_SSIM_WEIGHT) * np.sign(difference)
    return error, by_picture


LOSSES: Final[Mapping[str, Loss]] = MappingProxyType(
    dict(zip(LOSS_NAMES, (squared, photo, structure), strict=True))
)
"""Losses by name, `train_config.LOSS_NAMES`."""
