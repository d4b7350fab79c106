"""Capture viewpoints: the pixel with which a scene was trained, which sets how thick splats are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, TypeAlias

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.farthest_first import farthest_first

Capture: TypeAlias = tuple[tuple[float, float, float, float], ...]
"""Viewpoints of the training pictures: x, y, z in the space of the means, focal length in px."""

MAX_VIEWPOINTS: Final = 64
"""Viewpoints of a scene at most (SPEC 4.2)."""

STORED_VIEWPOINTS: Final = 32
"""Viewpoints that an encoder stores at most, 16 bytes each.

Of a trained scene of 43 cameras, held-out views drawn with 8, 16, 32 and 43 viewpoints have 57, 63,
63 and 66 dB against the usual drawing.
"""

# Power of the inverse distance that weights a viewpoint. Of the same scene, powers 2, 4 and 8 have
# 60, 67 and 65 dB.
_POWER: Final = 4


def capture_of_cameras(cameras: Sequence[Camera]) -> Capture:
    """Choose capture viewpoints among the training cameras.

    Parameters
    ----------
    cameras : sequence of Camera
        Training cameras in the frame of the means, with the focal lengths of full-size pictures.

    Returns
    -------
    Capture
        At most 32 viewpoints, rounded to float32, in the order of the cameras. They are chosen
        farthest first (Gonzalez 1985), starting with the camera nearest to the mean position.
        They may not stand for all cameras (`choose_capture`).

    Examples
    --------
    >>> from cogsplat.codec.capture import capture_of_cameras
    >>> import cogsplat
    >>> cameras = cogsplat.read_cameras("cameras.json")
    >>> len(capture_of_cameras(cameras)) == min(len(cameras), 32)
    True
    """
    rows = np.array([[*camera.position, camera.focal_px] for camera in cameras]).reshape(-1, 4)
    return _spread(rows.astype(np.float32), STORED_VIEWPOINTS)


def _spread(viewpoints: NDArray[np.float32], count: int) -> Capture:
    """Choose `count` of (n, 4) viewpoints at most, by positions, farthest first."""
    if len(viewpoints) > count:
        positions = viewpoints[:, :3].astype(np.float64)
        middle = int(np.argmin(np.square(positions - positions.mean(axis=0)).sum(axis=1)))
        viewpoints = viewpoints[sorted(farthest_first(positions, count, middle))]
    return tuple((x, y, z, focal) for x, y, z, focal in viewpoints.tolist())


def moved_capture(
    capture: Capture, linear: NDArray[np.float64], translation: NDArray[np.float64] | None = None
) -> Capture:
    """Move viewpoints with their scene: ``new = linear @ old + translation``.

    Focal lengths stay, so a scaling is the same along all axes. Positions are rounded to float32.

    Parameters
    ----------
    capture : Capture
        Viewpoints to move.
    linear : (3, 3) float64
        Rotation, reflection or scaling of the means, or several of these.
    translation : (3,) float64, optional
        Translation after it.

    Examples
    --------
    >>> import numpy as np
    >>> from cogsplat.codec.capture import moved_capture
    >>> moved_capture(((0.0, 0.0, -4.0, 100.0),), 2.0 * np.eye(3))
    ((0.0, 0.0, -8.0, 100.0),)
    """
    rows = np.array(capture, np.float64).reshape(-1, 4)
    rows[:, :3] = rows[:, :3] @ linear.T
    if translation is not None:
        rows[:, :3] += translation
    return _spread(rows.astype(np.float32), MAX_VIEWPOINTS)


def merged_capture(captures: Sequence[Capture]) -> Capture:
    """Join the viewpoints of several scenes in one frame.

    Parameters
    ----------
    captures : sequence of Capture
        Viewpoints of each scene.

    Returns
    -------
    Capture
        All different viewpoints. None if a scene has none, for then the thickness of its splats is
        not known; none if there are more than 64, for a choice of them may be far from some scenes.

    Examples
    --------
    >>> from cogsplat.codec.capture import merged_capture
    >>> front, back = (0.0, 0.0, -4.0, 100.0), (0.0, 0.0, 4.0, 100.0)
    >>> len(merged_capture([(front,), (front, back)])), merged_capture([(front,), ()])
    (2, ())
    """
    if not all(captures):
        return ()
    different = dict.fromkeys(viewpoint for capture in captures for viewpoint in capture)
    return tuple(different) if len(different) <= MAX_VIEWPOINTS else ()


def training_pixel(capture: Capture, position: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the area of the training pixel as a function of the place, for a viewer at a position.

    Training drew each splat with a fixed thickness in pixels of its pictures. The pictures taken
    nearest to the viewer say how large that pixel was where the splat lies.

    Parameters
    ----------
    capture : Capture
        Capture viewpoints, at least one.
    position : (3,) float64
        Position of the viewer, in the space of the means.

    Returns
    -------
    (5,) float64
        x, y, z of a centre, then a and b: the area of the training pixel at a place with squared
        distance d² from the centre is ``a · d² + b``, in squared scene units.

    Notes
    -----
    SPEC 8.7. The area is the weighted mean of ``(distance / focal length)²`` of the viewpoints; a
    weight is the inverse fourth power of the viewpoint's distance from the viewer. The mean of
    squared distances to points is a squared distance to their centre plus a constant.

    Examples
    --------
    >>> import numpy as np
    >>> from cogsplat.codec.capture import training_pixel
    >>> training_pixel(((0.0, 0.0, -4.0, 100.0),), np.zeros(3)).tolist()
    [0.0, 0.0, -4.0, 0.0001, 0.0]
    """
    viewpoints = np.array(capture, np.float64)
    places = viewpoints[:, :3]
    squared = np.square(places - position).sum(axis=1)
    least = float(squared.min())
    # Relative to the nearest viewpoint: its own distance may be 0.
    if least > 0.0:
        weights = (least / squared) ** (_POWER / 2)
    else:
        weights = (squared == 0.0).astype(np.float64)
    weights /= weights.sum()
    weights /= np.square(viewpoints[:, 3])
    area = weights.sum()
    centre = weights @ places / area
    rest = float(weights @ np.square(places - centre).sum(axis=1))
    return np.array([*centre, area, rest])
