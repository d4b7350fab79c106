"""Camera poses: position and viewing direction, without image size and field of view."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera

F64 = NDArray[np.float64]

# Cosine of about 2.6°. Closer to `down` the roll would depend on rounding, so it is taken from an
# axis of the scene instead.
_PARALLEL = 0.999


@dataclass(frozen=True)
class Lens:
    """Image size and field of view, which turn a pose into a camera.

    Parameters
    ----------
    width, height : int
        Size of the image, px.
    slope : float
        Half the width of the view at depth 1 without zoom: tan(fov / 2).
    """

    width: int
    height: int
    slope: float


@dataclass(frozen=True, eq=False)
class Pose:
    """Position and viewing direction of a camera.

    Parameters
    ----------
    position : (3,) float64
        Position in the frame of the means, scene units.
    forward : (3,) float64
        Viewing direction, a unit vector: the camera's z axis.
    zoom : float
        Factor on the focal length of the lens.
    """

    position: F64
    forward: F64
    zoom: float

    def camera(self, lens: Lens, down: F64, name: str = "") -> Camera:
        """Return the camera at this pose.

        Parameters
        ----------
        lens : Lens
            Image size and field of view.
        down : (3,) float64
            Unit vector; the camera's y axis is as close to it as `forward` allows. Zeros if no
            direction is known to be down.
        name : str
            Name of the camera.

        Returns
        -------
        Camera
            Camera with its principal point in the middle of the image.
        """
        forward = self.forward
        if not down.any() or abs(float(forward @ down)) > _PARALLEL:
            down = np.eye(3)[np.abs(forward).argmin()]
        right = np.cross(down, forward)
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        focal = self.zoom * 0.5 * lens.width / lens.slope
        return Camera(
            width=lens.width,
            height=lens.height,
            fx=focal,
            fy=focal,
            cx=0.5 * lens.width,
            cy=0.5 * lens.height,
            rotation=rotation,
            translation=-rotation @ self.position,
            name=name,
        )


def level_axes(up: F64) -> tuple[F64, F64]:
    """Return two perpendicular horizontal unit vectors, (3,) float64 each.

    Parameters
    ----------
    up : (3,) float64
        Vertical unit vector, up or down.
    """
    side = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    side /= np.linalg.norm(side)
    return side, np.cross(up, side)


def front_direction(axes: str) -> F64:
    """Return the direction that a frame calls the front, a unit vector, (3,) float64.

    Parameters
    ----------
    axes : str
        Directions of x, y and z; see `SceneInfo.axes`.
    """
    return np.array([1.0 if letter == "F" else -1.0 if letter == "B" else 0.0 for letter in axes])


def down_direction(axes: str) -> F64:
    """Return the down direction of a frame.

    Parameters
    ----------
    axes : str
        Directions of x, y and z, such as ``"RDF"``; see `SceneInfo.axes`.

    Returns
    -------
    (3,) float64
        Unit vector; zeros if no axis points up or down.

    Examples
    --------
    >>> from cogsplat.codec.views.pose import down_direction
    >>> down_direction("RUB").tolist()
    [0.0, -1.0, 0.0]
    """
    down = np.zeros(3)
    for axis, letter in enumerate(axes):
        if letter in "DU":
            down[axis] = 1.0 if letter == "D" else -1.0
    return down
