"""Compiled reading of a whole chunk: all streams of its head, refinement and tail in two calls.

A decode of stream after stream spends half of its time between the kernels. The streams that the
encoder usually writes (SPEC 6.5, 6.10 to 6.17) are therefore read together here. Whatever is
unusual or wrong is left to the readers of single streams, which are asked whenever this one gives
up, so that refusals come from one place.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.compiling import called_with

from . import swing_twist, zstd_frames
from .adaptive_step import KNEES, MAX_COEFFICIENT, MAX_EXTRA_BITS
from .byte_planes import LENGTH_MASK, PACKED_FLAG, ZSTD_FLAG, digit_tables
from .grid import MAX_LEVELS, MAX_VALUE
from .kernels_bits import exact
from .kernels_grid import accumulate, digit_rows, grid_rows, on_axes
from .kernels_planes import digits_in_byte, frame, spread
from .kernels_shn_transform import BASIS_COLUMNS, coefficients, rows_above
from .kernels_sorted_means import AXES_OF_BITS, means
from .kernels_sorted_means import plan as plan_means
from .kernels_swing_twist import GROUPS, rotations
from .kernels_swing_twist import plan as plan_rotations
from .limits import MAX_PLANE_BYTES
from .records import COMPONENTS, Attribute, Kind
from .refinement_bits import MAX_BITS
from .refinement_digits import MAX_RADIX
from .shn_transform import GROUP_STARTS, MAX_BASIS_ROWS, MAX_FACTOR
from .sorted_means import MAX_CELLS, POWERS
from .whole_chunk import ChunkArrays

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
U64 = NDArray[np.uint64]

# What each stream of a usual chunk is: payload (head, refinement, tail), attribute, kind,
# components, and bytes of parameters (-1 where they depend on the parameters themselves).
_STREAMS: Final = np.array(
    [
        (0, Attribute.SCALES, Kind.DIFFERENCES, 3, 36),
        (0, Attribute.QUATS, Kind.SWING_TWIST, 4, 48),
        (0, Attribute.MEANS, Kind.SORTED, 3, 60),
        (0, Attribute.OPACITIES, Kind.SCALAR, 1, 12),
        (0, Attribute.SH0, Kind.BASIS, 3, 72),
        (1, Attribute.SCALES, Kind.DIGITS, 3, 39),
        (1, Attribute.MEANS, Kind.BITS, 3, 4),
        (1, Attribute.OPACITIES, Kind.DIGITS, 1, 13),
        (1, Attribute.SH0, Kind.DIGITS, 3, 39),
        (2, Attribute.SHN, Kind.BASIS, COMPONENTS[Attribute.SHN], -1),
    ],
    np.int64,
)
_SCALES, _QUATS, _MEANS, _OPACITIES, _SH0 = range(5)
_SCALE_DIGITS, _MEAN_BITS, _OPACITY_DIGITS, _SH0_DIGITS, _SHN = range(5, 10)

# More planes than the streams above can have: 3 bytes for each of 7 codes, 3 of means, 21 of
# rotations, 8 of refinements, and 1 + 2 · 3 for each of 12 groups of coordinates.
_MOST_PLANES: Final = 128

# Bytes of planes for each row, decompressed and taken apart, that are read together: usual chunks
# have 60. What a file states beyond that is read stream by stream, which takes less memory.
_ROW_BYTES: Final = 96
_LEAST_BYTES: Final = 1 << 14


@exact
def _int(value: np.unsignedinteger[Any]) -> int:
    """Return a number as a signed one: of signed and unsigned ones, numba makes floating point."""
    return int(np.int64(value))


@exact
def _u16(octets: U8, at: int) -> int:
    return _int(octets[at]) | _int(octets[at + 1]) << 8


@exact
def _u32(octets: U8, at: int) -> int:
    return _u16(octets, at) | _u16(octets, at + 2) << 16


@called_with(
    "Array(uint8, 1, 'C', True), int64[::1], int64, int64[:, ::1], int64, int64[:, ::1], "
    "int64[:, ::1], uint64[:, ::1], uint64[::1]"
)
@exact
def _locate(
    octets: U8,
    ends: I64,
    rows: int,
    streams: I64,
    most: int,
    found: I64,
    spans: I64,
    frames: U64,
    sizes: U64,
) -> tuple[int, int, int]:
    """Find the streams and planes of a chunk (SPEC 6.1, 6.2).

    Parameters
    ----------
    octets : uint8
        The payloads end to end.
    ends : (3,) int64
        Where head, refinement and tail end.
    rows : int
        Of the chunk.
    streams : (10, 5) int64
        As `_STREAMS`.
    most : int
        Bytes that all planes may take together once they are decompressed and taken apart.
    found : (10, 4) int64, out
        Of each stream whether it is there, where its parameters are, its first plane and its number
        of planes.
    spans : (4, planes) int64, out
        Of each plane the radix (0 where nothing is packed), where its bytes start in what the
        payloads and then the frames hold, how many there are, and behind both where its symbols go
        if it is packed.
    frames : (planes, 2) uint64, out
        Start and length of each zstd frame.
    sizes : (planes,) uint64, out
        Bytes that each holds.

    Returns
    -------
    frames, expanded, symbols : int
        How many frames there are, -1 where anything is unusual; what they hold, bytes; bytes of
        the planes that are packed once they are taken apart.
    """
    found[:] = 0
    planes = 0
    frame_count = 0
    expanded = 0
    symbols = 0
    first = 0
    for payload in range(len(ends)):
        end = ends[payload]
        if end == first:
            continue
        if end - first < 2:
            return -1, 0, 0
        count = _u16(octets, first)
        at = first + 2
        before = planes
        for _ in range(count):
            if at + 12 > end:
                return -1, 0, 0
            slot = -1
            for number in range(len(streams)):
                if streams[number, 0] == payload and streams[number, 1] == octets[at]:
                    slot = number
            # No flags, and every stream once.
            if slot < 0 or found[slot, 0] or octets[at + 1] != streams[slot, 2]:
                return -1, 0, 0
            if octets[at + 2] != streams[slot, 3] or octets[at + 3]:
                return -1, 0, 0
            own = _u16(octets, at + 8)
            params = _u16(octets, at + 10)
            if _u32(octets, at + 4) != rows:
                return -1, 0, 0
            if streams[slot, 4] >= 0 and params != streams[slot, 4]:
                return -1, 0, 0
            at += 12
            found[slot, 0], found[slot, 1] = 1, at
            found[slot, 2], found[slot, 3] = planes, own
            at += params
            if at + 4 * own > end or planes + own > spans.shape[1]:
                return -1, 0, 0
            if streams[slot, 4] < 0 and params < 16:
                return -1, 0, 0
            for plane in range(planes, planes + own):
                spans[0, plane] = _u32(octets, at)
                at += 4
            # The parameters' length is checked where they are read.
            if streams[slot, 4] < 0:
                found[slot, 0] = params
            planes += own
        for plane in range(before, planes):
            word = spans[0, plane]
            stored = word & LENGTH_MASK
            start = at
            at += stored
            if at > end:
                return -1, 0, 0
            radix = 0
            if word & PACKED_FLAG:
                radix = _int(octets[start]) if stored else 0
                if radix < 2 or radix > 16:
                    return -1, 0, 0
                start += 1
                stored -= 1
            size = stored
            if word & ZSTD_FLAG:
                behind, size = frame(octets, start, stored)
                if size <= 0 or size > MAX_PLANE_BYTES or behind != at:
                    return -1, 0, 0
                frames[frame_count, 0] = start
                frames[frame_count, 1] = stored
                sizes[frame_count] = size
                frame_count += 1
                start = ends[-1] + expanded
                expanded += size
            spans[0, plane], spans[1, plane], spans[2, plane] = radix, start, size
            spans[3, plane] = symbols
            if radix:
                symbols += size * digits_in_byte(radix)[0]
            if expanded + symbols > most:
                return -1, 0, 0
        if at != end:
            return -1, 0, 0
        first = end
    for slot in range(len(streams)):
        # All of the head's, and in a tail the one that it may have.
        if not found[slot, 0] and (
            streams[slot, 0] == 0 or (streams[slot, 0] == 2 and ends[2] > ends[1])
        ):
            return -1, 0, 0
    for plane in range(planes):
        spans[3, plane] += ends[-1] + expanded
    return frame_count, expanded, symbols


@exact
def _start(octets: U8, work: U8, spans: I64, plane: int, length: int, tables: U8) -> int:
    """Return where the symbols of a plane start, taken apart if need be; -1 where it is wrong."""
    radix, start, size = spans[0, plane], spans[1, plane], spans[2, plane]
    out = int(spans[3, plane])
    if length > MAX_PLANE_BYTES:
        return -1
    if not radix:
        return int(start) if size == length else -1
    count, limit = digits_in_byte(radix)
    if size != -(-length // count):
        return -1
    top = 0
    for i in range(start, start + size):
        top = max(top, _int(octets[i]))
    if top >= limit or spread(octets, start, tables[radix], count, work, out, length):
        return -1
    return out


@exact
def _starts(
    octets: U8,
    work: U8,
    spans: I64,
    first: int,
    count: int,
    length: int,
    tables: U8,
    starts: I64,
    at: int,
) -> bool:
    """Write where consecutive planes of one length start; return whether all are right."""
    for plane in range(count):
        start = _start(octets, work, spans, first + plane, length, tables)
        if start < 0:
            return False
        starts[at + plane] = start
    return True


@exact
def _grid(
    octets: U8, at: int, components: int, limit: int
) -> tuple[bool, tuple[F32, F32, NDArray[np.uint32]]]:
    """Return the grid that stands in parameters, and whether it is one (SPEC 6.4)."""
    bits = np.empty((3, components), np.uint32)
    for component in range(components):
        for field in range(3):
            bits[field, component] = _u32(octets, at + 12 * component + 4 * field)
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


@exact
def _planes_of(levels: NDArray[np.uint32]) -> int:
    """Return how many planes the codes of a grid take (SPEC 6.4)."""
    planes = 0
    for limit in levels:
        count = 0
        while _int(limit) - 1 >> 8 * count:
            count += 1
        planes += count
    return planes


@exact
def _floats(octets: U8, at: int, count: int, most: float, out: F32) -> bool:
    """Read float32 values; return whether none is beyond ±`most`."""
    bits = np.empty(count, np.uint32)
    for i in range(count):
        bits[i] = _u32(octets, at + 4 * i)
    values = bits.view(np.float32)
    for i in range(count):
        if not abs(np.float64(values[i])) <= most:
            return False
        out[i] = values[i]
    return True


@exact
def _words(octets: U8, start: int, length: int) -> U64:
    """Return the bytes of a plane as 64-bit words, with two of zeros behind them."""
    found = np.zeros((length + 7 >> 3) + 2, np.uint64)
    own = found.view(np.uint8)
    for i in range(length):
        own[i] = octets[start + i]
    return found


@exact
def _is_padded(octets: U8, start: int, bits: int) -> bool:
    """Tell whether what follows the bits of a plane in its last byte is zeros."""
    return not (bits & 7 and _int(octets[start + (bits >> 3)]) >> (bits & 7))


@exact
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
    if not _starts(octets, work, spans, found[slot, 2], count, rows, tables, starts, 0):
        return False
    if not found[digits, 0]:
        return grid_rows(octets, starts, coarse, 0, out)
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
    if not _starts(octets, work, spans, found[digits, 2], finer, rows, tables, starts, count):
        return False
    return digit_rows(octets, starts, coarse, radices, fine, coarse_out, out)


@exact
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
    at = found[_QUATS, 1]
    right = _floats(octets, at, 6, MAX_COEFFICIENT, models[0])
    right = right and _floats(octets, at + 24, 6, MAX_COEFFICIENT, models[1])
    if not right or found[_QUATS, 3] != 3 * GROUPS:
        return False
    extra = np.empty((2, rows), np.uint8)
    counts = np.empty((2, GROUPS + 1), np.int64)
    plan_rotations(scales, models, knees, MAX_EXTRA_BITS, extra, counts)
    starts = np.zeros(3 * GROUPS, np.int64)
    for column in range(3):
        for group in range(1, GROUPS + 1):
            length = counts[column >> 1, group]
            if group == GROUPS:
                length = length + 7 >> 3
            place = column * GROUPS + group - 1
            start = _start(octets, work, spans, found[_QUATS, 2] + place, length, tables)
            if start < 0:
                return False
            starts[place] = start
    return rotations(octets, starts, extra, counts, steps, out)


@exact
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
    right, grid = _grid(octets, found[_MEANS, 1], 3, MAX_CELLS)
    model = np.empty(6, np.float32)
    right = right and _floats(octets, found[_MEANS, 1] + 36, 6, MAX_COEFFICIENT, model)
    first = found[_MEANS, 2]
    if not right or found[_MEANS, 3] != 3:
        return False
    start = _start(octets, work, spans, first, rows, tables)
    if start < 0:
        return False
    classes = octets[start : start + rows]
    extra = np.empty(rows, np.uint8)
    bits, low_bits = plan_means(classes, scales, model, knees, MAX_EXTRA_BITS, extra)
    if bits < 0:
        return False
    differences = _start(octets, work, spans, first + 1, bits + 7 >> 3, tables)
    fields = _start(octets, work, spans, first + 2, low_bits + 7 >> 3, tables)
    if differences < 0 or fields < 0:
        return False
    if not _is_padded(octets, differences, bits) or not _is_padded(octets, fields, low_bits):
        return False
    more, more_bits, lower = 0, 0, 0
    if found[_MEAN_BITS, 0]:
        at = found[_MEAN_BITS, 1]
        more = _int(octets[at])
        reserved = octets[at + 1] | octets[at + 2] | octets[at + 3]
        if more < 1 or more > MAX_BITS or reserved or found[_MEAN_BITS, 3] != 1:
            return False
        more_bits = 3 * more * rows
        lower = _start(octets, work, spans, found[_MEAN_BITS, 2], more_bits + 7 >> 3, tables)
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


@exact
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
    at = found[_SHN, 1]
    factors = np.empty(2, np.float32)
    if not _floats(octets, at + 4, 2, MAX_FACTOR, factors):
        return False
    step, shrink = factors[0], factors[1]
    width, reserved = _u16(octets, at + 12), _u16(octets, at + 14)
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
    if found[_SHN, 0] != 16 + 2 * count:
        return False
    sizes = octets[at + 16 : at + 16 + 2 * count]
    planes = 1
    for size in sizes:
        if size > 3:
            return False
        planes += _int(size)
    if found[_SHN, 3] != planes:
        return False
    wide = np.zeros((width, BASIS_COLUMNS), np.float32)
    for row in range(width):
        for column in range(columns):
            if not abs(np.float64(basis[row, column])) <= MAX_FACTOR:
                return False
            wide[row, column] = basis[row, column]
    first = found[_SHN, 2]
    start = _start(octets, work, spans, first, rows, tables)
    if start < 0:
        return False
    ends = octets[start : start + rows]
    top = 0
    for row in range(rows):
        top = max(top, _int(ends[row]))
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
            own = _int(sizes[2 * group + part])
            length = above[a] - above[b] if part else inner
            if not _starts(
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
        As `_locate` writes them.
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
    refined = found[_SCALE_DIGITS, 0] != 0
    alone = np.empty((rows if refined else 0, 3), np.float32)
    if not _values(octets, work, spans, found, _SCALES, _SCALE_DIGITS, tables, alone, differences):
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
        octets, work, spans, found, _OPACITIES, _OPACITY_DIGITS, tables, none, opacities
    ):
        return False
    axes = np.empty(9, np.float32)
    if not _floats(octets, found[_SH0, 1] + 36, 9, 1.0, axes):
        return False
    if not _values(octets, work, spans, found, _SH0, _SH0_DIGITS, tables, none, differences):
        return False
    on_axes(differences, axes.reshape(3, 3), sh0)
    if found[_SHN, 0] and len(shN):
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
    found = np.empty((len(_STREAMS), 4), np.int64)
    spans = np.empty((4, _MOST_PLANES), np.int64)
    frames = np.empty((_MOST_PLANES, 2), np.uint64)
    sizes = np.empty(_MOST_PLANES, np.uint64)
    ends = np.array((len(head), finer, len(payload)), np.int64)
    octets = np.frombuffer(payload, np.uint8)
    most = _LEAST_BYTES + _ROW_BYTES * rows
    count, expanded, symbols = _locate(
        octets, ends, rows, _STREAMS, most, found, spans, frames, sizes
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
