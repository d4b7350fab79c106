"""Framed views: level cameras around a scene that hold the whole scene, and views from inside."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera

from .pose import level_axes
from .view_text import level_rotation

F64 = NDArray[np.float64]

# Field of view of the longer side of a framed picture, degrees.
_FOV_DEG: Final = 50.0
# Least and largest aspect ratio of a framed picture, width by height, and its number of pixels.
_NARROWEST, _WIDEST = 0.75, 16.0 / 9.0
_PIXELS: Final = 1280 * 960
# Least depth, in extents of the object along the view. The near end of the object is shown at most
# 3 times as large as the far end.
_NEAREST: Final = 0.5
# Least factor on the slopes of the picture's edges, for small objects: bounds the zoom.
_LEAST_ZOOM: Final = 1e-3
# Margin at each side, as a share of the picture.
_MARGIN: Final = 0.06
RINGS: Final = ((15.0, 12), (40.0, 6))
"""Elevations of the cameras around a scene, degrees, and the number of cameras at each."""
BELOW: Final = ((-40.0, 4),)
"""Elevations and numbers of cameras that look up at a scene from below."""

# Horizontal field of view of pictures from inside a scene, degrees, and their size, px.
_INSIDE_FOV_DEG: Final = 75.0
_INSIDE_SIZE: Final = (1280, 960)
# Pitch of the views inside a scene, degrees downwards.
_INSIDE_PITCH_DEG: Final = 8.0
# Places inside a scene: rows and columns of a level grid, and its height as a share of the scene's.
_GRID: Final = 6
_HEIGHT: Final = 0.55
# Rotations in a quarter turn that are tried for the smallest rectangle.
_TURNS: Final = 18


def framed(points: F64, centre: F64, towards: F64, up: F64, near_plane: float) -> Camera:
    """Return the level camera that looks in a direction and fits points into its picture.

    Parameters
    ----------
    points : (n, 3) float64
        Points to hold, scene units; at least one.
    centre : (3,) float64
        Point of the same depth as the camera's target, scene units.
    towards : (3,) float64
        Direction of view, a unit vector.
    up : (3,) float64
        Unit vector against gravity.
    near_plane : float
        Least depth of the points, scene units.

    Returns
    -------
    Camera
        Camera with an aspect ratio that follows the points, from 3:4 to 16:9. It keeps all points
        beyond `near_plane`; if they would be small there, it zooms in.
    """
    rotation = level_rotation(towards, up)
    seen = (points - centre) @ rotation.T
    spans = np.maximum(seen.max(axis=0) - seen.min(axis=0), 1e-12)
    aspect = min(_WIDEST, max(_NARROWEST, float(spans[0] / spans[1])))
    longer = math.tan(math.radians(0.5 * _FOV_DEG))
    slopes = np.array([longer, longer / aspect] if aspect >= 1.0 else [longer * aspect, longer])
    inner = slopes * (1.0 - 2.0 * _MARGIN)
    # Offsets of the camera from the centre: `back` against the view, `shift` across it. With both,
    # the outermost points reach the margins on both sides.
    highest = (seen[:, :2] / inner - seen[:, 2:]).max(axis=0)
    lowest = (-seen[:, :2] / inner - seen[:, 2:]).max(axis=0)
    shift = 0.5 * inner * (highest - lowest)
    back = float((0.5 * (highest + lowest)).max())
    nearest = max(near_plane, _NEAREST * float(spans[2])) - float(seen[:, 2].min())
    if back < nearest:
        # The object is small, or seen lengthwise: the camera keeps its distance and zooms in.
        back = nearest
        reach = np.abs(seen[:, :2] - shift) / (inner * (seen[:, 2:] + back))
        slopes = slopes * max(float(reach.max()), _LEAST_ZOOM)
    height = math.sqrt(_PIXELS / aspect)
    width_px, height_px = round(height * aspect), round(height)
    focal = 0.5 * width_px / float(slopes[0])
    position = centre + rotation.T @ np.array([shift[0], shift[1], -back])
    return Camera(
        width_px, height_px, focal, focal, 0.5 * width_px, 0.5 * height_px,
        rotation, -rotation @ position, "first view", position + back * towards,
    )  # fmt: skip


def around(
    points: F64,
    centre: F64,
    up: F64,
    front: F64,
    near_plane: float,
    rings: Sequence[tuple[float, int]] = RINGS,
) -> list[Camera]:
    """Return level cameras around points; each camera holds all points.

    Parameters
    ----------
    points, centre, up, near_plane
        As in `framed`.
    front : (3,) float64
        Viewing direction of the first camera; ignored if vertical.
    rings : sequence of (float, int)
        Elevations, degrees, and the number of cameras at each.
    """
    side, other = level_axes(up)
    flat = front - (front @ up) * up
    size = float(np.linalg.norm(flat))
    if size > 1e-3:
        side = flat / size
        other = np.cross(up, side)
    found = []
    for degrees, count in rings:
        elevation = math.radians(degrees)
        for number in range(count):
            angle = 2.0 * math.pi * number / count
            level = math.cos(angle) * side + math.sin(angle) * other
            towards = math.cos(elevation) * level - math.sin(elevation) * up
            found.append(framed(points, centre, towards, up, near_plane))
    return found


def places_inside(points: F64, axes: F64) -> F64:
    """Return a level grid of places in the bounding box of points along `fitting_axes`, (n, 3)."""
    low, high = (points @ axes.T).min(axis=0), (points @ axes.T).max(axis=0)
    steps = (np.arange(_GRID) + 0.5) / _GRID
    shares = np.array([(x, y, _HEIGHT) for x in steps for y in steps])
    places: F64 = (low + shares * (high - low)) @ axes
    return places


def fitting_axes(points: F64, up: F64) -> F64:
    """Return two level axes and `up`, (3, 3): axes of the smallest rectangle around points."""
    side, other = level_axes(up)
    best, smallest = np.stack([side, other, up]), math.inf
    for step in range(_TURNS):
        angle = 0.5 * math.pi * step / _TURNS
        turned = math.cos(angle) * side + math.sin(angle) * other
        axes = np.stack([turned, np.cross(up, turned), up])
        area = float(np.prod(np.ptp(points @ axes[:2].T, axis=0)))
        if area < smallest:
            best, smallest = axes, area
    return best


def inside(place: F64, angle: float, up: F64) -> Camera:
    """Return a camera at a place, looking 8 degrees below the horizon.

    Parameters
    ----------
    place : (3,) float64
        Position, scene units.
    angle : float
        Heading about `up`, radians, from the first of `level_axes`.
    up : (3,) float64
        Unit vector against gravity.
    """
    side, other = level_axes(up)
    pitch = math.radians(_INSIDE_PITCH_DEG)
    level = math.cos(angle) * side + math.sin(angle) * other
    rotation = level_rotation(math.cos(pitch) * level - math.sin(pitch) * up, up)
    width, height = _INSIDE_SIZE
    focal = 0.5 * width / math.tan(math.radians(0.5 * _INSIDE_FOV_DEG))
    return Camera(
        width, height, focal, focal, 0.5 * width, 0.5 * height,
        rotation, -rotation @ place, "first view",
    )  # fmt: skip
