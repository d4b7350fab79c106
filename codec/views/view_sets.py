"""Sets of cameras made from given ones: held out for testing, thinned, or moved off the path."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from cogsplat.codec.cameras import Camera
from cogsplat.codec.geometry.frustum import visible_depth
from cogsplat.codec.splats import Splats

from .low_discrepancy import STEP_1D

STEP_BACK = 0.3
"""How far `roam` moves a camera back, as a share of the median visible depth."""
ROTATION_DEG = 20.0
"""By what angle `roam` rotates a camera, degrees."""

Item = TypeVar("Item")


def evenly(cameras: Sequence[Item], count: int) -> list[Item]:
    """Return at most `count` cameras, one from each of so many equal runs of a sequence.

    Parameters
    ----------
    cameras : sequence
        Of cameras, or of their numbers.
    count : int
        At least 1.

    Returns
    -------
    list
        In the order of the sequence. Which of its run is taken differs from run to run: captures
        with several cameras on a rig alternate between kinds of view, and one fixed place would
        meet one kind alone.
    """
    if len(cameras) <= count:
        return list(cameras)
    run = len(cameras) / count
    return [cameras[int((k + (k + 0.5) * STEP_1D % 1.0) * run)] for k in range(count)]


def hold_out(cameras: Sequence[Camera], every: int) -> tuple[list[Camera], list[Camera]]:
    """Split cameras into training views and held-out test views, as Mip-NeRF 360 does.

    Parameters
    ----------
    cameras : sequence of Camera
        In file order.
    every : int
        Cameras with ``index % every == 0`` are held out; 0 holds out none.

    Returns
    -------
    train, held : list of Camera

    Raises
    ------
    ValueError
        A negative `every`.

    Examples
    --------
    >>> from cogsplat.codec.views.view_sets import hold_out
    >>> hold_out(["a", "b", "c", "d", "e"], 2)
    (['b', 'd'], ['a', 'c', 'e'])
    """
    if every < 0:
        raise ValueError(f"every {every}, expected 0 (none) or more")
    if every == 0:
        return list(cameras), []
    train = [camera for index, camera in enumerate(cameras) if index % every]
    return train, list(cameras[::every])


def roam(splats: Splats, cameras: Sequence[Camera]) -> list[Camera]:
    """Return views off the capture path: for every camera one moved back and one rotated.

    Parameters
    ----------
    splats : Splats
        Gives the depths.
    cameras : sequence of Camera
        In the frame of the means.

    Returns
    -------
    list of Camera
        Two for each: one moved back along its own z axis by 30 % of its `visible_depth`; and one in
        the camera's own place, rotated about its own y axis by 20°, to the right for cameras of
        even index and to the left for odd.

    Examples
    --------
    >>> from cogsplat.codec.views.view_sets import roam
    >>> import cogsplat
    >>> splats = cogsplat.read("scene.ply")
    >>> cameras = cogsplat.read_cameras("cameras.json")[:2]
    >>> [camera.name for camera in roam(splats, cameras)][:2]
    ['view_00-back', 'view_00-turned']
    """
    views: list[Camera] = []
    for index, camera in enumerate(cameras):
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


def jitter(splats: Splats, cameras: Sequence[Camera], copies: int = 2) -> list[Camera]:
    """Return the jittered copies of cameras that scoring adds to them: those of `roam`.

    Parameters
    ----------
    splats, cameras
        As in `roam`.
    copies : int
        2 for both copies of every camera; 1 for one of them, of four cameras the first moved back,
        the next rotated to the left, one to the right, and the last moved back.

    Returns
    -------
    list of Camera
        In the order of the cameras.
    """
    both = roam(splats, cameras)
    if copies == 2:
        return both
    return [both[2 * index + int(index % 4 in (1, 2))] for index in range(len(cameras))]
