"""Compiled reading of rotations by three of their four components (SPEC 6.6)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .grid import MAX_LEVELS
from .kernels_bits import inner_exact, u32
from .kernels_grid import decode_values, parse_grid, plane_count
from .kernels_planes import FIRST_PLANE, PARAMS, PLANES, ChunkPlanes, plane_start, plane_starts
from .quaternion import PER_ROW

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]


@inner_exact
def read_quaternions(planes: ChunkPlanes, stream: I64, out: F32) -> bool:
    """Decode the unit quaternions of a quat stream; return False if the stream is invalid.

    Parameters
    ----------
    planes : ChunkPlanes
    stream : (6,) int64
        Row of `ChunkPlanes.records`.
    out : (n, 4) float32
    """
    data = planes.data
    rows = len(out)
    at = stream[PARAMS]
    # Number of the component that every row omits, or `PER_ROW`; three bytes of zeros follow.
    largest = u32(data, at)
    if largest > 3 and largest != PER_ROW:
        return False
    valid, grid = parse_grid(data, at + 4, 3, MAX_LEVELS, 1.0)
    first = stream[FIRST_PLANE]
    varies = 1 if largest == PER_ROW else 0
    count = stream[PLANES]
    if not valid or count != varies + plane_count(grid.levels):
        return False
    left_out = 0
    if varies:
        left_out = plane_start(planes, first, rows)
        if left_out < 0:
            return False
    starts = np.zeros(count + 1, np.int64)
    if not plane_starts(planes, first + varies, count - varies, rows, starts, 0):
        return False
    others = np.empty((rows, 3), np.float32)
    if not decode_values(data, starts, grid, others):
        return False
    one = np.float32(1)
    for row in range(rows):
        missing = int(data[left_out + row]) if varies else largest
        if missing > 3:
            return False
        a, b, c = others[row, 0], others[row, 1], others[row, 2]
        rest = one - ((a * a + b * b) + c * c)
        place = 0
        for component in range(4):
            if component == missing:
                out[row, component] = np.sqrt(rest) if rest > 0 else np.float32(0)
            else:
                out[row, component] = others[row, place]
                place += 1
        w, x, y, z = out[row, 0], out[row, 1], out[row, 2], out[row, 3]
        norm = np.sqrt(((w * w + x * x) + y * y) + z * z)
        negative = w / norm < 0
        for component in range(4):
            value = out[row, component] / norm
            out[row, component] = -value if negative else value
    return True
