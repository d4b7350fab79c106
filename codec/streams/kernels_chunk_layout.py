"""Where the streams and planes of a whole chunk stand, found by compiled code (SPEC 6.1 to 6.3)."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.compiling import called_with

from .byte_planes import LENGTH_MASK, PACKED_FLAG, ZSTD_FLAG
from .kernels_bits import exact, inner_exact
from .kernels_planes import digits_in_byte, frame, spread
from .limits import MAX_PLANE_BYTES
from .records import COMPONENTS, Attribute, Kind

I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
U64 = NDArray[np.uint64]

STREAMS: Final = np.array(
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
"""What each stream of a usual chunk is: payload (head, refinement, tail), attribute, kind,
components, and bytes of parameters (-1 where they depend on the parameters themselves)."""

SCALES_SLOT, QUATS_SLOT, MEANS_SLOT, OPACITIES_SLOT, SH0_SLOT = range(5)
SCALE_DIGITS_SLOT, MEAN_BITS_SLOT, OPACITY_DIGITS_SLOT, SH0_DIGITS_SLOT, SHN_SLOT = range(5, 10)

MOST_PLANES: Final = 128
"""More than these streams can have: 3 for each of 7 codes, 3 of means, 21 of rotations, 8 of
refinements, 1 + 2 · 3 · 12 of coordinates."""


@inner_exact
def signed(value: np.unsignedinteger[Any]) -> int:
    """Return a number as a signed one: of signed and unsigned ones, numba makes floating point."""
    return int(np.int64(value))


@inner_exact
def u16(octets: U8, at: int) -> int:
    """Return the number in two bytes, the lower one first."""
    return signed(octets[at]) | signed(octets[at + 1]) << 8


@inner_exact
def u32(octets: U8, at: int) -> int:
    """Return the number in four bytes, the lowest one first."""
    return u16(octets, at) | u16(octets, at + 2) << 16


@called_with(
    "Array(uint8, 1, 'C', True), int64[::1], int64, int64[:, ::1], int64, int64[:, ::1], "
    "int64[:, ::1], uint64[:, ::1], uint64[::1]"
)
@exact
def locate(
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
        As `STREAMS`.
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
        count = u16(octets, first)
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
            own = u16(octets, at + 8)
            params = u16(octets, at + 10)
            if u32(octets, at + 4) != rows:
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
                spans[0, plane] = u32(octets, at)
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
                radix = signed(octets[start]) if stored else 0
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


@inner_exact
def start_of(octets: U8, work: U8, spans: I64, plane: int, length: int, tables: U8) -> int:
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
        top = max(top, signed(octets[i]))
    if top >= limit or spread(octets, start, tables[radix], count, work, out, length):
        return -1
    return out


@inner_exact
def starts_of(
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
        start = start_of(octets, work, spans, first + plane, length, tables)
        if start < 0:
            return False
        starts[at + plane] = start
    return True
