"""Visible depth: the median depth of the means inside a camera's picture, hidden or not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.compiling import called_with
from cogsplat.codec.geometry.frustum import NEAR
from cogsplat.codec.splats import Splats

from .jit import kernel


@called_with(
    "float32[:, ::1], float64[:, ::1], float64[::1], float64[::1], int64, int64, float64[::1]"
)
@kernel
def _depths_in_picture(
    means: NDArray[np.float32],
    rotation: NDArray[np.float64],
    translation: NDArray[np.float64],
    intrinsics: NDArray[np.float64],
    width: int,
    height: int,
    depths: NDArray[np.float64],
) -> int:
    """Write the depths of the means in the picture to `depths`, and return their number.

    Every comparison is written so that NaN fails it.
    """
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    r, t = rotation, translation
    count = 0
    for i in range(len(means)):
        mx, my, mz = float(means[i, 0]), float(means[i, 1]), float(means[i, 2])
        z = r[2, 0] * mx + r[2, 1] * my + r[2, 2] * mz + t[2]
        if not z > NEAR:
            continue
        x = fx * (r[0, 0] * mx + r[0, 1] * my + r[0, 2] * mz + t[0]) / z + cx
        y = fy * (r[1, 0] * mx + r[1, 1] * my + r[1, 2] * mz + t[1]) / z + cy
        if 0.0 <= x < width and 0.0 <= y < height:
            depths[count] = z
            count += 1
    return count


def visible_depth(splats: Splats, camera: Camera) -> float:
    """Return the median camera-space z of the means that project into the image.

    Parameters
    ----------
    splats : Splats
        Scene; every mean counts once, regardless of opacity and occlusion.
    camera : Camera
        Camera in the frame of the means. Means nearer than 0.2 (`NEAR`) are ignored.

    Returns
    -------
    float
        Depth, scene units; 0 if no mean projects into the image.
    """
    depths = np.empty(len(splats), np.float64)
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float64)
    count = _depths_in_picture(
        splats.means,
        camera.rotation,
        camera.translation,
        intrinsics,
        camera.width,
        camera.height,
        depths,
    )
    return float(np.median(depths[:count])) if count else 0.0
