"""Downscaled views: cameras and pictures with fewer pixels of the same content."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera

F32 = NDArray[np.float32]


def downscale_camera(camera: Camera, factor: int) -> Camera:
    """Return the camera of a picture that is downscaled by an integer factor per axis.

    Columns at the right and rows at the bottom that do not fill a pixel are cropped.
    """
    return replace(
        camera,
        width=max(camera.width // factor, 1),
        height=max(camera.height // factor, 1),
        fx=camera.fx / factor,
        fy=camera.fy / factor,
        cx=camera.cx / factor,
        cy=camera.cy / factor,
    )


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
        Picture of the camera that `downscale_camera` returns.
    """
    height, width = (max(size // factor, 1) for size in picture.shape[:2])
    down, across = (min(factor, size) for size in picture.shape[:2])
    cropped = picture[: height * down, : width * across]
    blocks = cropped.reshape(height, down, width, across, 3)
    means: F32 = blocks.mean(axis=(1, 3), dtype=np.float64)
    return means.astype(np.float32)
