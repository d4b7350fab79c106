"""Downscaled pictures: fewer pixels of the same content."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]


def downscale_picture(picture: F32, factor: int) -> F32:
    """Downscale a picture by averaging squares of `factor` × `factor` pixels.

    Parameters
    ----------
    picture : (H, W, 3) float32
        Full picture.
    factor : int
        Downscaling per axis.

    Returns
    -------
    (H // factor, W // factor, 3) float32
        Picture of the camera that `Camera.downscaled` returns.
    """
    height, width = (max(size // factor, 1) for size in picture.shape[:2])
    down, across = (min(factor, size) for size in picture.shape[:2])
    cropped = picture[: height * down, : width * across]
    blocks = cropped.reshape(height, down, width, across, 3)
    means: F32 = blocks.mean(axis=(1, 3), dtype=np.float64)
    return means.astype(np.float32)
