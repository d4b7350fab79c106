"""Description of a scene that was scaled, rotated and shifted."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import CogsplatWarning
from cogsplat.codec.geometry.transforms import transform_camera

from .description import CameraPath, Description, Georeference

F64 = NDArray[np.float64]


def move_description(
    description: Description,
    axes: str,
    scale: float,
    rotation: F64 | None,
    translation: tuple[float, float, float],
) -> Description:
    """Return the description of a moved scene: its views, places, scale, location and sky.

    Parameters
    ----------
    description : Description
        Description of the scene before it was moved.
    axes : str
        Axes of the scene, such as ``RDF``.
    scale, rotation, translation
        Arguments of `codec.geometry.transforms.transform`.
    """
    turn = np.eye(3) if rotation is None else rotation
    shift = np.array(translation)

    def camera(view: Camera) -> Camera:
        return transform_camera(view, scale, rotation, translation)

    path, reference, metres = (
        description.path,
        description.georeference,
        description.metres_per_unit,
    )
    if path is not None:
        stops = tuple(replace(stop, camera=camera(stop.camera)) for stop in path.stops)
        path = CameraPath(stops, path.loop)
    if reference is not None:
        moved = np.eye(4)
        moved[:3, :3], moved[:3, 3] = scale * turn, shift
        transform = reference.transform @ np.linalg.inv(moved)
        transform[3] = 0.0, 0.0, 0.0, 1.0
        reference = Georeference(reference.crs, transform)
    return replace(
        _with_turned_sky(description, axes, turn),
        metres_per_unit=None if metres is None else metres / scale,
        views=tuple(camera(view) for view in description.views),
        path=path,
        annotations=tuple(
            replace(
                one,
                place=scale * turn @ one.place + shift,
                view=None if one.view is None else camera(one.view),
            )
            for one in description.annotations
        ),
        georeference=reference,
    )


def _with_turned_sky(description: Description, axes: str, turn: F64) -> Description:
    """Return a description with its sky rotated by `turn`; drop a sky that cannot be rotated.

    A picture of the sky can be rotated, not mirrored: in left-handed axes it is dropped unless it
    has a rotation of its own.
    """
    sky = description.sky
    if sky is None or np.array_equal(turn, np.eye(3)):
        return description
    before = right_down_front(axes) if sky.rotation is None else sky.rotation
    after = before @ turn.T
    if np.linalg.det(after) < 0:
        warnings.warn(
            f"the sky is left out: in a scene of the axes {axes} it cannot turn with the scene",
            CogsplatWarning,
            stacklevel=3,
        )
        return replace(description, sky=None)
    return replace(description, sky=replace(sky, rotation=after))


def right_down_front(axes: str) -> F64:
    """Return the directions right, down and front in the axes of a scene, row by row (SPEC 4.2).

    Parameters
    ----------
    axes : str
        Axes such as ``RDF``.

    Examples
    --------
    >>> from cogsplat.formats.cogs.moved_description import right_down_front
    >>> right_down_front("LUF").tolist()
    [[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    rows = np.zeros((3, 3))
    for axis, letter in enumerate(axes):
        row = next(row for row, pair in enumerate(("RL", "DU", "FB")) if letter in pair)
        rows[row, axis] = 1.0 if letter in "RDF" else -1.0
    return rows
