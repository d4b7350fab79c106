"""Byte planes of codes on a grid, up to three for each component (SPEC 6.4)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError

from .grid import Grid
from .records import StoredStream

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]
U32 = NDArray[np.uint32]
Codes = NDArray[np.uint8] | NDArray[np.uint32] | NDArray[np.uint64]


def code_bytes(levels: int) -> int:
    """Return the number of bytes of a code below `levels`, 0 to 3; each byte has its own plane."""
    return (max(levels, 1) - 1).bit_length() + 7 >> 3


def split_planes(codes: U32, levels: int) -> list[U8]:
    """Return the byte planes of (n,) codes below `levels`, the lowest byte first."""
    return [
        ((codes >> np.uint32(8 * byte)) & np.uint32(0xFF)).astype(np.uint8)
        for byte in range(code_bytes(levels))
    ]


def join_planes(planes: list[U8], rows: int) -> U32:
    """Return the (rows,) uint32 codes of byte planes, lowest byte first; zeros without planes."""
    if not planes:
        return np.zeros(rows, np.uint32)
    codes = planes[0].astype(np.uint32)
    for byte, plane in enumerate(planes[1:], start=1):
        codes |= plane.astype(np.uint32) << np.uint32(8 * byte)
    return codes


def split_components(codes: U32, grid: Grid) -> list[U8]:
    """Return the byte planes of (n, c) codes of a grid, component by component."""
    planes: list[U8] = []
    for component in range(grid.components):
        planes += split_planes(codes[:, component], int(grid.levels[component]))
    return planes


def plane_counts(grid: Grid, extra: int = 0) -> list[int]:
    """Return the number of planes of each component with `extra` codes above its levels."""
    return [code_bytes(levels + extra) for levels in grid.levels.tolist()]


def require_codes(codes: Codes, limit: int, where: str, clause: str) -> None:
    """Check that all codes are below a limit.

    Raises
    ------
    FormatError
        ``code-range``: a code is not below the limit.
    """
    largest = int(codes.max(initial=0))
    if largest >= limit:
        raise FormatError(
            "code-range", f"{where}: code {largest}, expected below {limit}", clause=clause
        )


def _codes(
    stream: StoredStream, first: int, counts: Sequence[int], component: int, limit: int
) -> Codes:
    """Return the (rows,) codes of one component, checked to be below a limit."""
    count = counts[component]
    start = first + sum(counts[:component])
    planes = [stream.plane(start + byte, stream.rows) for byte in range(count)]
    codes = planes[0] if count == 1 else join_planes(planes, stream.rows)
    # The check is needless if every code that fits the planes is valid.
    if limit < 1 << (8 * count) and int(codes.max(initial=0)) >= limit:
        require_codes(codes, limit, f"{stream.where}, component {component}", "6.4")
    return codes


def read_values(
    stream: StoredStream, grid: Grid, out: F32, *, first: int = 0, extra: int = 0
) -> None:
    """Decode the values of a stream on a grid into `out`.

    Parameters
    ----------
    stream : StoredStream
        Its planes from `first` on are the planes of the grid.
    grid : Grid
        Grid of the stream.
    out : (rows, c) float32
        Decoded values; may be a strided view.
    first : int
        Number of planes before the planes of the grid.
    extra : int
        Number of codes above the levels of each component: 2 for +inf and -inf, else 0.

    Raises
    ------
    FormatError
        ``stream-planes``, ``code-range``.
    """
    counts = plane_counts(grid, extra)
    stream.require_planes(first + sum(counts))
    # Component by component, so that only the copy into `out` strides.
    values = np.zeros((grid.components, stream.rows), np.float32)
    limits = [levels + extra for levels in grid.levels.tolist()]
    for component, count in enumerate(counts):
        if count:
            values[component] = _codes(stream, first, counts, component, limits[component])
    codes = values.copy() if extra else values
    values *= grid.step[:, None]
    # A minimum of -0 becomes +0 by the sum, as SPEC 6.4 has it.
    values += grid.minimum[:, None]
    if extra:
        levels = grid.levels.astype(np.float32)[:, None]
        values[codes == levels] = np.inf
        values[codes == levels + 1] = -np.inf
    out[:] = values.T


def read_codes(stream: StoredStream, grid: Grid) -> U32:
    """Return the (rows, c) codes of a stream on a grid.

    Raises
    ------
    FormatError
        ``stream-planes``, ``code-range``.
    """
    counts = plane_counts(grid)
    stream.require_planes(sum(counts))
    out = np.zeros((stream.rows, grid.components), np.uint32)
    for component in range(grid.components):
        limit = int(grid.levels[component])
        out[:, component] = _codes(stream, 0, counts, component, limit)
    return out
