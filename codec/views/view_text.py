"""Poses and up directions as text, which the command line, the viewer and its element take."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError

F64 = NDArray[np.float64]

DEFAULT_SIDE: Final = 1080
"""Width and height of the picture of a pose from text, px."""

_NUMBER: Final = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_AXES: Final = {
    f"{sign}{name}": tuple(float(f"{sign}1") if k == axis else 0.0 for k in range(3))
    for axis, name in enumerate("xyz")
    for sign in "+-"
}
_EXPECTED_UP: Final = "expected x,y,z or one of +x, -x, +y, -y, +z, -z"
# Significant digits of a number in text.
_DIGITS: Final = 7
# Coordinates below this share of the largest are rounding errors of the pose, and become 0.
_ROUNDING: Final = 1e-12
# Fields of view, degrees.
_LEAST_FOV, _MOST_FOV = 0.1, 170.0
# Sine of the angle to the vertical below which a direction of view has no level picture.
_STEEP: Final = 1e-6


@dataclass(frozen=True)
class ViewText:
    """A pose as its text states it.

    Parameters
    ----------
    position, target : (float, float, float)
        Camera and the point it looks at, in the frame of the means.
    fov_deg : float
        Vertical field of view, degrees.
    roll_deg : float
        Rotation about the direction of view, degrees, clockwise as the camera sees it; 0 is level.
    """

    position: tuple[float, float, float]
    target: tuple[float, float, float]
    fov_deg: float
    roll_deg: float = 0.0

    def camera(self, up: F64, width: int = DEFAULT_SIDE, height: int = DEFAULT_SIDE) -> Camera:
        """Return the camera at this pose, with its target.

        Parameters
        ----------
        up : (3,) float64
            Unit vector against gravity.
        width, height : int
            Size of its picture, px.
        """
        position, target = np.array(self.position), np.array(self.target)
        forward = target - position
        rotation = level_rotation(forward / np.linalg.norm(forward), up)
        roll = math.radians(self.roll_deg)
        cos, sin = math.cos(roll), math.sin(roll)
        rotation = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]) @ rotation
        focal = 0.5 * height / math.tan(math.radians(0.5 * self.fov_deg))
        return Camera(
            width, height, focal, focal, 0.5 * width, 0.5 * height,
            rotation, -rotation @ position, "view", target,
        )  # fmt: skip


def level_rotation(forward: F64, up: F64) -> F64:
    """Return the rotation, world to camera, of a level camera.

    Parameters
    ----------
    forward : (3,) float64
        Direction of view, a unit vector. A camera that looks straight up or down is turned towards
        the axis of the scene that differs most from `up`.
    up : (3,) float64
        Unit vector against gravity.

    Examples
    --------
    >>> from cogsplat.codec.views.view_text import level_rotation
    >>> import numpy as np
    >>> level_rotation(np.array([0.0, 0.0, 1.0]), np.array([0.0, -1.0, 0.0])).tolist()
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    right = np.cross(forward, up)
    if float(np.linalg.norm(right)) < _STEEP:
        right = np.cross(np.eye(3)[int(np.abs(up).argmin())], forward)
    right = right / np.linalg.norm(right) + 0.0
    return np.stack([right, np.cross(forward, right), forward])


def parse_view(text: str) -> ViewText:
    """Parse a pose: ``x,y,z,tx,ty,tz,fov`` or ``x,y,z,tx,ty,tz,fov,roll``.

    Parameters
    ----------
    text : str
        Position, target, vertical field of view in degrees, and perhaps roll in degrees.

    Raises
    ------
    DataError
        ``bad-view-text``.

    Examples
    --------
    >>> from cogsplat.codec.views.view_text import parse_view
    >>> parse_view("0,0,-4,0,0,0,45").fov_deg
    45.0
    """
    expected = "expected x,y,z,tx,ty,tz,fov or x,y,z,tx,ty,tz,fov,roll"
    numbers = _numbers(text, expected)
    if len(numbers) not in (7, 8):
        raise _error(text, f"{len(numbers)} numbers, {expected}")
    position, target = numbers[:3], numbers[3:6]
    if position == target:
        raise _error(text, "position and target are one point, expected two")
    fov_deg = numbers[6]
    if not _LEAST_FOV <= fov_deg <= _MOST_FOV:
        raise _error(
            text,
            f"a field of view of {fov_deg:g} degrees, expected {_LEAST_FOV:g} to {_MOST_FOV:g}",
        )
    roll_deg = numbers[7] if len(numbers) == 8 else 0.0
    return ViewText(
        (position[0], position[1], position[2]),
        (target[0], target[1], target[2]),
        fov_deg,
        roll_deg,
    )


def parse_up(text: str) -> F64:
    """Parse an up direction: ``x,y,z``, or an axis such as ``+y``; return a unit vector.

    Raises
    ------
    DataError
        ``bad-view-text``.

    Examples
    --------
    >>> from cogsplat.codec.views.view_text import parse_up
    >>> parse_up("-y").tolist(), parse_up("0,0,2").tolist()
    ([0.0, -1.0, 0.0], [0.0, 0.0, 1.0])
    """
    axis = _AXES.get(text.strip().lower())
    if axis is not None:
        return np.array(axis)
    numbers = _numbers(text, _EXPECTED_UP)
    if len(numbers) != 3 or not any(numbers):
        raise _error(text, f"no direction, {_EXPECTED_UP}")
    return _unit(np.array(numbers))


def unit_up(up: str | ArrayLike) -> F64:
    """Return an up direction, (3,) float64 of unit length.

    Parameters
    ----------
    up : str or array-like of 3 float
        Text for `parse_up`, or a direction of any length.

    Raises
    ------
    DataError
        ``bad-view-text``: no direction.
    """
    if isinstance(up, str):
        return parse_up(up)
    given = np.asarray(up, np.float64)
    if given.shape != (3,) or not np.isfinite(given).all() or not given.any():
        raise _error(str(up), f"no direction, {_EXPECTED_UP}")
    return _unit(given)


def _unit(vector: F64) -> F64:
    """Return a vector scaled to unit length."""
    # Divided by the largest first, so that no square overflows or vanishes.
    scaled = vector / np.abs(vector).max()
    direction: F64 = scaled / np.sqrt((scaled * scaled).sum()) + 0.0
    return direction


def view_text(camera: Camera, up: F64, target: F64 | None = None) -> str:
    """Return the text of a camera's pose.

    Parameters
    ----------
    camera : Camera
        Camera with a target, or any camera if `target` is given.
    up : (3,) float64
        Unit vector against gravity.
    target : (3,) float64, optional
        Point whose depth the target of the text gets; the camera's own target by default. The
        target of the text lies in the middle of the picture.

    Raises
    ------
    ValueError
        There is no target.
    """
    point = camera.target if target is None else target
    if point is None:
        raise ValueError("a camera without a target, expected one")
    forward = camera.rotation[2]
    depth = float(forward @ (point - camera.position))
    level = level_rotation(forward, up)
    roll = math.degrees(
        math.atan2(float(camera.rotation[0] @ level[1]), float(camera.rotation[0] @ level[0]))
    )
    fov = math.degrees(2.0 * math.atan(0.5 * camera.height / camera.fy))
    places = np.array([camera.position, camera.position + depth * forward])
    places[np.abs(places) < _ROUNDING * np.abs(places).max()] = 0.0
    numbers = [*places.ravel(), fov]
    if abs(roll) >= 0.005:
        numbers.append(roll)
    return ",".join(_number_text(float(number)) for number in numbers)


def _number_text(number: float) -> str:
    """Return a number with seven significant digits, without an exponent."""
    text = np.format_float_positional(
        number, precision=_DIGITS, unique=False, fractional=False, trim="-"
    )
    return "0" if text == "-0" else text


def _numbers(text: str, expected: str) -> list[float]:
    """Parse finite numbers separated by commas; an error ends with `expected`."""
    found = []
    for part in text.split(","):
        number = part.strip(" \t\n\r")
        if not _NUMBER.fullmatch(number) or not math.isfinite(float(number)):
            raise _error(text, f"{number[:40]!r} is no number, {expected}")
        found.append(float(number))
    return found


def _error(text: str, problem: str) -> DataError:
    """Return the error of a text that states no pose or direction."""
    return DataError("bad-view-text", f"{text[:80]!r}: {problem}")
