"""Unit quaternions, rotation matrices, and the 24 permutations of a Gaussian's axes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


def unit(quats: F32) -> F32:
    """Return (n, 4) unit wxyz quaternions with w ≥ 0, for any non-zero norm."""
    wide = quats.astype(np.float64)
    # The largest entry first: its square may overflow or vanish in a file's denormal rows.
    wide /= np.abs(wide).max(axis=1, keepdims=True)
    wide /= np.sqrt(np.square(wide).sum(axis=1, keepdims=True))
    wide[wide[:, 0] < 0] *= -1
    return wide.astype(np.float32)


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
    """Return (n, 4) unit wxyz quaternions, w ≥ 0, of proper rotation matrices."""
    m = rotations
    diagonal = np.stack([m[:, 0, 0], m[:, 1, 1], m[:, 2, 2]], axis=1)
    signs = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], np.float64)
    # Four ways to compute the quaternion, each divided by one component: use the largest.
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
    """Return the wxyz products a·b, broadcast over leading axes."""
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
    """Return the 24 rotations of a cube and the permutation of the scales that goes with each."""
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

    Permuting the axes together with their scales, or flipping two of them, leaves the Gaussian
    unchanged. Of the 24 proper ways the one with the largest w leaves the other three components
    within ±0.39, and no index of the largest to store.

    Parameters
    ----------
    quats : (n, 4) float32
        Unit, wxyz.
    scales : (n, 3) float32
        Log.

    Returns
    -------
    quats : (n, 4) float32
        Unit, wxyz, w ≥ 0 and the largest.
    scales : (n, 3) float32
        Permuted to match.
    """
    # w of q·g for every g at once; the products are made for the chosen g alone.
    conjugate = _CUBE_QUATS * np.array([1.0, -1, -1, -1])
    w = np.abs(np.einsum("nk,gk->ng", quats.astype(np.float64), conjugate))
    best = w.argmax(axis=1)
    chosen = multiply(quats.astype(np.float64), _CUBE_QUATS[best])
    chosen[chosen[:, 0] < 0] *= -1
    permuted = np.take_along_axis(scales, _CUBE_AXES[best], axis=1)
    return chosen.astype(np.float32), np.ascontiguousarray(permuted)
