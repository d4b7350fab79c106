"""Pictures of training that a user states for a scene without known cameras."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.capture import STORED_VIEWPOINTS, Capture, moved_capture
from cogsplat.codec.errors import DataError
from cogsplat.codec.finite_fields import require_finite

from .low_discrepancy import even_directions

_EXPECTED: Final = "expected WIDTH,FOV or WIDTH,FOV,DISTANCE, such as 1600,60, or unknown"
# Fields of view, degrees.
_LEAST_FOV, _MOST_FOV = 0.1, 170.0


@dataclass(frozen=True)
class TrainedAt:
    """Pictures of training.

    Parameters
    ----------
    width : float
        Width of a picture, px; 0 where it is not known.
    fov_deg : float
        Horizontal field of view, degrees.
    distance : float or None
        Distance of the cameras from the middle of the scene, scene units. None takes the distance
        from which the scene fills the width.
    """

    width: float = 0.0
    fov_deg: float = 60.0
    distance: float | None = None

    def __post_init__(self) -> None:
        require_finite(self)

    def capture(self, core_box: NDArray[np.float64]) -> Capture:
        """Return viewpoints around a scene; none without a width, or without distance and extent.

        Parameters
        ----------
        core_box : (6,) float64
            Bounding box without stray splats, in the space of the means.
        """
        low, high = core_box[:3], core_box[3:]
        half = math.radians(self.fov_deg) / 2.0
        distance = self.distance or float(np.linalg.norm(high - low)) / 2.0 / math.sin(half)
        if not (self.width and distance):
            return ()
        focal_px = self.width / 2.0 / math.tan(half)
        around = tuple(
            (x, y, z, focal_px) for x, y, z in even_directions(STORED_VIEWPOINTS).tolist()
        )
        return moved_capture(around, distance * np.eye(3), (low + high) / 2.0)


def parse_trained_at(text: str) -> TrainedAt:
    """Parse the pictures of training: ``WIDTH,FOV``, ``WIDTH,FOV,DISTANCE`` or ``unknown``.

    Parameters
    ----------
    text : str
        Width in px, horizontal field of view in degrees, distance in scene units.

    Raises
    ------
    DataError
        ``bad-view-text``: another text, or a number out of range.

    Examples
    --------
    >>> from cogsplat.codec.views.trained_at import parse_trained_at
    >>> parse_trained_at("1600,60")
    TrainedAt(width=1600.0, fov_deg=60.0, distance=None)
    """
    if text == "unknown":
        return TrainedAt()
    try:
        numbers = [float(word) for word in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 3) or not all(0 < number < 1e30 for number in numbers):
        raise DataError("bad-view-text", f"pictures of training {text[:80]!r}, {_EXPECTED}")
    if not _LEAST_FOV <= numbers[1] <= _MOST_FOV:
        raise DataError(
            "bad-view-text",
            f"a field of view of {numbers[1]:g} degrees, expected {_LEAST_FOV:g} to {_MOST_FOV:g}",
        )
    return TrainedAt(*numbers)
