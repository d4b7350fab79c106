"""Compiled reading of a whole chunk: all streams of its head, refinement and tail in two calls.

A decode of stream after stream spends half of its time between the kernels. The streams that the
encoder usually writes (SPEC 6.5, 6.10 to 6.17) are therefore read together here. Whatever is
unusual or wrong is left to the readers of single streams, which are asked whenever this one gives
up, so that refusals come from one place.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.compiling import called_with

from . import swing_twist, zstd_frames
from .adaptive_step import KNEES, MAX_COEFFICIENT
from .byte_planes import digit_tables
from .grid import MAX_LEVELS, MAX_VALUE
from .kernels_bits import exact, inner_exact
from .kernels_chunk_layout import (
    MEAN_BITS_SLOT,
    MEANS_SLOT,
    MOST_PLANES,
    OPACITIES_SLOT,
    OPACITY_DIGITS_SLOT,
    QUATS_SLOT,
    SCALE_DIGITS_SLOT,
    SCALES_SLOT,
    SH0_DIGITS_SLOT,
    SH0_SLOT,
    SHN_SLOT,
    STREAMS,
    locate,
    signed,
    start_of,
    starts_of,
    u16,
    u32,
)
from .kernels_grid import accumulate, digit_rows, grid_rows, on_axes
from .kernels_shn_transform import BASIS_COLUMNS, coefficients, rows_above
from .kernels_sorted_means import AXES_OF_BITS, means
from .kernels_sorted_means import plan as plan_means
from .kernels_swing_twist import GROUPS, rotations
from .kernels_swing_twist import plan as plan_rotations
from .refinement_bits import MAX_BITS
from .refinement_digits import MAX_RADIX
from .shn_transform import GROUP_STARTS, MAX_BASIS_ROWS, MAX_FACTOR
from .sorted_means import MAX_CELLS, POWERS
from .whole_chunk import ChunkArrays

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
U64 = NDArray[np.uint64]

# Bytes of planes for each row, decompressed and taken apart, that are read together: usual chunks
# have 60. What a file states beyond that is read stream by stream, which takes less memory.
_ROW_BYTES: Final = 96
_LEAST_BYTES: Final = 1 << 14


@inner_exact
def _grid(
    octets: U8, at: int, components: int, limit: int
) -> tuple[bool, tuple[F32, F32, NDArray[np.uint32]]]:
    """Return the grid that stands in parameters, and whether it is one (SPEC 6.4)."""
    bits = np.empty((3, components), np.uint32)
    for component in range(components):
        for field in range(3):
            bits[field, component] = u32(octets, at + 12 * component + 4 * field)
    low, high = bits[0].view(np.float32), bits[1].view(np.float32)
    levels = bits[2].copy()
    right = True
    for component in range(components):
        a, b = np.float64(low[component]), np.float64(high[component])
        if not (a >= -MAX_VALUE and a <= b and b <= MAX_VALUE):
            right = False
        if levels[component] < 1 or levels[component] > limit:
            right = False
    return right, (low.copy(), high.copy(), levels)


@inner_exact
def _planes_of(levels: NDArray[np.uint32]) -> int:
    """Return how many planes the codes of a grid take (SPEC 6.4)."""
    planes = 0
    for limit in levels:
        count = 0
        while signed(limit) - 1 >> 8 * count:
            count += 1
        planes += count
    return planes


@inner_exact
def _floats(octets: U8, at: int, count: int, most: float, out: F32) -> bool:
    """Read float32 values; return whether none is beyond ±`most`."""
    bits = np.empty(count, np.uint32)
    for i in range(count):
        bits[i] = u32(octets, at + 4 * i)
    values = bits.view(np.float32)
    for i in range(count):
        if not abs(np.float64(values[i])) <= most:
            return False
        out[i] = values[i]
    return True


@inner_exact
def _words(octets: U8, start: int, length: int) -> U64:
    """Return the bytes of a plane as 64-bit words, with two of zeros behind them."""
    found = np.zeros((length + 7 >> 3) + 2, np.uint64)
    own = found.view(np.uint8)
    for i in range(length):
        own[i] = octets[start + i]
    return found


@inner_exact
def _is_padded(octets: U8, start: int, bits: int) -> bool:
    """Tell whether what follows the bits of a plane in its last byte is zeros."""
    return not (bits & 7 and signed(octets[start + (bits >> 3)]) >> (bits & 7))


@inner_exact
def _values(
    octets: U8,
    work: U8,
    spans: I64,
    found: I64,
    slot: int,
    digits: int,
    tables: U8,
    coarse_out: F32,
    out: F32,
) -> bool:
    """Write the values of a stream on a grid, refined where there are digits (SPEC 6.4, 6.16)."""
    rows, components = out.shape
    right, coarse = _grid(octets, found[slot, 1], components, MAX_LEVELS)
    count = found[slot, 3]
    if not right or count != _planes_of(coarse[2]):
        return False
    starts = np.zeros(count + components, np.int64)
    if not starts_of(octets, work, spans, found[slot, 2], count, rows, tables, starts, 0):
        return False
    if not found[digits, 0]:
        return grid_rows(octets, starts, coarse, int(np.int64(0)), out)
    right, fine = _grid(octets, found[digits, 1], components, MAX_LEVELS)
    radices = np.empty(components, np.int64)
    finer = 0
    for component in range(components):
        radices[component] = octets[found[digits, 1] + 12 * components + component]
        if radices[component] < 1 or radices[component] > MAX_RADIX:
            right = False
        finer += radices[component] > 1
    if not right or found[digits, 3] != finer:
        return False
    if not starts_of(octets, work, spans, found[digits, 2], finer, rows, tables, starts, count):
        return False
    return digit_rows(octets, starts, coarse, radices, fine, coarse_out, out)


@inner_exact
def _read_rotations(
    octets: U8,
    work: U8,
    spans: I64,
    found: I64,
    tables: U8,
    knees: F32,
    steps: F32,
    scales: F32,
    out: F32,
) -> bool:
    """Write unit quaternions (SPEC 6.11)."""
    rows = len(out)
    models = np.empty((2, 6), np.float32)
    at = found[QUATS_SLOT, 1]
    right = _floats(octets, at, 6, MAX_COEFFICIENT, models[0])
    right = right and _floats(octets, at + 24, 6, MAX_COEFFICIENT, models[1])
    if not right or found[QUATS_SLOT, 3] != 3 * GROUPS:
        return False
    extra = np.empty((2, rows), np.uint8)
    counts = np.empty((2, GROUPS + 1), np.int64)
    plan_rotations(scales, models, knees, extra, counts)
    starts = np.zeros(3 * GROUPS, np.int64)
    for column in range(3):
        for group in range(1, GROUPS + 1):
            length = counts[column >> 1, group]
            if group == GROUPS:
                length = length + 7 >> 3
            place = column * GROUPS + group - 1
            start = start_of(octets, work, spans, found[QUATS_SLOT, 2] + place, length, tables)
            if start < 0:
                return False
            starts[place] = start
    return rotations(octets, starts, extra, counts, steps, out)


@inner_exact
def _read_means(
    octets: U8,
    work: U8,
    spans: I64,
    found: I64,
    tables: U8,
    knees: F32,
    powers: F32,
    axes_of_bits: U64,
    scales: F32,
    out: F32,
) -> bool:
    """Write means (SPEC 6.5, 6.17)."""
    rows = len(out)
    right, grid = _grid(octets, found[MEANS_SLOT, 1], 3, MAX_CELLS)
    model = np.empty(6, np.float32)
    right = right and _floats(octets, found[MEANS_SLOT, 1] + 36, 6, MAX_COEFFICIENT, model)
    first = found[MEANS_SLOT, 2]
    if not right or found[MEANS_SLOT, 3] != 3:
        return False
    start = start_of(octets, work, spans, first, rows, tables)
    if start < 0:
        return False
    classes = octets[start : start + rows]
    extra = np.empty(rows, np.uint8)
    bits, low_bits = plan_means(classes, scales, model, knees, extra)
    if bits < 0:
        return False
    differences = start_of(octets, work, spans, first + 1, bits + 7 >> 3, tables)
    fields = start_of(octets, work, spans, first + 2, low_bits + 7 >> 3, tables)
    if differences < 0 or fields < 0:
        return False
    if not _is_padded(octets, differences, bits) or not _is_padded(octets, fields, low_bits):
        return False
    more, more_bits, lower = 0, 0, 0
    if found[MEAN_BITS_SLOT, 0]:
        at = found[MEAN_BITS_SLOT, 1]
        more = signed(octets[at])
        reserved = octets[at + 1] | octets[at + 2] | octets[at + 3]
        if more < 1 or more > MAX_BITS or reserved or found[MEAN_BITS_SLOT, 3] != 1:
            return False
        more_bits = 3 * more * rows
        lower = start_of(octets, work, spans, found[MEAN_BITS_SLOT, 2], more_bits + 7 >> 3, tables)
        if lower < 0 or not _is_padded(octets, lower, more_bits):
            return False
    minimum, maximum, counts = grid
    levels = np.empty(3, np.int64)
    steps = np.empty((len(powers), 3), np.float32)
    for axis in range(3):
        levels[axis] = counts[axis]
        width = np.float32(0)
        if counts[axis] > 1:
            width = (maximum[axis] - minimum[axis]) / (np.float32(counts[axis]) - np.float32(1))
        for m in range(len(powers)):
            steps[m, axis] = powers[m] * width
    return means(
        classes,
        _words(octets, differences, bits + 7 >> 3),
        extra,
        _words(octets, fields, low_bits + 7 >> 3),
        axes_of_bits,
        levels,
        steps,
        minimum,
        more,
        _words(octets, lower, more_bits + 7 >> 3),
        out,
    )


@inner_exact
def _read_coefficients(
    octets: U8,
    work: U8,
    spans: I64,
    found: I64,
    tables: U8,
    group_starts: I64,
    basis: F32,
    out: F32,
) -> bool:
    """Write shN from coordinates on a basis (SPEC 6.14)."""
    rows, columns = out.shape
    at = found[SHN_SLOT, 1]
    factors = np.empty(2, np.float32)
    if not _floats(octets, at + 4, 2, MAX_FACTOR, factors):
        return False
    step, shrink = factors[0], factors[1]
    width, reserved = u16(octets, at + 12), u16(octets, at + 14)
    if width > min(len(basis), MAX_BASIS_ROWS) or reserved:
        return False
    if not step > 0 or not shrink >= 0 or not shrink <= np.float32(0.5):
        return False
    groups = np.empty(len(group_starts) + 1, np.int64)
    count = 0
    for start in group_starts:
        if start < width:
            groups[count] = start
            count += 1
    groups[count] = width
    groups = groups[: count + 1]
    # Here the first column of `found` is the length of the parameters.
    if found[SHN_SLOT, 0] != 16 + 2 * count:
        return False
    sizes = octets[at + 16 : at + 16 + 2 * count]
    planes = 1
    for size in sizes:
        if size > 3:
            return False
        planes += signed(size)
    if found[SHN_SLOT, 3] != planes:
        return False
    wide = np.zeros((width, BASIS_COLUMNS), np.float32)
    for row in range(width):
        for column in range(columns):
            if not abs(np.float64(basis[row, column])) <= MAX_FACTOR:
                return False
            wide[row, column] = basis[row, column]
    first = found[SHN_SLOT, 2]
    start = start_of(octets, work, spans, first, rows, tables)
    if start < 0:
        return False
    ends = octets[start : start + rows]
    top = 0
    for row in range(rows):
        top = max(top, signed(ends[row]))
    if top > width:
        return False
    above = rows_above(ends, width)
    starts = np.zeros(planes, np.int64)
    plane = 0
    for group in range(count):
        a, b = groups[group], groups[group + 1]
        inner = 0
        for column in range(a, b):
            inner += above[column + 1]
        for part in range(2):
            own = signed(sizes[2 * group + part])
            length = above[a] - above[b] if part else inner
            if not starts_of(
                octets, work, spans, first + 1 + plane, own, length, tables, starts, plane
            ):
                return False
            plane += own
    coefficients(ends, above, groups, sizes, octets, starts, wide, step, shrink, out)
    return True


@called_with(
    "Array(uint8, 1, 'C', True), uint8[::1], int64[:, ::1], int64[:, ::1], "
    "Tuple((uint8[:, :, ::1], float32[::1], float32[::1], float32[::1], uint64[::1], int64[::1])), "
    "float32[:, ::1], Tuple((float32[:, ::1], float32[:, ::1], float32[:, ::1], float32[:, ::1], "
    "float32[:, ::1], float32[:, ::1]))"
)
@exact
def _read(
    octets: U8,
    work: U8,
    spans: I64,
    found: I64,
    constants: tuple[U8, F32, F32, F32, U64, I64],
    basis: F32,
    out: tuple[F32, F32, F32, F32, F32, F32],
) -> bool:
    """Write all values of a chunk.

    Parameters
    ----------
    octets, work : uint8
        Twice the same bytes: what the payloads hold, what their frames hold, and room for symbols;
        the second may be written to.
    spans, found : int64
        As `locate` writes them.
    constants : tuple
        Digits of each byte by radix, knees of step models, steps of rotations, powers of means,
        axes of Morton codes, first coordinates of groups.
    basis : (C, d) float32
        Of the tail.
    out : tuple
        Means, scales, quats, opacities, sh0 and shN, two-dimensional; shN without rows where there
        is no tail.

    Returns
    -------
    bool
        False where anything is wrong or unusual.
    """
    tables, knees, rotation_steps, powers, axes_of_bits, group_starts = constants
    own_means, scales, quats, opacities, sh0, shN = out
    rows = len(scales)
    differences = np.empty((rows, 3), np.float32)
    refined = found[SCALE_DIGITS_SLOT, 0] != 0
    alone = np.empty((rows if refined else 0, 3), np.float32)
    if not _values(
        octets, work, spans, found, SCALES_SLOT, SCALE_DIGITS_SLOT, tables, alone, differences
    ):
        return False
    accumulate(differences, scales)
    # Steps follow from the scales of the head alone.
    coarse = scales
    if refined:
        coarse = np.empty((rows, 3), np.float32)
        accumulate(alone, coarse)
    if not _read_rotations(
        octets, work, spans, found, tables, knees, rotation_steps, coarse, quats
    ):
        return False
    if not _read_means(
        octets, work, spans, found, tables, knees, powers, axes_of_bits, coarse, own_means
    ):
        return False
    none = alone[:0]
    if not _values(
        octets, work, spans, found, OPACITIES_SLOT, OPACITY_DIGITS_SLOT, tables, none, opacities
    ):
        return False
    axes = np.empty(9, np.float32)
    if not _floats(octets, found[SH0_SLOT, 1] + 36, 9, 1.0, axes):
        return False
    if not _values(
        octets, work, spans, found, SH0_SLOT, SH0_DIGITS_SLOT, tables, none, differences
    ):
        return False
    on_axes(differences, axes.reshape(3, 3), sh0)
    if found[SHN_SLOT, 0] and len(shN):
        return _read_coefficients(octets, work, spans, found, tables, group_starts, basis, shN)
    return True


_CONSTANTS: Final = (
    digit_tables(),
    KNEES,
    swing_twist.STEPS,
    POWERS,
    AXES_OF_BITS,
    np.array(GROUP_STARTS, np.int64),
)

# Where the number of its codebook stands in a tail of one stream: behind the count of streams and
# the fixed part of the record.
_CODEBOOK_AT: Final = 14
_CODEBOOK: Final = struct.Struct("<I")

_NO_BASIS: Final = np.zeros((0, 0), np.float32)


def read(
    head: memoryview,
    refinement: memoryview | None,
    tail: memoryview | None,
    basis_of: Callable[[int], F32 | None],
    out: ChunkArrays,
) -> bool:
    """Read as `whole_chunk.read` does; False where something is wrong or unusual."""
    payload = b"".join((head, refinement or b"", tail or b""))
    finer = len(head) + len(refinement or b"")
    rows = len(out.scales)
    basis = _NO_BASIS
    if tail is not None:
        if len(tail) < _CODEBOOK_AT + _CODEBOOK.size:
            return False
        book = basis_of(int(_CODEBOOK.unpack_from(tail, _CODEBOOK_AT)[0]))
        if book is None or book.shape[1] > BASIS_COLUMNS:
            return False
        basis = book
    found = np.empty((len(STREAMS), 4), np.int64)
    spans = np.empty((4, MOST_PLANES), np.int64)
    frames = np.empty((MOST_PLANES, 2), np.uint64)
    sizes = np.empty(MOST_PLANES, np.uint64)
    ends = np.array((len(head), finer, len(payload)), np.int64)
    octets = np.frombuffer(payload, np.uint8)
    most = _LEAST_BYTES + _ROW_BYTES * rows
    count, expanded, symbols = locate(
        octets, ends, rows, STREAMS, most, found, spans, frames, sizes
    )
    if count < 0:
        return False
    # Two bytes behind the last plane are read with it.
    work = np.empty(len(payload) + expanded + symbols + 2, np.uint8)
    work[: len(payload)] = octets
    if count:
        located = frames[:count], sizes[:count]
        raw = zstd_frames.decompress_located(memoryview(payload), *located)
        if raw is None or len(raw) != expanded:
            return False
        work[len(payload) : len(payload) + expanded] = np.frombuffer(raw, np.uint8)
    # As planes are that readers of single streams read: kernels are compiled for one kind of array.
    same = work.view()
    same.flags.writeable = False
    arrays = (
        out.means,
        out.scales,
        out.quats,
        out.opacities[:, None],
        out.sh0,
        out.shN if tail is not None else out.shN[:0],
    )
    return _read(same, work, spans, found, _CONSTANTS, basis, arrays)
