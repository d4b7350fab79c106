"""Where a view stands and where it looks, before its picture has a size."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera

F64 = NDArray[np.float64]

# Forward and down within about 2.6° of each other leave the roll to chance.
_PARALLEL = 0.999


@dataclass(frozen=True)
class Lens:
    """The picture that poses are taken with.

    Parameters
    ----------
    width, height : int
        Px.
    slope : float
        Half the width of the picture at depth 1, unzoomed.
    """

    width: int
    height: int
    slope: float


@dataclass(frozen=True, eq=False)
class Pose:
    """A place and a direction.

    Parameters
    ----------
    position : (3,) float64
        Scene units.
    forward : (3,) float64
        Unit vector.
    zoom : float
        Focal length over the lens' own.
    """

    position: F64
    forward: F64
    zoom: float

    def camera(self, lens: Lens, down: F64, name: str = "") -> Camera:
        """Return the camera of a pose, its y axis as near to `down` as it goes."""
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


def down_of(axes: str) -> F64:
    """Return the unit vector that points down in a frame named as `SceneInfo.axes` is."""
    down = np.zeros(3)
    for axis, letter in enumerate(axes):
        if letter in "DU":
            down[axis] = 1.0 if letter == "D" else -1.0
    return down
