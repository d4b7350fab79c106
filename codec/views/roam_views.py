"""Views off the capture path: copies of cameras, moved back or rotated."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from cogsplat.codec.cameras import Camera
from cogsplat.codec.render.visible_depth import visible_depth
from cogsplat.codec.splats import Splats

STEP_BACK = 0.3
"""Distance by which `roam` moves a camera back, as a share of its median visible depth."""
ROTATION_DEG = 20.0
"""Angle by which `roam` rotates a camera, degrees."""


def roam(splats: Splats, cameras: Sequence[Camera], first: int = 0) -> list[Camera]:
    """Return views off the capture path: two copies of every camera, moved back and rotated.

    Parameters
    ----------
    splats : Splats
        Scene, from which visible depths are measured.
    cameras : sequence of Camera
        Cameras in the frame of the means.
    first : int
        Number of the first camera: even numbers are rotated to the right, odd ones to the left.

    Returns
    -------
    list of Camera
        Two copies of each camera. The first is moved back along its z axis by 30 % of its
        `visible_depth`. The second is rotated about its y axis by 20°, to the right if the
        camera's index is even, else to the left.

    Examples
    --------
    >>> from cogsplat.codec.views.roam_views import roam
    >>> import cogsplat
    >>> splats = cogsplat.read("scene.ply")
    >>> cameras = cogsplat.read_cameras("cameras.json")[:2]
    >>> [camera.name for camera in roam(splats, cameras)][:2]
    ['view_00-back', 'view_00-turned']
    """
    views: list[Camera] = []
    for index, camera in enumerate(cameras, first):
        depth = visible_depth(splats, camera)
        moved = camera.translation + np.array([0.0, 0.0, STEP_BACK * depth])
        views.append(replace(camera, translation=moved, name=f"{camera.name}-back"))
        angle = math.radians(ROTATION_DEG if index % 2 == 0 else -ROTATION_DEG)
        cos, sin = math.cos(angle), math.sin(angle)
        rotation = np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])
        views.append(
            replace(
                camera,
                rotation=rotation @ camera.rotation,
                translation=rotation @ camera.translation,
                name=f"{camera.name}-turned",
            )
        )
    return views


def jitter(
    splats: Splats, cameras: Sequence[Camera], copies: int = 2, first: int = 0
) -> list[Camera]:
    """Return jittered copies of cameras, which scoring adds: moved back or rotated.

    Parameters
    ----------
    splats, cameras, first
        See `roam`.
    copies : int
        Copies per camera: 2 for both copies of `roam`, 1 for one of the two. The camera's index
        modulo 4 chooses it: moved back (0 and 3), rotated left (1) or rotated right (2).

    Returns
    -------
    list of Camera
        Copies in the order of the cameras.
    """
    both = roam(splats, cameras, first)
    if copies == 2:
        return both
    turned = [int((first + index) % 4 in (1, 2)) for index in range(len(cameras))]
    return [both[2 * index + kind] for index, kind in enumerate(turned)]
