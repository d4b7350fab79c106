"""Random views near given cameras, for training in poses that the cameras do not have."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.render.visible_depth import visible_depth
from cogsplat.codec.splats import Splats

F64 = NDArray[np.float64]

# Neighbours of each camera between which views are drawn.
_NEIGHBOURS: Final = 5
# On the path: standard deviation of the shift per axis, as a share of the distance of two cameras
# or of the visible depth, whichever is less; and of yaw and pitch, degrees.
_PATH_SHIFT: Final = 0.08
_PATH_YAW_DEG, _PATH_PITCH_DEG = 4.0, 2.0
# Off the path: the same standard deviation; maximum yaw and pitch, degrees; and the range of
# movements along the viewing axis, as shares of the visible depth: towards what is seen, and back.
_SHIFT: Final = 0.15
_YAW_DEG, _PITCH_DEG = 25.0, 8.0
_TOWARDS, _BACK = 0.1, 0.4


class ViewDrawer:
    """Source of random views near given cameras.

    Parameters
    ----------
    splats : Splats
        Scene, from which visible depths are measured.
    cameras : sequence of Camera
        Cameras in the frame of the means, at least 1.

    Examples
    --------
    >>> import numpy as np
    >>> import cogsplat
    >>> from cogsplat.codec.views.drawn_views import ViewDrawer
    >>> splats = cogsplat.read("scene.ply")
    >>> drawer = ViewDrawer(splats, cogsplat.read_cameras("cameras.json"))
    >>> drawer.draw(np.random.default_rng(0), off_path=True).width
    64
    """

    def __init__(self, splats: Splats, cameras: Sequence[Camera]) -> None:
        self._cameras = tuple(cameras)
        self._depths = [visible_depth(splats, camera) for camera in cameras]
        self._neighbours = _neighbours(cameras)

    def draw(self, rng: np.random.Generator, *, off_path: bool) -> Camera:
        """Draw a view between a random camera and one of its neighbours.

        Parameters
        ----------
        rng : numpy.random.Generator
            Source of random numbers.
        off_path : bool
            False for a view near the line between the two, with nearly their rotation. True for
            one that is also turned away, up to 25° to the sides and 8° up or down, and moved
            forwards by up to 10 % of the visible depth or back by up to 40 %.

        Returns
        -------
        Camera
            View with the intrinsics of the first of the two cameras.
        """
        number = int(rng.integers(len(self._cameras)))
        other = int(rng.choice(self._neighbours[number]))
        share = float(rng.random())
        camera, neighbour = self._cameras[number], self._cameras[other]
        rotation = _mean_rotation(camera.rotation, neighbour.rotation, share)
        position = (1 - share) * camera.position + share * neighbour.position
        depth = (1 - share) * self._depths[number] + share * self._depths[other]
        reach = min(float(np.linalg.norm(neighbour.position - camera.position)), depth)
        if off_path:
            yaw, pitch = rng.uniform(-1.0, 1.0, 2) * (_YAW_DEG, _PITCH_DEG)
            shift = rng.normal(0.0, _SHIFT * reach, 3)
            along = float(rng.uniform(-_BACK, _TOWARDS)) * depth
        else:
            yaw, pitch = rng.normal(0.0, 1.0, 2) * (_PATH_YAW_DEG, _PATH_PITCH_DEG)
            shift = rng.normal(0.0, _PATH_SHIFT * reach, 3)
            along = 0.0
        rotation = _turn(math.radians(yaw), math.radians(pitch)) @ rotation
        position = position + shift + along * rotation[2]
        return replace(
            camera,
            rotation=rotation,
            translation=-rotation @ position,
            name=f"{camera.name}-drawn",
        )


def _neighbours(cameras: Sequence[Camera]) -> list[NDArray[np.int64]]:
    """Return the numbers of the cameras of most similar pose for each camera; itself if alone."""
    positions = np.array([camera.position for camera in cameras])
    directions = np.array([camera.rotation[2] for camera in cameras])
    spread = float(np.linalg.norm(positions - positions.mean(axis=0), axis=1).mean())
    found = []
    for number in range(len(cameras)):
        distances = np.linalg.norm(positions - positions[number], axis=1)
        distances += spread * (1.0 - directions @ directions[number])
        distances[number] = np.inf
        count = max(min(_NEIGHBOURS, len(cameras) - 1), 1)
        found.append(np.argsort(distances, kind="stable")[:count])
    return found


def _mean_rotation(one: F64, other: F64, share: float) -> F64:
    """Return the rotation nearest to the mean of two; `share` is the weight of the second."""
    left, _, right = np.linalg.svd((1 - share) * one + share * other)
    mean: F64 = left @ np.diag([1.0, 1.0, float(np.linalg.det(left @ right))]) @ right
    return mean


def _turn(yaw: float, pitch: float) -> F64:
    """Return the rotation of a camera about its y axis, then about its x axis, radians."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    about_y = np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])
    cos, sin = math.cos(pitch), math.sin(pitch)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cos, -sin], [0.0, sin, cos]])
    turn: F64 = about_x @ about_y
    return turn
