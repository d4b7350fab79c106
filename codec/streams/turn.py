"""Rotations as a tilt and a spin about the longest axis, as fine as the shape asks (SPEC 6.11)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.geometry import rotations

from . import bit_fields
from .adaptive_step import MAX_HALVINGS

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]
U32 = NDArray[np.uint32]

SYMBOL_HALVINGS: Final = 6
"""Halvings up to here are coded as symbols; what is finer are plain bits (SPEC 6.11)."""


STEPS: Final = np.ldexp(np.float32(2), -np.arange(MAX_HALVINGS + 1)).astype(np.float32)
"""What a code is worth after each number of halvings, float32."""


def canonical(quats: F32, scales: F32) -> tuple[F64, F32]:
    """Rename axes to (middle, thin, long), tilted by at most 90° and spun by at most 90°.

    Parameters
    ----------
    quats : (n, 4) float32
        Unit, wxyz.
    scales : (n, 3) float32
        Log.

    Returns
    -------
    turns : (n, 3) float64
        Tilt (a, b) and spin c: the quaternion is (1, a, b, 0)·(1, 0, 0, c), normalised; a² + b²
        and |c| are at most 1.
    scales : (n, 3) float32
        Permuted: middle, thin, long.
    """
    order = np.argsort(scales, axis=1, kind="stable")[:, [1, 0, 2]]
    permuted = np.take_along_axis(scales, order, axis=1)
    axes = np.take_along_axis(rotations.matrices(quats), order[:, None, :], axis=2)
    # A permutation may mirror; turning one axis round mends it.
    axes[np.linalg.det(axes) < 0, :, 0] *= -1
    # Long axis up (tilt within 90°): turn the long and the middle axis round together.
    down = axes[:, 2, 2] < 0
    axes[down, :, 2] *= -1
    axes[down, :, 0] *= -1
    quat = rotations.from_matrices(axes)
    # Half a turn about the long axis changes nothing: (w, z) becomes (-z, w).
    spun = np.abs(quat[:, 3]) > np.abs(quat[:, 0])
    w, x, y, z = quat[spun].T
    quat[spun] = np.stack([-z, y, -x, w], axis=1)
    quat[quat[:, 0] < 0] *= -1
    w, x, y, z = quat.T
    c = z / w
    scale = 1 + c * c
    a = (x / w - c * y / w) / scale
    b = (y / w + c * x / w) / scale
    return np.stack([a, b, c], axis=1), np.ascontiguousarray(permuted)


def quats_of(turns: F32) -> F32:
    """Return the (n, 4) unit quaternions of (n, 3) float32 turns (SPEC 6.11)."""
    a, b, c = turns.T
    out = np.empty((len(turns), 4), np.float32)
    out[:, 0] = 1
    out[:, 1] = a + b * c
    out[:, 2] = b - a * c
    out[:, 3] = c
    w, x, y, z = out.T
    norm = np.sqrt(((w * w + x * x) + y * y) + z * z)
    out /= norm[:, None]
    return out


def quantise(values: F64, halvings: U8) -> U32:
    """Return the codes of values in ±1 on ``2^halvings + 1`` levels; no halvings, one level, 0."""
    half = np.ldexp(0.5, halvings.astype(np.int32))
    codes = np.rint((values + 1) * half)
    codes = np.clip(codes, 0, 2 * half)
    return np.where(halvings > 0, codes, 0).astype(np.uint32)


def dequantise(codes: U32, halvings: U8) -> F32:
    """Return ``code · 2^(1 - halvings) - 1`` in float32, 0 where there are no halvings."""
    values = codes.astype(np.float32) * STEPS[halvings] - np.float32(1)
    return np.where(halvings > 0, values, np.float32(0))


def split(codes: U32, halvings: U8) -> tuple[list[U8], U8]:
    """Return symbol planes by halvings, the lowest first, and the plane of plain bits.

    Parameters
    ----------
    codes : (n,) uint32
    halvings : (n,) uint8

    Returns
    -------
    planes : list of uint8 arrays
        For each 1 ≤ m ≤ `SYMBOL_HALVINGS` that occurs, capped there, the rows' high bits.
    rest : uint8 array
        The low bits of rows with more halvings.
    """
    spare = _spare(halvings)
    symbols = (codes >> spare).astype(np.uint8)
    planes = [symbols[rows] for rows in groups(halvings)]
    rest = bit_fields.pack(codes.astype(np.uint64), spare)
    return planes, rest


def join(planes: list[U8], rest: U8, halvings: U8, where: str) -> U32:
    """Return the codes that `split` stored; symbols out of range give codes out of range."""
    codes = np.zeros(len(halvings), np.uint32)
    capped = np.minimum(halvings, SYMBOL_HALVINGS)
    # Rows by group, in a group as they come.
    order = np.argsort(capped, kind="stable")
    coded = sum(map(len, planes))
    if coded:
        codes[order[len(order) - coded :]] = np.concatenate(planes)
    spare = halvings - capped
    low = bit_fields.unpack(rest, spare, where).astype(np.uint32)
    return (codes << spare) | low


def groups(halvings: U8) -> list[NDArray[np.bool_]]:
    """Return the rows of each symbol plane: halvings 1, 2, … `SYMBOL_HALVINGS` and above."""
    capped = np.minimum(halvings, SYMBOL_HALVINGS)
    present = np.bincount(capped, minlength=SYMBOL_HALVINGS + 1)
    return [capped == m for m in range(1, SYMBOL_HALVINGS + 1) if present[m]]


def group_rows(halvings: U8) -> list[int]:
    """Return the number of rows of each symbol plane, as `groups` has them."""
    rows = np.bincount(np.minimum(halvings, SYMBOL_HALVINGS), minlength=SYMBOL_HALVINGS + 1)
    return [n for n in rows[1:].tolist() if n]


def rest_bytes(halvings: U8) -> int:
    """Return the length in bytes of the plane of plain bits."""
    return bit_fields.packed_bytes(_spare(halvings))


def _spare(halvings: U8) -> U8:
    return halvings - np.minimum(halvings, SYMBOL_HALVINGS)
