"""Camera frusta: which means lie beyond the near plane and project into the image, how deep."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.splats import Splats

F64 = NDArray[np.float64]

# 3DGS, in_frustum: means nearer than this are not drawn. Scene units.
NEAR = 0.2
# 3DGS, renderCUDA: fainter than this adds nothing.
ALPHA_MIN = 1.0 / 255.0


def in_frustum(splats: Splats, camera: Camera, margin: float) -> NDArray[np.bool_]:
    """Mark the splats whose means project into an image (PRoGS, section 3.3).

    Parameters
    ----------
    splats : Splats
    camera : Camera
        In the frame of the means.
    margin : float
        The image is widened at each side by this share of its size.

    Returns
    -------
    (N,) bool
        True where the mean is inside, occluded or not; footprints do not count.
    """
    with np.errstate(all="ignore"):  # means behind the camera, or not finite, fail the tests below
        local = splats.means @ camera.rotation.T + camera.translation
        z = local[:, 2]
        x = (camera.fx * local[:, 0] / z + camera.cx) / camera.width
        y = (camera.fy * local[:, 1] / z + camera.cy) / camera.height
        inside: NDArray[np.bool_] = z > NEAR
        for across in (x, y):
            inside &= (across > -margin) & (across < 1 + margin)
    return inside


def in_picture(means: F64, camera: Camera, near_plane: float) -> NDArray[np.bool_]:
    """Mark the (N, 3) means that project into a camera's image, occluded or not: (N,) bool."""
    local = means @ camera.rotation.T + camera.translation
    z = local[:, 2]
    x, y = camera.fx * local[:, 0] + camera.cx * z, camera.fy * local[:, 1] + camera.cy * z
    inside: NDArray[np.bool_] = z > near_plane
    inside &= (x > 0.0) & (x < camera.width * z)
    inside &= (y > 0.0) & (y < camera.height * z)
    return inside


def visible_depth(splats: Splats, camera: Camera) -> float:
    """Return the median camera-space z of the means that project into the image.

    Parameters
    ----------
    splats : Splats
        Every mean counts once, whatever its opacity, occluded or not.
    camera : Camera
        Means nearer than 0.2 (`NEAR`) do not count.

    Returns
    -------
    float
        Scene units; 0 where no mean projects into the image.
    """
    with np.errstate(all="ignore"):  # means behind the camera, or not finite, fail the tests below
        local = splats.means @ camera.rotation.T + camera.translation
        z = local[:, 2]
        x = camera.fx * local[:, 0] / z + camera.cx
        y = camera.fy * local[:, 1] / z + camera.cy
        inside = (z > NEAR) & (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
    return float(np.median(z[inside])) if inside.any() else 0.0
