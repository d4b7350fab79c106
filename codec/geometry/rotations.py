"""Unit quaternions, rotation matrices, and the 24 permutations of a Gaussian's axes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.splats import Splats

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

# Rows looked at together.
_BLOCK = 1 << 18


def unit(quats: F32) -> F32:
    """Normalise (n, 4) wxyz quaternions of any non-zero norm, with w ≥ 0."""
    wide = quats.astype(np.float64)
    # Divide by the largest entry first: squares of extreme entries overflow or underflow.
    wide /= np.abs(wide).max(axis=1, keepdims=True)
    wide /= np.sqrt(np.square(wide).sum(axis=1, keepdims=True))
    wide[wide[:, 0] < 0] *= -1
    return wide.astype(np.float32)


def normalise_extremes(splats: Splats) -> Splats:
    """Normalise the quaternions whose squared length overflows or vanishes in float32.

    Renderers, training and the encoder square quaternions in float32, so that such a quaternion
    would be another rotation, or none.

    Parameters
    ----------
    splats : Splats
        Splats, returned as they are if no quaternion's largest component is beyond 2^±30.
        Quaternions with NaN or infinity and zero quaternions are kept: `Splats.invalid_rows` finds
        them.
    """
    extreme: list[int] = []
    for start in range(0, len(splats), _BLOCK):
        largest = np.abs(splats.quats[start : start + _BLOCK]).max(axis=1)
        too_large = (largest > 2.0**30) & (largest < np.inf)
        too_small = (largest < 2.0**-30) & (largest > 0.0)
        rows = np.flatnonzero(too_large | too_small)
        extreme += (start + rows).tolist()
    if not extreme:
        return splats
    quats = splats.quats.copy()
    quats[extreme] = unit(quats[extreme])
    return replace(splats, quats=quats)


def matrices(quats: F32 | F64) -> F64:
    """Return (n, 3, 3) float64 rotation matrices of unit wxyz quaternions."""
    w, x, y, z = quats.astype(np.float64).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    out: F64 = np.moveaxis(np.array(rows), 2, 0)
    return out


def from_matrices(rotations: F64) -> F64:
    """Return (n, 4) unit wxyz quaternions, w ≥ 0, from proper rotation matrices."""
    m = rotations
    diagonal = np.stack([m[:, 0, 0], m[:, 1, 1], m[:, 2, 2]], axis=1)
    signs = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], np.float64)
    # Each of four formulas divides by one component: use the largest component.
    squares = np.maximum(1 + (diagonal[:, None, :] * signs).sum(axis=2), 0)
    largest = squares.argmax(axis=1)
    w = np.stack(
        [
            squares[:, 0],
            m[:, 2, 1] - m[:, 1, 2],
            m[:, 0, 2] - m[:, 2, 0],
            m[:, 1, 0] - m[:, 0, 1],
        ],
        axis=1,
    )
    x = np.stack([w[:, 1], squares[:, 1], m[:, 0, 1] + m[:, 1, 0], m[:, 0, 2] + m[:, 2, 0]], axis=1)
    y = np.stack([w[:, 2], x[:, 2], squares[:, 2], m[:, 1, 2] + m[:, 2, 1]], axis=1)
    z = np.stack([w[:, 3], x[:, 3], y[:, 3], squares[:, 3]], axis=1)
    out: F64 = np.stack([w, x, y, z], axis=1)[np.arange(len(m)), largest]
    out /= np.sqrt(np.square(out).sum(axis=1, keepdims=True))
    out[out[:, 0] < 0] *= -1
    return out


def multiply(a: F64, b: F64) -> F64:
    """Return the products a·b of wxyz quaternions, broadcast over leading axes."""
    aw, ax, ay, az = np.moveaxis(a, -1, 0)
    bw, bx, by, bz = np.moveaxis(b, -1, 0)
    return np.stack(
        [
            aw * bw - ax * bx - ay * by - az * bz,
            aw * bx + ax * bw + ay * bz - az * by,
            aw * by - ax * bz + ay * bw + az * bx,
            aw * bz + ax * by - ay * bx + az * bw,
        ],
        axis=-1,
    )


def _cube_group() -> tuple[F64, NDArray[np.int64]]:
    """Return the 24 rotations of a cube, (24, 4) quaternions, with their axis permutations."""
    half = np.sqrt(0.5)
    found: list[F64] = []
    generators = np.array([[half, half, 0, 0], [half, 0, half, 0], [half, 0, 0, half]])
    todo = [np.array([1.0, 0, 0, 0])]
    while todo:
        quat = todo.pop(0)
        if any(abs(abs(quat @ other) - 1) < 1e-9 for other in found):
            continue
        found.append(quat)
        todo += [multiply(quat, g) for g in generators]
    quats = np.array(found)
    turned = np.rint(matrices(quats)).astype(np.int64)
    return quats, np.abs(turned).argmax(axis=1)


_CUBE_QUATS, _CUBE_AXES = _cube_group()


def largest_w(quats: F32, scales: F32) -> tuple[F32, F32]:
    """Permute a Gaussian's axes so that w is the largest component of its quaternion.

    Permuting the axes together with their scales, or flipping two axes, leaves the Gaussian
    unchanged. Of the 24 equivalent quaternions, the one with the largest w has its remaining
    components within ±0.39, and the index of the largest component need not be stored.

    Parameters
    ----------
    quats : (n, 4) float32
        Unit quaternions, wxyz.
    scales : (n, 3) float32
        Log scales.

    Returns
    -------
    quats : (n, 4) float32
        Unit quaternions, wxyz, with w ≥ 0 the largest component.
    scales : (n, 3) float32
        Log scales, permuted like the axes.
    """
    # w of q·g for all g first; the full product only for the chosen g.
    conjugate = _CUBE_QUATS * np.array([1.0, -1, -1, -1])
    w = np.abs(np.einsum("nk,gk->ng", quats.astype(np.float64), conjugate))
    best = w.argmax(axis=1)
    chosen = multiply(quats.astype(np.float64), _CUBE_QUATS[best])
    chosen[chosen[:, 0] < 0] *= -1
    permuted = np.take_along_axis(scales, _CUBE_AXES[best], axis=1)
    return chosen.astype(np.float32), np.ascontiguousarray(permuted)
