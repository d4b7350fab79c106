"""Compiled reading of shN from coordinates on a basis (SPEC 6.14)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.compiling import called_with

from . import shn_transform
from .inputs import Inputs
from .kernels_bits import exact, inner_exact
from .kernels_planes import join_run
from .records import StoredStream

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]

BASIS_COLUMNS: Final = 48
"""Columns of a basis as the kernel takes it: 45 and zeros, a multiple of the vector width."""

_FULL_COLUMNS: Final = 45


@inner_exact
def _coordinate(symbol: int, step: np.float32, shrink: np.float32) -> np.float32:
    magnitude = np.float32((symbol + 1) >> 1)
    value = (magnitude - shrink) * step if symbol > 0 else np.float32(0) * step
    return value if symbol & 1 else -value


@inner_exact
def _code(planes: U8, begin: I64, place: int, count: int) -> int:
    code = 0
    for byte in range(count):
        code |= int(planes[begin[byte] + place]) << (8 * byte)
    return code


@called_with("Array(uint8, 1, 'C', True), int64")
@exact
def rows_above(ends: U8, width: int) -> I64:
    """Return how many rows have more coordinates than 0, 1, … `width`, and a 0 behind."""
    counts = np.zeros(width + 2, np.int64)
    for row in range(len(ends)):
        if ends[row]:
            counts[ends[row] - 1] += 1
    for column in range(width - 1, -1, -1):
        counts[column] += counts[column + 1]
    return counts


@called_with(
    "Array(uint8, 1, 'C', True), int64[::1], int64[::1], Array(uint8, 1, 'C', True), "
    "Array(uint8, 1, 'C', True), int64[::1], float32[:, ::1], float32, float32, float32[:, ::1]"
)
@exact
def coefficients(
    ends: U8,
    more: I64,
    groups: I64,
    sizes: U8,
    planes: U8,
    starts: I64,
    basis: F32,
    step: np.float32,
    shrink: np.float32,
    out: F32,
) -> None:
    """Write shN from coordinates on a basis (SPEC 6.14).

    Parameters
    ----------
    ends : (n,) uint8
        Coordinates of each row, at most the width.
    more : (width + 2,) int64
        As `rows_above` returns it.
    groups : (g + 1,) int64
        First column of each group, and the width.
    sizes : (2g,) uint8
        Bytes of a symbol, before the last coordinate and in it, of each group.
    planes : uint8
    starts : int64
        Where each plane of symbols begins; their lengths follow from the above.
    basis : (width, BASIS_COLUMNS) float32
    step, shrink : float32
    out : (n, at most BASIS_COLUMNS) float32
    """
    width = groups[-1]
    # A length that is known is a loop without a remainder.
    full = out.shape[1] == _FULL_COLUMNS
    # Where the bytes of each column's symbols start, by part.
    begin = np.zeros((2, width + 1, 3), np.int64)
    size = np.zeros((2, width + 1), np.int64)
    plane = 0
    for group in range(len(groups) - 1):
        for part in range(2):
            length = 0
            for column in range(groups[group], groups[group + 1]):
                count = int(sizes[2 * group + part])
                size[part, column] = count
                for byte in range(count):
                    begin[part, column, byte] = starts[plane + byte] + length
                inner = more[column + 1]
                length += more[column] - inner if part else inner
            plane += sizes[2 * group + part]
    table = np.empty((2, 256), np.float32)
    for symbol in range(256):
        table[0, symbol] = _coordinate(symbol, step, shrink)
        table[1, symbol] = _coordinate(symbol + 1, step, shrink)
    rank = more.copy()
    sums = np.empty(BASIS_COLUMNS, np.float32)
    which = np.empty(width + 1, np.int64)
    worth = np.empty(width + 1, np.float32)
    for row in range(len(ends)):
        end = int(ends[row])
        if end == 0:
            for k in range(out.shape[1]):
                out[row, k] = 0
            continue
        place = rank[end]
        rank[end] += 1
        # About half of the coordinates are 0 and add nothing: sums start at +0, so that no sign
        # of a zero is lost either. Gathered first without a branch that could not be predicted.
        used = 0
        for column in range(end - 1):
            count = size[0, column]
            if count == 1:
                symbol = int(planes[begin[0, column, 0] + place])
            else:
                symbol = _code(planes, begin[0, column], place, count)
            which[used] = column
            if symbol < 256:
                worth[used] = table[0, symbol]
            else:
                worth[used] = _coordinate(symbol, step, shrink)
            used += symbol != 0
        for k in range(BASIS_COLUMNS):
            sums[k] = 0
        for i in range(used):
            value = worth[i]
            column = which[i]
            for k in range(BASIS_COLUMNS):
                sums[k] = sums[k] + value * basis[column, k]
        column = end - 1
        count = size[1, column]
        place -= more[end]
        if count == 1:
            value = table[1, planes[begin[1, column, 0] + place]]
        else:
            symbol = _code(planes, begin[1, column], place, count)
            value = _coordinate(symbol + 1, step, shrink)
        if full:
            for k in range(_FULL_COLUMNS):
                out[row, k] = sums[k] + value * basis[column, k]
        else:
            for k in range(out.shape[1]):
                out[row, k] = sums[k] + value * basis[column, k]


def read(stream: StoredStream, out: F32, inputs: Inputs) -> bool:
    """Read as `shn_transform.read` does."""
    basis = shn_transform.basis_of(inputs)
    found = shn_transform.parse(stream, basis)
    ends = shn_transform.read_ends(stream, found.width)
    groups = shn_transform.groups(found.width)
    counts = rows_above(ends, found.width)
    above = counts.tolist()
    lengths: list[int] = []
    for number, group in enumerate(groups):
        inner = sum(above[j + 1] for j in group)
        last = above[group.start] - above[group.stop]
        lengths += [inner] * found.sizes[2 * number] + [last] * found.sizes[2 * number + 1]
    wide = np.zeros((found.width, BASIS_COLUMNS), np.float32)
    wide[:, : basis.shape[1]] = basis[: found.width]
    coefficients(
        ends,
        counts,
        np.array([*(group.start for group in groups), found.width], np.int64),
        np.frombuffer(found.sizes, np.uint8),
        join_run(stream, 1, lengths),
        np.cumsum([0, *lengths], dtype=np.int64),
        wide,
        np.float32(found.step),
        np.float32(found.shrink),
        out,
    )
    return True
