"""Edits of a scene: drop invalid splats, lower the SH degree, crop, scale, rotate, translate."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError
from cogsplat.codec.geometry.transforms import transform, transform_camera
from cogsplat.codec.splats import MAX_SH_DEGREE, Splats
from cogsplat.tools.terminal.values import Box, Vector, box, vector

from .inputs import drop_invalid_splats

F64 = NDArray[np.float64]

_STILL: Vector = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class SceneEdits:
    """Edits of a scene, applied in the order of the parameters.

    Parameters
    ----------
    drop_invalid : bool
        Whether splats with invalid values are dropped.
    sh_degree : int or None
        New SH degree.
    crop : Box or None
        Box of the centres that are kept, faces included; world coordinates of the file.
    scale : float
        Positive scaling factor.
    rotate : Vector
        Angles about the fixed x, then y, then z axis, degrees, counterclockwise as seen from the
        axis' tip in a right-handed frame.
    translate : Vector
        Shift after scaling and rotating, scene units.
    """

    drop_invalid: bool = False
    sh_degree: int | None = None
    crop: Box | None = None
    scale: float = 1.0
    rotate: Vector = _STILL
    translate: Vector = _STILL

    @property
    def moves(self) -> bool:
        """Whether the edits scale, rotate or translate."""
        return (self.scale, self.rotate, self.translate) != (1.0, _STILL, _STILL)

    @property
    def changes(self) -> bool:
        """Whether there is any edit."""
        return (
            self.drop_invalid or self.sh_degree is not None or self.crop is not None or self.moves
        )

    @property
    def rotation(self) -> F64:
        """Rotation matrix, (3, 3) float64."""
        return _rotation(self.rotate)

    def apply(self, splats: Splats, where: Path) -> Splats:
        """Return the edited scene; `where` names it in messages.

        Raises
        ------
        DataError
            ``no-valid-rows`` or ``empty-crop``: no splat is left; ``moved-too-far``: a moved centre
            exceeds float32.
        """
        if self.drop_invalid:
            splats = drop_invalid_splats(splats, where)
        if self.sh_degree is not None:
            splats = splats.with_sh_degree(self.sh_degree)
        if self.crop is not None:
            splats = _cropped(splats, self.crop, where)
        if self.moves:
            splats = self._transform(splats, where)
        return splats

    def _transform(self, splats: Splats, where: Path) -> Splats:
        """Return the scaled, rotated and translated scene."""
        turn = None if self.rotate == _STILL else self.rotation
        moved = transform(splats, self.scale, turn, self.translate)
        lost = np.isfinite(splats.means).all(axis=1) & ~np.isfinite(moved.means).all(axis=1)
        if lost.any():
            raise DataError(
                "moved-too-far",
                f"{where}: {int(lost.sum()):,} centres exceed float32 after --scale, --rotate and "
                "--translate, expected smaller numbers",
            )
        return moved

    def camera(self, camera: Camera) -> Camera:
        """Return a camera moved with the scene, so that its picture stays the same."""
        if not self.moves:
            return camera
        turn = None if self.rotate == _STILL else self.rotation
        return transform_camera(camera, self.scale, turn, self.translate)


def edit_options(command: Callable[..., object]) -> Callable[..., object]:
    """Add ``--drop-invalid --sh --crop --scale --rotate --translate``, passed on as ``edits``."""

    @functools.wraps(command)
    def edited(
        *,
        drop_invalid: bool,
        sh_degree: int | None,
        crop: Box | None,
        scale: float,
        rotate: Vector,
        translate: Vector,
        **others: object,
    ) -> object:
        edits = SceneEdits(drop_invalid, sh_degree, crop, scale, rotate, translate)
        return command(edits=edits, **others)

    options = [
        click.option(
            "--drop-invalid", is_flag=True, help="Leave out splats with NaN or infinite values."
        ),
        click.option(
            "--sh",
            "sh_degree",
            type=click.IntRange(0, MAX_SH_DEGREE),
            metavar="0..3",
            help="Lower the SH degree to this.",
        ),
        click.option(
            "--crop",
            type=box,
            metavar="XMIN,YMIN,ZMIN,XMAX,YMAX,ZMAX",
            help="Keep splats with centres in this box; applied before --scale.",
        ),
        click.option(
            "--scale",
            type=scale_factor,
            default="1",
            metavar="S",
            help="Scale the scene about the origin.",
        ),
        click.option(
            "--rotate",
            type=vector,
            default="0,0,0",
            metavar="AX,AY,AZ",
            help="Rotate the scaled scene, degrees about the x, then the y, then the z axis.",
        ),
        click.option(
            "--translate",
            type=vector,
            default="0,0,0",
            metavar="X,Y,Z",
            help="Shift the rotated scene, scene units.",
        ),
    ]
    decorated: Callable[..., object] = edited
    for option in reversed(options):
        decorated = option(decorated)
    return decorated


def scale_factor(text: str) -> float:
    """Parse a positive finite number.

    Raises
    ------
    click.BadParameter
        The text is no positive finite number.
    """
    try:
        value = float(text)
    except ValueError:
        value = 0.0
    if not (math.isfinite(value) and value > 0):
        raise click.BadParameter(f"{text!r}, expected a positive number")
    return value


def _cropped(splats: Splats, limits: Box, where: Path) -> Splats:
    """Return the splats with centres in a box."""
    inside = inside_box(splats, limits)
    kept = int(inside.sum())
    if not kept and len(splats):
        raise DataError(
            "empty-crop", f"{where}: none of {len(splats):,} splats is in --crop, expected some"
        )
    return splats if kept == len(splats) else splats.take(inside)


def inside_box(splats: Splats, limits: Box) -> NDArray[np.bool_]:
    """Mark splats whose centres lie in a box of world coordinates, its faces included.

    Returns
    -------
    (N,) bool
        False for rows with NaN.
    """
    world = splats.means.astype(np.float64) + np.array(splats.info.origin)
    inside: NDArray[np.bool_] = ((world >= limits[:3]) & (world <= limits[3:])).all(axis=1)
    return inside


def _rotation(degrees: Vector) -> F64:
    """Return the matrix that rotates about the x, then the y, then the z axis, (3, 3) float64."""
    turn = np.eye(3)
    for axis, angle in enumerate(degrees):
        # Exact for multiples of 90 degrees, so that rotated values are not rounded.
        cos, sin = (_exact(f(math.radians(math.fmod(angle, 360.0)))) for f in (math.cos, math.sin))
        one = np.eye(3)
        a, b = (axis + 1) % 3, (axis + 2) % 3
        one[a, a], one[a, b], one[b, a], one[b, b] = cos, -sin, sin, cos
        turn = one @ turn
    return turn


def _exact(value: float) -> float:
    """Remove rounding errors from values near -1, 0 and 1: cos(π/2) is 6e-17 in float64."""
    whole = round(value)
    return float(whole) if abs(value - whole) < 1e-15 else value
