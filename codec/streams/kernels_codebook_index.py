"""Compiled reading of shapes as indices into a codebook and escape rows (SPEC 6.7)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .kernels_bits import inner_exact, u32
from .kernels_planes import FIRST_PLANE, PARAMS, PLANES, ChunkPlanes, plane_starts

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]
U32 = NDArray[np.uint32]


@inner_exact
def read_indices(planes: ChunkPlanes, stream: I64, size: int, escapes: int, out: U32) -> bool:
    """Decode the indices of a vq stream into `out`, escape rows numbered from `size` on.

    Returns False if the stream is invalid.

    Parameters
    ----------
    planes : ChunkPlanes
    stream : (6,) int64
        Row of `ChunkPlanes.records`.
    size : int
        Rows of the codebook.
    escapes : int
        Escape rows of the same payload.
    out : (n,) uint32
    """
    data = planes.data
    rows = len(out)
    if u32(data, stream[PARAMS] + 4) != escapes:
        return False
    highest = size - 1 + min(escapes, 1)
    count = 0
    while highest >> 8 * count:
        count += 1
    if stream[PLANES] != count:
        return False
    starts = np.zeros(count + 1, np.int64)
    if not plane_starts(planes, stream[FIRST_PLANE], count, rows, starts, 0):
        return False
    taken = 0
    top = 0
    for row in range(rows):
        index = 0
        for byte in range(count):
            index |= int(data[starts[byte] + row]) << (8 * byte)
        top = max(top, index)
        if index == size:
            index += taken
            taken += 1
        out[row] = index
    return top <= highest and taken == escapes


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
