"""Changes of a scene's frame: axes, similarity transforms, and the rotation of SH that follows."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError
from cogsplat.codec.splats import MAX_SH_DEGREE, Extra, Splats, sh_coefficients

from .rotations import from_matrices, multiply
from .sh import basis

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

_OPPOSITE = {"R": "L", "L": "R", "U": "D", "D": "U", "F": "B", "B": "F"}

# How far a given rotation may be from orthonormal; what remains of it goes into the colours.
_ROTATION_TOLERANCE = 1e-6

# Entries of an SH rotation this close to 0, 1 or -1 are meant to be it: float64 solves of bands of
# at most 7 bases on well spread directions are accurate to 1e-14.
_SNAP = 1e-12

# Directions an SH rotation is solved on, many times the 7 bases of the widest band.
_DIRECTIONS = 64


@dataclass(frozen=True)
class AxesChange:
    """A signed permutation of axes between two frames: ``new[i] = signs[i] * old[order[i]]``.

    Parameters
    ----------
    order : tuple of int
        For each new axis the old one that it is taken from.
    signs : tuple of int
        1, or -1 where the new axis points the other way.
    """

    order: tuple[int, int, int]
    signs: tuple[int, int, int]

    @property
    def matrix(self) -> F64:
        """The change of axes as an orthogonal matrix, (3, 3) float64: ``new = matrix @ old``."""
        out = np.zeros((3, 3))
        out[range(3), self.order] = self.signs
        return out

    @property
    def handedness(self) -> int:
        """1 where the frames have the same handedness, -1 where one is the other's mirror image."""
        return round(float(np.linalg.det(self.matrix)))

    @property
    def only_flips(self) -> bool:
        """Whether axes are flipped only, none of them permuted."""
        return self.order == (0, 1, 2)

    @property
    def quat_signs(self) -> tuple[int, int, int]:
        """Signs that x, y, z of quaternions are multiplied by after they are permuted.

        With R the rotation and S the scales of a splat, ``M R S² R' M'`` is also
        ``(M R M') (M S² M') (M R' M')``: the axes of the Gaussian are renamed with those of the
        frame, so rotations stay proper in a mirrored frame and no value is rounded.
        """
        x, y, z = (self.handedness * sign for sign in self.signs)
        return x, y, z

    def sh_signs(self, degree: int) -> F32:
        """Return signs of SH coefficients above DC, (K-1,) float32, where axes are only flipped."""
        return np.diagonal(sh_rotation(self.matrix, degree)).astype(np.float32)


def axes_change(source: str, target: str) -> AxesChange:
    """Return the change of axes from one frame to another.

    Parameters
    ----------
    source, target : str
        As `SceneInfo.axes`: one letter of R L, one of U D and one of F B, in any order.

    Raises
    ------
    ValueError
        One of them names no frame.
    """
    order, signs = [], []
    for name in (source, target):
        if not is_axes(name):
            raise ValueError(f"axes {name!r}, expected one each of R L, U D, F B, such as 'RDF'")
    for letter in target:
        same = letter in source
        order.append(source.index(letter if same else _OPPOSITE[letter]))
        signs.append(1 if same else -1)
    return AxesChange((order[0], order[1], order[2]), (signs[0], signs[1], signs[2]))


def is_axes(name: str) -> bool:
    """Tell whether a name has one letter for each of right/left, up/down, front/back."""
    return len(name) == 3 and all(len({a, b} & set(name)) == 1 for a, b in ("RL", "UD", "FB"))


def convert_axes(splats: Splats, axes: str) -> Splats:
    """Return a scene in a frame with other axes, which may have the other handedness.

    Parameters
    ----------
    splats : Splats
        In the frame of ``splats.info.axes``.
    axes : str
        The new frame, such as ``"RUB"``.

    Returns
    -------
    Splats
        With ``info.axes`` and ``info.origin`` to match; the scene itself where it is in that frame
        already. Values are moved and negated, so converting back gives the same bits; only SH
        coefficients are combined where axes change places, exact to float32.

    Raises
    ------
    DataError
        ``bad-scene-info``: ``splats.info.axes`` names no frame.
    ValueError
        `axes` names none.
    """
    if not is_axes(splats.info.axes):
        raise DataError(
            "bad-scene-info",
            f"axes {splats.info.axes!r}, expected one each of R L, U D, F B, such as 'RDF'",
        )
    change = axes_change(splats.info.axes, axes)
    if axes == splats.info.axes:
        return splats
    signs = np.array(change.signs, np.float32)
    quats = np.take(splats.quats, [0, *(1 + k for k in change.order)], axis=1)
    # Signalling NaN, which files may hold, passes through.
    with np.errstate(invalid="ignore"):
        quats[:, 1:] *= np.array(change.quat_signs, np.float32)
        means = np.take(splats.means, change.order, axis=1) * signs
    origin = [s * splats.info.origin[k] for s, k in zip(change.signs, change.order, strict=True)]
    return replace(
        splats,
        means=means,
        scales=np.take(splats.scales, change.order, axis=1),
        quats=quats,
        shN=rotate_sh(splats.shN, change.matrix),
        extras=_turned_normals(splats.extras, change.matrix),
        info=replace(splats.info, axes=axes, origin=(origin[0], origin[1], origin[2])),
    )


_NORMALS: Final = ("nx", "ny", "nz")


def _turned_normals(extras: Mapping[str, Extra], turn: F64) -> dict[str, Extra]:
    """Return extras with normals (PLY's ``nx ny nz``) rotated as the scene is."""
    turned = dict(extras)
    if all(
        name in extras and extras[name].ndim == 1 and extras[name].dtype.kind == "f"
        for name in _NORMALS
    ):
        vectors = np.stack([extras[name].astype(np.float64) for name in _NORMALS], axis=1)
        # NaN and infinite values stay such values.
        with np.errstate(invalid="ignore", over="ignore"):
            vectors = vectors @ turn.T
            for column, name in enumerate(_NORMALS):
                turned[name] = vectors[:, column].astype(extras[name].dtype)
    return turned


def sh_rotation(rotation: F64, degree: int) -> F64:
    """Return the matrix that rotates SH coefficients as `rotation` rotates directions.

    Parameters
    ----------
    rotation : (3, 3) float64
        Orthogonal; mirrors are allowed.
    degree : int
        0 to 3.

    Returns
    -------
    (K-1, K-1) float64
        Block diagonal, a block per band: the coefficients ``matrix @ c`` give at ``rotation @ d``
        what c gives at d. Rotated bases of a band are combinations of that band's bases, so each
        block is solved for by least squares on fixed directions.
    """
    count = sh_coefficients(degree) - 1
    out = np.zeros((count, count))
    directions = _spread_directions()
    before = basis(directions, degree)
    after = basis(directions @ np.asarray(rotation, np.float64).T, degree)
    for band in range(1, degree + 1):
        rows = slice(sh_coefficients(band - 1), sh_coefficients(band))
        block, *_ = np.linalg.lstsq(after[:, rows], before[:, rows])
        whole = np.rint(block)
        block = np.where(np.abs(block - whole) < _SNAP, whole, block)
        out[rows.start - 1 : rows.stop - 1, rows.start - 1 : rows.stop - 1] = block
    return out


def rotate_sh(shN: F32, rotation: F64) -> F32:
    """Return SH coefficients after a rotation of their scene.

    Parameters
    ----------
    shN : (N, K-1, 3) float32
        Coefficients above DC of degree 0 to 3.
    rotation : (3, 3) float64
        Orthogonal, ``new = rotation @ old``; mirrors are allowed.

    Returns
    -------
    (N, K-1, 3) float32
        A colour at ``rotation @ d`` is what it was at d, to 1e-5; to the bit where the rotation
        only flips axes.
    """
    n, count, channels = shN.shape
    degree = next(d for d in range(MAX_SH_DEGREE + 1) if sh_coefficients(d) - 1 == count)
    matrix = sh_rotation(rotation, degree)
    if np.array_equal(matrix, np.diag(np.diagonal(matrix))):
        # Signalling NaN, which files may hold, passes through as well.
        with np.errstate(invalid="ignore"):
            return shN * np.diagonal(matrix).astype(np.float32)[:, None]
    # One product for all bands and channels: rows of 45 numbers suit a matrix product better than
    # many small blocks.
    whole = np.kron(matrix, np.eye(channels)).astype(np.float32)
    # Rows with NaN or infinite values stay such rows.
    with np.errstate(invalid="ignore", over="ignore"):
        turned: F32 = shN.reshape(n, count * channels) @ whole.T
    return turned.reshape(n, count, channels)


def transform(
    splats: Splats,
    scale: float = 1.0,
    rotation: F64 | None = None,
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Splats:
    """Return a scene scaled, then rotated, then translated.

    Parameters
    ----------
    splats : Splats
        Any scene.
    scale : float
        Positive.
    rotation : (3, 3) float64, optional
        A proper rotation in the scene's own axes.
    translation : tuple of float
        Scene units after scaling.

    Returns
    -------
    Splats
        ``world' = scale · rotation @ world + translation`` with ``world = origin + means``;
        `translation` goes into the means, the origin is scaled and rotated. Float64 throughout,
        rounded once.

    Raises
    ------
    ValueError
        A scale that is not positive and finite, a rotation that is none or mirrors.
    """
    turn = _checked_rotation(rotation)
    if not (math.isfinite(scale) and scale > 0):
        raise ValueError(f"scale {scale}, expected a positive finite number")
    if not all(math.isfinite(value) for value in translation):
        raise ValueError(f"translation {translation}, expected finite numbers")
    linear = scale * turn
    x, y, z = (float(value) for value in linear @ np.array(splats.info.origin))
    # Rows with NaN or infinite values stay such rows.
    with np.errstate(invalid="ignore", over="ignore"):
        means = splats.means.astype(np.float64) @ linear.T + np.array(translation)
        quats = multiply(from_matrices(turn[None])[0], splats.quats.astype(np.float64))
        return replace(
            splats,
            means=means.astype(np.float32),
            scales=(splats.scales.astype(np.float64) + math.log(scale)).astype(np.float32),
            quats=quats.astype(np.float32),
            shN=rotate_sh(splats.shN, turn),
            extras=_turned_normals(splats.extras, turn),
            info=replace(splats.info, origin=(x, y, z)),
        )


def transform_camera(
    camera: Camera,
    scale: float = 1.0,
    rotation: F64 | None = None,
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Camera:
    """Return the camera that sees a scene after `transform` as `camera` sees it before.

    Parameters
    ----------
    camera : Camera
        In the scene's frame before.
    scale, rotation, translation
        As given to `transform`. A camera is placed relative to the means, so the origin plays no
        part.

    Returns
    -------
    Camera
        Same image; depths are `scale` times as large.

    Raises
    ------
    ValueError
        As `transform`.
    """
    turned = camera.rotation @ _checked_rotation(rotation).T
    if not (math.isfinite(scale) and scale > 0):
        raise ValueError(f"scale {scale}, expected a positive finite number")
    return replace(
        camera,
        rotation=turned,
        translation=scale * camera.translation - turned @ np.array(translation),
    )


def _checked_rotation(rotation: F64 | None) -> F64:
    if rotation is None:
        return np.eye(3)
    wide = np.asarray(rotation, np.float64)
    if wide.shape != (3, 3):
        raise ValueError(f"rotation of shape {wide.shape}, expected (3, 3)")
    error = np.abs(wide @ wide.T - np.eye(3)).max()
    if not (error <= _ROTATION_TOLERANCE and np.linalg.det(wide) > 0):
        raise ValueError(
            f"rotation off orthonormal by {error:.3g} or mirrored, "
            f"expected a proper one within {_ROTATION_TOLERANCE}"
        )
    return wide


@functools.cache
def _spread_directions() -> F64:
    """Return (_DIRECTIONS, 3) unit vectors on a Fibonacci spiral, spread evenly and unaligned."""
    k = np.arange(_DIRECTIONS) + 0.5
    z = 1 - 2 * k / _DIRECTIONS
    around = np.pi * (1 + math.sqrt(5)) * k
    ring = np.sqrt(1 - z * z)
    out = np.stack([ring * np.cos(around), ring * np.sin(around), z], axis=1)
    out.flags.writeable = False
    return out
