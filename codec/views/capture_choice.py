"""Capture viewpoints of a scene, if a few of its cameras stand for all."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.capture import Capture, capture_of_cameras, training_pixel
from cogsplat.codec.geometry.frustum import NEAR, in_picture
from cogsplat.codec.splats import Splats

from .view_sets import sample_evenly

_MOST_AREA: Final = 1.5
"""Most that a pixel of training may seem larger than it was, as a ratio of areas.

A reader takes its size from the chosen viewpoints. In pictures of the cameras that are not chosen,
the ratio is 1.0 in a captured room, 0.9 in a house, 1.2 on a terrace, 1.9 in a city of a million
splats, and 11 in one of three million. Where it is large, splats are drawn too thick: a street of
the smaller city had 39.4 dB against the source with viewpoints and 43.1 without, one of the larger
city 24.8 and 36.8 dB.
"""

# Splats that the area is measured for, about, and cameras at most.
_MEASURED_SPLATS: Final = 8_192
_MEASURED_CAMERAS: Final = 64


def choose_capture(splats: Splats, cameras: Sequence[Camera]) -> Capture:
    """Choose the capture viewpoints of a scene among its training cameras.

    Parameters
    ----------
    splats : Splats
        Scene.
    cameras : sequence of Camera
        Training cameras in the frame of the means, with the focal lengths of full-size pictures.

    Returns
    -------
    Capture
        Those of `capture.capture_of_cameras`; none where splats, drawn by them, would be clearly
        thicker than in the pictures of the cameras that are not chosen, as in a city.

    Examples
    --------
    >>> import cogsplat
    >>> from cogsplat.codec.views.capture_choice import choose_capture
    >>> splats = cogsplat.read("scene.ply")
    >>> len(choose_capture(splats, cogsplat.read_cameras("cameras.json"))) <= 32
    True
    """
    chosen = capture_of_cameras(cameras)
    known = {viewpoint[:3] for viewpoint in chosen}
    others = [
        camera
        for camera in cameras
        if tuple(camera.position.astype(np.float32).tolist()) not in known
    ]
    means = splats.means[:: max(1, len(splats) // _MEASURED_SPLATS)].astype(np.float64)
    measured = sample_evenly(others, _MEASURED_CAMERAS)
    areas = [_relative_area(chosen, camera, means) for camera in measured]
    return chosen if not areas or np.median(areas) <= _MOST_AREA else ()


def _relative_area(capture: Capture, camera: Camera, means: NDArray[np.float64]) -> float:
    """Return the area of the training pixel over that of the camera's pixel, a mean over splats.

    A splat weighs as the area that it covers in the picture: by the inverse square of its distance.
    1 for a picture without splats.
    """
    means = means[in_picture(means, camera, NEAR)]
    if not len(means):
        return 1.0
    *centre, scale, rest = training_pixel(capture, camera.position).tolist()
    areas = scale * np.square(means - centre).sum(axis=1) + rest
    squared = np.square(means - camera.position).sum(axis=1)
    return float(np.average(areas * camera.focal_px**2 / squared, weights=1.0 / squared))
