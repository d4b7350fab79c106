"""Smaller pictures: the same view in fewer pixels, as a camera and as means over squares."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera

F32 = NDArray[np.float32]


def downscale_camera(camera: Camera, scale: int) -> Camera:
    """Return the camera of pictures that are divided by a number in width and height.

    Columns and rows at the right and the bottom that fill no pixel are left out.
    """
    return replace(
        camera,
        width=max(camera.width // scale, 1),
        height=max(camera.height // scale, 1),
        fx=camera.fx / scale,
        fy=camera.fy / scale,
        cx=camera.cx / scale,
        cy=camera.cy / scale,
    )


def downscale_picture(picture: F32, scale: int) -> F32:
    """Return a picture whose pixels are the means of squares of `scale` × `scale` pixels.

    Parameters
    ----------
    picture : (H, W, 3) float32
    scale : int

    Returns
    -------
    (H // scale, W // scale, 3) float32
        What `downscale_camera` sees.
    """
    height, width = (max(size // scale, 1) for size in picture.shape[:2])
    down, across = (min(scale, size) for size in picture.shape[:2])
    cut = picture[: height * down, : width * across]
    means: F32 = cut.reshape(height, down, width, across, 3).mean(axis=(1, 3), dtype=np.float64)
    return means.astype(np.float32)
