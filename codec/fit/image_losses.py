"""Losses: how far a picture is from what it should be, and the derivative by its pixels."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.compiling import called_with
from cogsplat.codec.render.jit import kernel

F32 = NDArray[np.float32]

# Kerbl et al. 2023, section 5: λ of the loss, the share of 1 - SSIM.
_SSIM_SHARE: Final = 0.2
# Shi et al. 2025, section 3.2.
_STRUCTURE_SHARE: Final = 0.8
# Wang et al. 2004, section III.C, as `metrics.ssim`.
_WINDOW: Final = 11
_SIGMA: Final = 1.5
_C1: Final = 0.01**2
_C2: Final = 0.03**2

Loss = Callable[[F32, F32], tuple[float, F32]]
"""Takes a picture and its target, (H, W, 3); returns the mean squared error of what is shown, and
the derivative of the loss by the picture, summed over pixels and not averaged."""


def _window() -> F32:
    offsets = np.arange(_WINDOW) - _WINDOW // 2
    weights = np.exp(-0.5 * np.square(offsets / _SIGMA))
    normed: F32 = (weights / weights.sum()).astype(np.float32)
    return normed


@called_with("float32[:, :, ::1], float32[::1], float32[:, :, ::1], float32[:, :, ::1]")
@kernel
def _blur(image: F32, weights: F32, across: F32, out: F32) -> None:
    """Average under the window with zeros around the picture, along rows and then columns."""
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
    out = np.empty_like(image)
    _blur(np.ascontiguousarray(image), weights, np.empty_like(image), out)
    return out


def _ssim(picture: F32, target: F32) -> tuple[float, F32]:
    """Return the sum of SSIM over pixels and channels, zeros around, and its derivative."""
    weights = _window()
    mean_a, mean_b = _blurred(picture, weights), _blurred(target, weights)
    square_a = _blurred(picture * picture, weights)
    square_b = _blurred(target * target, weights)
    product = _blurred(picture * target, weights)
    c1, c2 = np.float32(_C1), np.float32(_C2)
    luminance = 2 * mean_a * mean_b + c1
    structure = 2 * (product - mean_a * mean_b) + c2
    means = mean_a * mean_a + mean_b * mean_b + c1
    spreads = (square_a - mean_a * mean_a) + (square_b - mean_b * mean_b) + c2
    likeness: F32 = np.divide(luminance * structure, means * spreads)
    # Derivatives by the mean, by the mean square and by the mean product under the window.
    by_mean = 2 * mean_b * (structure - luminance) / (means * spreads)
    by_mean -= np.float32(2.0) * mean_a * likeness * (spreads - means) / (means * spreads)
    by_square: F32 = np.divide(-likeness, spreads)
    by_product = 2 * luminance / (means * spreads)
    by_picture = _blurred(by_mean, weights)
    by_picture += np.float32(2.0) * picture * _blurred(by_square, weights)
    by_picture += target * _blurred(by_product, weights)
    return float(likeness.sum(dtype=np.float64)), by_picture


def _shown_error(picture: F32, target: F32) -> tuple[F32, float]:
    """Return what a picture is off, and the mean square of that as a screen shows it."""
    off = picture - target
    shown = np.clip(picture, np.float32(0.0), np.float32(1.0)) - target
    return off, float(np.mean(np.square(shown, dtype=np.float64)))


def squared(picture: F32, target: F32) -> tuple[float, F32]:
    """Return the mean squared error, and the derivative of half the squared error.

    Pixels that a screen shows right because both are beyond white do not count.
    """
    off, error = _shown_error(picture, target)
    off[(target >= 1.0) & (picture > 1.0)] = 0.0
    off[(target <= 0.0) & (picture < 0.0)] = 0.0
    return error, off


def photo(picture: F32, target: F32) -> tuple[float, F32]:
    """Return the mean squared error, and the derivative of 0.8·L1 + 0.2·(1 - SSIM).

    The loss of 3DGS (Kerbl et al. 2023, section 5), summed over pixels.
    """
    off, error = _shown_error(picture, target)
    _, by_picture = _ssim(picture, target)
    by_picture *= np.float32(-_SSIM_SHARE)
    by_picture += np.float32(1.0 - _SSIM_SHARE) * np.sign(off)
    return error, by_picture


def structure(picture: F32, target: F32) -> tuple[float, F32]:
    """Return the mean squared error, and the derivative of 0.2·L1 + 0.8·(1 - SSIM).

    The loss of LapisGS (Shi et al. 2025, section 3.2), summed over pixels.
    """
    off, error = _shown_error(picture, target)
    _, by_picture = _ssim(picture, target)
    by_picture *= np.float32(-_STRUCTURE_SHARE)
    by_picture += np.float32(1.0 - _STRUCTURE_SHARE) * np.sign(off)
    return error, by_picture


LOSSES: Final[Mapping[str, Loss]] = MappingProxyType(
    {"squared": squared, "photo": photo, "structure": structure}
)
"""By name: ``squared`` for renders, ``photo`` for photos, ``structure`` for levels."""
