"""Difference images: two images side by side, and their amplified difference."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from .png import to_image

if TYPE_CHECKING:
    from PIL.Image import Image

GAIN: Final = 4.0
"""Factor on differences: a difference of 1/4 of full scale is white."""


def difference_image(first: NDArray[np.floating], second: NDArray[np.floating]) -> Image:
    """Arrange two images and their amplified difference side by side.

    Parameters
    ----------
    first, second : (H, W, 3) float
        Display colours, clipped to [0, 1].

    Returns
    -------
    PIL.Image.Image
        Image of mode RGB and triple width: both images, then their `scaled_difference`, clipped.

    Raises
    ------
    ValueError
        The shapes differ.
    """
    if first.shape != second.shape:
        raise ValueError(f"images of shape {first.shape} and {second.shape}, expected equal shapes")
    a, b = (np.clip(picture, 0.0, 1.0) for picture in (first, second))
    return to_image(np.concatenate([a, b, scaled_difference(a, b)], axis=1))


def scaled_difference(
    first: NDArray[np.floating], second: NDArray[np.floating]
) -> NDArray[np.float32]:
    """Return `GAIN` times the absolute difference of two images, per channel.

    Parameters
    ----------
    first, second : (H, W, 3) float
        Display colours, clipped to [0, 1] first.
    """
    a, b = (np.clip(picture, 0.0, 1.0) for picture in (first, second))
    difference: NDArray[np.float32] = (GAIN * np.abs(a - b)).astype(np.float32)
    return difference
