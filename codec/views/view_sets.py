"""Sets of views: held out for judging, or roaming off the capture path."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from cogsplat.codec.cameras import Camera
from cogsplat.codec.geometry.frustum import visible_depth
from cogsplat.codec.splats import Splats

# Multiples of it, less their whole part, spread evenly over 0 to 1.
_GOLDEN: Final = 0.6180339887498949


def evenly(cameras: Sequence[Camera], count: int) -> list[Camera]:
    """Return at most `count` cameras, one from each of so many equal runs of a sequence.

    Not the same place in each run: shells and capture rigs alternate between kinds of view.
    """
    if len(cameras) <= count:
        return list(cameras)
    run = len(cameras) / count
    return [cameras[int((k + (k + 0.5) * _GOLDEN % 1.0) * run)] for k in range(count)]


# Roam views: the share of the median visible depth to move back by, and the turn.
STEP_BACK = 0.3
TURN_DEG = 20.0


def hold_out(cameras: Sequence[Camera], every: int) -> tuple[list[Camera], list[Camera]]:
    """Split cameras into those to score on and those to judge by.

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
    """
    if every < 0:
        raise ValueError(f"every {every}, expected 0 (none) or more")
    if every == 0:
        return list(cameras), []
    train = [camera for index, camera in enumerate(cameras) if index % every]
    return train, list(cameras[::every])


def roam(splats: Splats, cameras: Sequence[Camera]) -> list[Camera]:
    """Return views off the capture path: every camera moved back, and every camera turned.

    Parameters
    ----------
    splats : Splats
        Gives the depths.
    cameras : sequence of Camera
        In the frame of the means.

    Returns
    -------
    list of Camera
        Two for each: moved back along its own z axis by 30 % of its `visible_depth`, and, where it
        stood, turned about its own y axis by 20°, to the right for cameras of even index and to
        the left for odd.
    """
    views: list[Camera] = []
    for index, camera in enumerate(cameras):
        depth = visible_depth(splats, camera)
        moved = camera.translation + np.array([0.0, 0.0, STEP_BACK * depth])
        views.append(replace(camera, translation=moved, name=f"{camera.name}-back"))
        angle = math.radians(TURN_DEG if index % 2 == 0 else -TURN_DEG)
        cos, sin = math.cos(angle), math.sin(angle)
        turn = np.array([[cos, 0.0, -sin], [0.0, 1.0, 0.0], [sin, 0.0, cos]])
        views.append(
            replace(
                camera,
                rotation=turn @ camera.rotation,
                translation=turn @ camera.translation,
                name=f"{camera.name}-turned",
            )
        )
    return views


def jitter(splats: Splats, cameras: Sequence[Camera]) -> list[Camera]:
    """Return the copies of scoring cameras that are scored too: the rule of `roam`."""
    return roam(splats, cameras)
