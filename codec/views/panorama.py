"""Panoramas: the six pictures of a cube around a viewpoint."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera

_X, _Y, _Z = np.eye(3)

FACE_ROTATIONS: Final = np.array(
    [
        [_Y, _Z, _X],
        [_Z, _Y, -_X],
        [_Z, _X, _Y],
        [_X, _Z, -_Y],
        [_X, _Y, _Z],
        [_Y, _X, -_Z],
    ]
)
"""World to camera for each picture of a panorama, (6, 3, 3): rows right, down and forward.

They look along x, against x, and likewise for y and z.
"""


def panorama(position: NDArray[np.floating], side: int) -> list[Camera]:
    """Return the six cameras of the panorama of a viewpoint.

    Parameters
    ----------
    position : (3,)
        Viewpoint, scene units.
    side : int
        Width and height of each picture, px.

    Returns
    -------
    list of Camera
        Cameras at the viewpoint with an angle of view of 90 degrees: together they see everything
        around it, and nothing twice.

    Examples
    --------
    >>> import numpy as np
    >>> from cogsplat.codec.views.panorama import panorama
    >>> [camera.rotation[2].astype(int).tolist() for camera in panorama(np.zeros(3), 64)][:2]
    [[1, 0, 0], [-1, 0, 0]]
    """
    half = 0.5 * side
    return [
        Camera(side, side, half, half, half, half, rotation, -rotation @ position)
        for rotation in FACE_ROTATIONS
    ]
