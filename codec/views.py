"""Sets of views: held out for judging, or roaming off the capture path."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .cameras import Camera
from .splats import Splats

# 3DGS, in_frustum; the same as `projection.NEAR`, which needs a compiler to import.
_NEAR = 0.2

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


def visible_depth(splats: Splats, camera: Camera) -> float:
    """Return the median camera-space z of the means that project into the image.

    Parameters
    ----------
    splats : Splats
        Every mean counts once, whatever its opacity and whatever hides it.
    camera : Camera
        Means nearer than 0.2 (`projection.NEAR`) do not count.

    Returns
    -------
    float
        Scene units; 0 where no mean projects into the image.
    """
    with np.errstate(all="ignore"):  # means behind the camera, or not finite, fail the tests below
        local = splats.means @ camera.rotation.T + camera.translation
        z = local[:, 2]
        x = camera.fx * local[:, 0] / z + camera.cx
        y = camera.fy * local[:, 1] / z + camera.cy
        inside = (z > _NEAR) & (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
    return float(np.median(z[inside])) if inside.any() else 0.0


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
