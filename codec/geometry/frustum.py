"""Camera frusta: means that project into an image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.splats import Splats

F64 = NDArray[np.float64]

# 3DGS, in_frustum: depth up to which means are not drawn, scene units.
NEAR = 0.2
# 3DGS, renderCUDA: alpha below which a splat is not blended.
ALPHA_MIN = 1.0 / 255.0


def in_frustum(splats: Splats, camera: Camera, margin: float) -> NDArray[np.bool_]:
    """Return a mask of the splats whose means project into a widened image (PRoGS, section 3.3).

    Parameters
    ----------
    splats : Splats
        Scene of N splats.
    camera : Camera
        Camera in the frame of the means.
    margin : float
        Extension of the image at each side, as a share of its size.

    Returns
    -------
    (N,) bool
        True if the mean is inside, occluded or not.
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
    """Return an (N,) mask of the means beyond the near plane that project into a camera's image."""
    local = means @ camera.rotation.T + camera.translation
    z = local[:, 2]
    x, y = camera.fx * local[:, 0] + camera.cx * z, camera.fy * local[:, 1] + camera.cy * z
    inside: NDArray[np.bool_] = z > near_plane
    inside &= (x > 0.0) & (x < camera.width * z)
    inside &= (y > 0.0) & (y < camera.height * z)
    return inside
