"""Picture quality metrics: PSNR and SSIM."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

# Identical pictures have no finite PSNR; PRoGS and the papers after it report 100 dB.
PSNR_CAP_DB = 100.0

# Wang et al. 2004, section III.C: an 11x11 circular Gaussian window of σ 1.5, and the constants
# K1, K2 for a dynamic range of 1.
_WINDOW = 11
_SIGMA = 1.5
_C1 = 0.01**2
_C2 = 0.03**2

SSIM_BORDERS = ("valid", "zero")
"""Border modes of `ssim`."""


def psnr(a: NDArray[np.floating], b: NDArray[np.floating]) -> float:
    """Return the peak signal-to-noise ratio of two pictures, dB.

    Parameters
    ----------
    a, b : (H, W, 3) or (P, 3) float
        Pictures or lists of pixels; values are clipped to [0, 1], and the peak is 1.

    Returns
    -------
    float
        PSNR, at most 100 dB, the value for identical pictures.

    Raises
    ------
    ValueError
        The shapes differ, or there are no pixels.
    """
    first, second = _clip_pair(a, b)
    error = float(np.mean(np.square(first - second)))
    if error <= 0.0:
        return PSNR_CAP_DB
    return min(-10.0 * math.log10(error), PSNR_CAP_DB)


def ssim(a: NDArray[np.floating], b: NDArray[np.floating], *, border: str = "valid") -> float:
    """Return the mean structural similarity of two pictures (Wang et al. 2004).

    Parameters
    ----------
    a, b : (H, W, 3) float
        Pictures at least 11 px wide and high; values are clipped to [0, 1].
    border : str
        ``valid`` averages over pixels whose window lies inside the picture, as in the paper.
        ``zero`` averages over all pixels and pads with zeros, as in the evaluation of 3DGS; its
        values are slightly higher.

    Returns
    -------
    float
        Mean over channels and pixels; 1 for identical pictures.

    Raises
    ------
    ValueError
        The shapes differ, a side is under 11 px, or the border mode is unknown.

    Examples
    --------
    >>> picture = np.linspace(0, 1, 16 * 16 * 3).reshape(16, 16, 3)
    >>> ssim(picture, picture)
    1.0
    """
    if border not in SSIM_BORDERS:
        raise ValueError(f"border {border!r}, expected one of {SSIM_BORDERS}")
    first, second = _clip_pair(a, b)
    if min(first.shape[:2]) < _WINDOW:
        raise ValueError(f"picture of shape {first.shape}, expected at least {_WINDOW} px a side")
    if border == "zero":
        around = ((_WINDOW // 2, _WINDOW // 2), (_WINDOW // 2, _WINDOW // 2), (0, 0))
        first, second = np.pad(first, around), np.pad(second, around)
    mean_a, mean_b = _blur(first), _blur(second)
    var_a = _blur(first * first) - mean_a * mean_a
    var_b = _blur(second * second) - mean_b * mean_b
    cov = _blur(first * second) - mean_a * mean_b
    likeness = (2.0 * mean_a * mean_b + _C1) * (2.0 * cov + _C2)
    likeness /= (mean_a * mean_a + mean_b * mean_b + _C1) * (var_a + var_b + _C2)
    return float(np.mean(likeness))


def _clip_pair(
    a: NDArray[np.floating], b: NDArray[np.floating]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return two pictures as float64 clipped to [0, 1], after checking that their shapes agree."""
    if a.shape != b.shape or a.size == 0:
        raise ValueError(f"pictures of shape {a.shape} and {b.shape}, expected two alike")
    first = np.clip(np.asarray(a, np.float64), 0.0, 1.0)
    second = np.clip(np.asarray(b, np.float64), 0.0, 1.0)
    return first, second


def _blur(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the windowed mean at each pixel whose window lies inside: (H - 10, W - 10, C)."""
    offsets = np.arange(_WINDOW) - _WINDOW // 2
    weights = np.exp(-0.5 * np.square(offsets / _SIGMA))
    weights /= weights.sum()
    for axis in (0, 1):
        length = image.shape[axis] - _WINDOW + 1
        slid = np.zeros([length if k == axis else n for k, n in enumerate(image.shape)])
        for start, weight in enumerate(weights):
            slid += weight * image.take(np.arange(start, start + length), axis=axis)
        image = slid
    return image
