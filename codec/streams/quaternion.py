"""Quat streams: unit quaternions stored as three of their four components (SPEC 6.6)."""

from __future__ import annotations

import struct
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError

from . import grid as grids
from . import grid_planes, scalar
from .grid import ENTRY_BYTES, Grid
from .records import ESCAPE, Attribute, Kind, StoredStream, Stream
from .stream_inputs import Inputs

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]

PER_ROW: Final = 255
"""Value of the parameter `largest` if it varies by row; a plane then stores it."""

_PARAMS: Final = struct.Struct("<B3x")


def write(rows: F32, step: float, *, escape: bool = False) -> Stream:
    """Return a quat stream.

    Parameters
    ----------
    rows : (n, 4) float32
        Unit quaternions, wxyz, w at least 0; n at least 1.
    step : float
        Largest distance between levels of a stored component.
    escape : bool
        Whether the rows are escape rows.
    """
    largest = np.abs(rows).argmax(axis=1)
    sign = np.where(rows[np.arange(len(rows)), largest] < 0, np.float32(-1), np.float32(1))
    others = rows[largest[:, None] != np.arange(4)].reshape(-1, 3) * sign[:, None]
    grid = grids.fit(others, step)
    body = scalar.write(Attribute.QUATS, others, grid)
    constant = bool((largest == largest[0]).all())
    params = _PARAMS.pack(int(largest[0]) if constant else PER_ROW) + grid.pack()
    planes = [] if constant else [largest.astype(np.uint8)]
    planes += body.planes
    flags = ESCAPE if escape else 0
    return Stream(Attribute.QUATS, Kind.QUAT, len(rows), params, planes, flags)


def parse(stream: StoredStream) -> tuple[int, Grid]:
    """Return the parameter `largest` and the grid of the three stored components.

    Raises
    ------
    FormatError
        ``stream-params``, ``quat-largest``, ``grid-value``, ``grid-levels``.
    """
    params = stream.require_params(_PARAMS.size + 3 * ENTRY_BYTES)
    (largest,) = _PARAMS.unpack(params[: _PARAMS.size])
    if (largest > 3 and largest != PER_ROW) or any(params[1 : _PARAMS.size]):
        raise FormatError(
            "quat-largest",
            f"{stream.where}: largest component {largest}, expected 0 to 3 or {PER_ROW}, "
            "and three zero bytes",
            clause="6.6",
        )
    grid = grids.unpack(params[_PARAMS.size :], 3, stream.where, max_value=1.0)
    return largest, grid


def read(stream: StoredStream, out: F32, inputs: Inputs) -> None:
    """Decode unit quaternions, wxyz with w at least 0, into (rows, 4) float32 `out`.

    Raises
    ------
    FormatError
        Codes of `parse` and `read_largest`; ``stream-planes``; ``code-range``.
    """
    largest, grid = parse(stream)
    which = read_largest(stream, largest, grid)
    others = np.empty((stream.rows, 3), np.float32)
    grid_planes.read_values(stream, grid, others, first=0 if which is None else 1)
    complete_quaternions(largest, which, others, out)


def read_largest(stream: StoredStream, largest: int, grid: Grid) -> U8 | None:
    """Return the component that each row omits, (rows,); None if all rows omit the same.

    Raises
    ------
    FormatError
        ``stream-planes``; ``quat-largest``: a number above 3.
    """
    if largest != PER_ROW:
        return None
    stream.require_planes(1 + sum(grid_planes.plane_counts(grid)))
    which = stream.plane(0, stream.rows)
    if int(which.max(initial=0)) > 3:
        raise FormatError(
            "quat-largest",
            f"{stream.where}: largest component {int(which.max())}, expected 0 to 3",
            clause="6.6",
        )
    return which


def complete_quaternions(largest: int, which: U8 | None, others: F32, out: F32) -> None:
    """Compute unit quaternions from their three stored components, into (rows, 4) `out`.

    Parameters
    ----------
    largest : int
        Number of the component that every row omits, if `which` is None.
    which : (rows,) uint8 or None
        Number of the component that each row omits.
    others : (rows, 3) float32
        Stored components, in the order wxyz without the omitted one.
    out : (rows, 4) float32
        Quaternions wxyz, w at least 0.
    """
    a, b, c = others.T
    rest = np.float32(1) - ((a * a + b * b) + c * c)
    root = np.sqrt(np.maximum(rest, np.float32(0)))
    if which is not None:
        mask = which[:, None] == np.arange(4, dtype=np.uint8)
        out[mask] = root
        out[~mask] = others.reshape(-1)
    else:
        out[:, largest] = root
        out[:, [i for i in range(4) if i != largest]] = others
    _normalise(out)


def _normalise(rows: F32) -> None:
    """Scale (n, 4) quaternions to unit length with w at least 0, in place."""
    w, x, y, z = rows.T
    norm = np.sqrt(((w * w + x * x) + y * y) + z * z)
    rows /= norm[:, None]
    flip = w < 0
    rows[flip] = -rows[flip]
