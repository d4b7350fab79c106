"""Changes of a scene's frame: axes, similarity transforms, and rotation of SH."""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.capture import moved_capture
from cogsplat.codec.errors import DataError
from cogsplat.codec.splats import MAX_SH_DEGREE, Extra, Splats, sh_coefficients

from .rotations import from_matrices, multiply
from .sh import basis

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

_OPPOSITE = {"R": "L", "L": "R", "U": "D", "D": "U", "F": "B", "B": "F"}

# Tolerance of a rotation's orthonormality; a deviation changes the colours.
_ROTATION_TOLERANCE = 1e-6

# Tolerance for rounding entries of an SH rotation to 0, 1 or -1. Float64 solves of bands of at most
# 7 bases on well-spread directions are accurate to 1e-14.
_SNAP = 1e-12

# Number of directions on which an SH rotation is solved: many times the 7 bases of the widest band.
_DIRECTIONS = 64


@dataclass(frozen=True)
class AxesChange:
    """Signed permutation of axes between two frames: ``new[i] = signs[i] * old[order[i]]``.

    Parameters
    ----------
    order : tuple of int
        Old axis of each new axis.
    signs : tuple of int
        1 if the new axis has the direction of the old one, -1 if the opposite.
    """

    order: tuple[int, int, int]
    signs: tuple[int, int, int]

    @property
    def matrix(self) -> F64:
        """Orthogonal matrix of the change, (3, 3) float64: ``new = matrix @ old``."""
        out = np.zeros((3, 3))
        out[range(3), self.order] = self.signs
        return out

    @property
    def handedness(self) -> int:
        """1 if both frames have the same handedness, -1 if they are mirror images."""
        return round(float(np.linalg.det(self.matrix)))

    @property
    def only_flips(self) -> bool:
        """Whether the change flips axes without permuting any."""
        return self.order == (0, 1, 2)

    @property
    def quat_signs(self) -> tuple[int, int, int]:
        """Signs of the x, y, z components of a quaternion, after its permutation by `order`.

        Scales are permuted by `order` too, without signs. With M the matrix of the change, R the
        rotation of a splat and S its scales, the covariance in the new frame is
        ``M R S² R' M' = (M R M') (M S² M') (M R' M')``. ``M R M'`` is a proper rotation even if M
        is a reflection.
        """
        x, y, z = (self.handedness * sign for sign in self.signs)
        return x, y, z

    def sh_signs(self, degree: int) -> F32:
        """Return signs of SH coefficients above DC, (K-1,) float32, if `only_flips` holds."""
        return np.diagonal(sh_rotation(self.matrix, degree)).astype(np.float32)


def axes_change(source: str, target: str) -> AxesChange:
    """Return the change of axes from a source frame to a target frame.

    Parameters
    ----------
    source, target : str
        Axes of the frames (`SceneInfo.axes`): one letter each of R L, U D and F B, in any order.

    Raises
    ------
    ValueError
        A name is not a valid frame.
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
    """Return whether a name has one letter for each of right/left, up/down, front/back."""
    return len(name) == 3 and all(len({a, b} & set(name)) == 1 for a, b in ("RL", "UD", "FB"))


def convert_axes(splats: Splats, axes: str) -> Splats:
    """Convert a scene to a frame with different axes, possibly of different handedness.

    Parameters
    ----------
    splats : Splats
        Scene in the frame ``splats.info.axes``.
    axes : str
        Axes of the new frame, such as ``"RUB"``.

    Returns
    -------
    Splats
        Scene with updated ``info.axes`` and ``info.origin``; `splats` itself if it has these axes.
        Values are only permuted and negated, so converting back gives the same bits. SH
        coefficients are an exception if axes are permuted: they are combined, exact to float32.

    Raises
    ------
    DataError
        ``bad-scene-info``: ``splats.info.axes`` is not a valid frame.
    ValueError
        `axes` is not a valid frame.
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
    # Files may hold signalling NaNs, which are preserved.
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
        extras=_rotate_normals(splats.extras, change.matrix),
        info=replace(
            splats.info,
            axes=axes,
            origin=(origin[0], origin[1], origin[2]),
            capture=moved_capture(splats.info.capture, change.matrix),
        ),
    )


_NORMALS: Final = ("nx", "ny", "nz")


def _rotate_normals(extras: Mapping[str, Extra], turn: F64) -> dict[str, Extra]:
    """Return extras with normals (PLY's ``nx ny nz``) rotated by the matrix `turn`."""
    turned = dict(extras)
    if all(
        name in extras and extras[name].ndim == 1 and extras[name].dtype.kind == "f"
        for name in _NORMALS
    ):
        vectors = np.stack([extras[name].astype(np.float64) for name in _NORMALS], axis=1)
        # NaN and infinite values are preserved.
        with np.errstate(invalid="ignore", over="ignore"):
            vectors = vectors @ turn.T
            for column, name in enumerate(_NORMALS):
                turned[name] = vectors[:, column].astype(extras[name].dtype)
    return turned


def sh_rotation(rotation: F64, degree: int) -> F64:
    """Return the matrix that rotates SH coefficients with a rotation of directions.

    Parameters
    ----------
    rotation : (3, 3) float64
        Orthogonal matrix, possibly a reflection.
    degree : int
        SH degree, 0 to 3.

    Returns
    -------
    (K-1, K-1) float64
        Block-diagonal matrix with a block per band. The value of ``matrix @ c`` in direction
        ``rotation @ d`` equals the value of c in direction d. Rotated bases of a band are
        combinations of the band's bases, so each block is a least-squares solution on fixed
        directions.
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
    """Rotate SH coefficients with their scene.

    Parameters
    ----------
    shN : (N, K-1, 3) float32
        Coefficients above DC of degree 0 to 3.
    rotation : (3, 3) float64
        Orthogonal matrix, possibly a reflection: ``new = rotation @ old``.

    Returns
    -------
    (N, K-1, 3) float32
        Coefficients whose colour at ``rotation @ d`` equals the old colour at d, within 1e-5;
        exactly if the rotation only flips axes.
    """
    n, count, channels = shN.shape
    degree = next(d for d in range(MAX_SH_DEGREE + 1) if sh_coefficients(d) - 1 == count)
    matrix = sh_rotation(rotation, degree)
    if np.array_equal(matrix, np.diag(np.diagonal(matrix))):
        # Files may hold signalling NaNs, which are preserved.
        with np.errstate(invalid="ignore"):
            return shN * np.diagonal(matrix).astype(np.float32)[:, None]
    # One matrix product over rows of 45 numbers is faster than many small blocks.
    whole = np.kron(matrix, np.eye(channels)).astype(np.float32)
    # NaN and infinite values are preserved.
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
        Scene to transform.
    scale : float
        Scale factor, positive.
    rotation : (3, 3) float64, optional
        Proper rotation in the scene's own axes.
    translation : tuple of float
        Translation, scene units after scaling.

    Returns
    -------
    Splats
        Scene with ``world' = scale · rotation @ world + translation``, where
        ``world = origin + means``. The translation is added to the means; the origin is scaled and
        rotated. Computed in float64 and rounded once.

    Raises
    ------
    ValueError
        The scale is not positive and finite, or the rotation is not a proper rotation.
    """
    turn = _require_rotation(rotation)
    if not (math.isfinite(scale) and scale > 0):
        raise ValueError(f"scale {scale}, expected a positive finite number")
    if not all(math.isfinite(value) for value in translation):
        raise ValueError(f"translation {translation}, expected finite numbers")
    linear = scale * turn
    x, y, z = (float(value) for value in linear @ np.array(splats.info.origin))
    # NaN and infinite values are preserved.
    with np.errstate(invalid="ignore", over="ignore"):
        means = splats.means.astype(np.float64) @ linear.T + np.array(translation)
        quats = multiply(from_matrices(turn[None])[0], splats.quats.astype(np.float64))
        return replace(
            splats,
            means=means.astype(np.float32),
            scales=(splats.scales.astype(np.float64) + math.log(scale)).astype(np.float32),
            quats=quats.astype(np.float32),
            shN=rotate_sh(splats.shN, turn),
            extras=_rotate_normals(splats.extras, turn),
            info=replace(
                splats.info,
                origin=(x, y, z),
                capture=moved_capture(splats.info.capture, linear, np.array(translation)),
            ),
        )


def transform_camera(
    camera: Camera,
    scale: float = 1.0,
    rotation: F64 | None = None,
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Camera:
    """Transform a camera with its scene, so that it shows the same image.

    Parameters
    ----------
    camera : Camera
        Camera in the scene's frame before `transform`.
    scale, rotation, translation
        Arguments of `transform`. Cameras are relative to the means, so the origin is irrelevant.

    Returns
    -------
    Camera
        Camera with the same image; its depths are multiplied by `scale`.

    Raises
    ------
    ValueError
        See `transform`.
    """
    turn = _require_rotation(rotation)
    turned = camera.rotation @ turn.T
    if not (math.isfinite(scale) and scale > 0):
        raise ValueError(f"scale {scale}, expected a positive finite number")
    target = camera.target
    return replace(
        camera,
        rotation=turned,
        translation=scale * camera.translation - turned @ np.array(translation),
        target=None if target is None else scale * turn @ target + np.array(translation),
    )


def _require_rotation(rotation: F64 | None) -> F64:
    """Return a rotation as float64, the identity for None; raise `ValueError` if it is not one."""
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
    """Return (_DIRECTIONS, 3) unit vectors spread evenly on a Fibonacci spiral."""
    k = np.arange(_DIRECTIONS) + 0.5
    z = 1 - 2 * k / _DIRECTIONS
    around = np.pi * (1 + math.sqrt(5)) * k
    ring = np.sqrt(1 - z * z)
    out = np.stack([ring * np.cos(around), ring * np.sin(around), z], axis=1)
    out.flags.writeable = False
    return out
