"""Difference images: two pictures side by side, and how far apart they are."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from .png import to_image

if TYPE_CHECKING:
    from PIL.Image import Image

GAIN: Final = 4.0
"""What differences are multiplied by: one of 1/4 of full scale is white."""


def difference_image(first: NDArray[np.floating], second: NDArray[np.floating]) -> Image:
    """Lay two pictures and their absolute difference side by side.

    Parameters
    ----------
    first, second : (H, W, 3) float
        Display colours, clipped to [0, 1].

    Returns
    -------
    PIL.Image.Image
        Mode RGB, three times as wide: the pictures, then the difference of each channel times
        `GAIN`, clipped.

    Raises
    ------
    ValueError
        Pictures of different shapes.
    """
    if first.shape != second.shape:
        raise ValueError(f"pictures of shape {first.shape} and {second.shape}, expected two alike")
    a, b = (np.clip(picture, 0.0, 1.0) for picture in (first, second))
    return to_image(np.concatenate([a, b, scaled_difference(a, b)], axis=1))


def scaled_difference(
    first: NDArray[np.floating], second: NDArray[np.floating]
) -> NDArray[np.float32]:
    """Return the absolute difference of two pictures, each channel times `GAIN`.

    Parameters
    ----------
    first, second : (H, W, 3) float
        Display colours, clipped to [0, 1] before.
    """
    a, b = (np.clip(picture, 0.0, 1.0) for picture in (first, second))
    apart: NDArray[np.float32] = (GAIN * np.abs(a - b)).astype(np.float32)
    return apart
