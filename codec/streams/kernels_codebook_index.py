"""Compiled reading of indices into a codebook followed by escape rows (SPEC 6.7)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .kernels_bits import inner_exact, u32
from .kernels_planes import (
    FIRST_PLANE,
    PARAMS,
    PLANES,
    PRESENT,
    ROWS,
    ChunkPlanes,
    plane_starts,
)

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
U32 = NDArray[np.uint32]


@inner_exact
def escape_rows(planes: ChunkPlanes, stream: I64) -> int:
    """Return the number of escape rows that a vq stream states."""
    return u32(planes.data, stream[PARAMS] + 4)


@inner_exact
def has_escapes(stream: I64, rows: int) -> bool:
    """Tell whether an escape stream has `rows` rows; it must be absent if `rows` is 0."""
    if not stream[PRESENT]:
        return rows == 0
    return rows > 0 and stream[ROWS] == rows


@inner_exact
def read_indices(planes: ChunkPlanes, stream: I64, total: int, out: U32) -> bool:
    """Decode the indices of a vq stream into `out`; return False if the stream is invalid.

    Parameters
    ----------
    planes : ChunkPlanes
    stream : (6,) int64
        Row of `ChunkPlanes.records`.
    total : int
        Rows of the codebook and escape rows.
    out : (n,) uint32
    """
    data = planes.data
    rows = len(out)
    count = 0
    while total - 1 >> 8 * count:
        count += 1
    if stream[PLANES] != count:
        return False
    starts = np.zeros(count + 1, np.int64)
    if not plane_starts(planes, stream[FIRST_PLANE], count, rows, starts, 0):
        return False
    top = 0
    for row in range(rows):
        index = 0
        for byte in range(count):
            index |= int(data[starts[byte] + row]) << (8 * byte)
        top = max(top, index)
        out[row] = index
    return top < total


@inner_exact
def gather(codebook: F32, escapes: F32, indices: U32, out: F32) -> None:
    """Copy rows by index into (n, d) `out`; indices from the codebook's size on are escape rows."""
    size = len(codebook)
    columns = out.shape[1]
    for row in range(len(indices)):
        index = int(indices[row])
        if index < size:
            for k in range(columns):
                out[row, k] = codebook[index, k]
        else:
            for k in range(columns):
                out[row, k] = escapes[index - size, k]
