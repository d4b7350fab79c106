"""Compiled search for the streams and planes of a whole chunk (SPEC 6.1 to 6.3)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.compiling import called_with

from .byte_planes import LENGTH_MASK, PACKED_FLAG, ZSTD_FLAG
from .kernels_bits import exact, signed, u16, u32
from .kernels_planes import (
    FIRST_PLANE,
    PARAM_BYTES,
    PARAMS,
    PLANES,
    PRESENT,
    RADIX,
    ROWS,
    SIZE,
    START,
    SYMBOLS,
    digits_in_byte,
    parse_frame,
)
from .payload_limits import MAX_PLANE_BYTES
from .records import COMPONENTS, ESCAPE, Attribute, Kind

I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
U64 = NDArray[np.uint64]

PAYLOAD, ATTRIBUTE, KIND, FLAGS, PARAM_LENGTH, REQUIRED = range(6)
"""Columns of `TRANSFORM_STREAMS`: payload (0 head, 1 refinement, 2 tail),
attribute, kind, flags, bytes of parameters (-1 if they vary), and 1 if the payload requires it."""

# Payload of streams that a chunk does not have.
_NEVER: Final = 3

TRANSFORM_STREAMS: Final = np.array(
    [
        (0, Attribute.SCALES, Kind.DIFFERENCES, 0, 36, 1),
        (0, Attribute.QUATS, Kind.SWING_TWIST, 0, 48, 1),
        (0, Attribute.MEANS, Kind.SORTED, 0, 60, 1),
        (0, Attribute.OPACITIES, Kind.SCALAR, 0, 12, 1),
        (0, Attribute.SH0, Kind.BASIS, 0, 72, 1),
        (1, Attribute.SCALES, Kind.DIGITS, 0, 39, 0),
        (1, Attribute.MEANS, Kind.BITS, 0, 4, 0),
        (1, Attribute.OPACITIES, Kind.DIGITS, 0, 13, 0),
        (1, Attribute.SH0, Kind.DIGITS, 0, 39, 0),
        (2, Attribute.SHN, Kind.BASIS, 0, -1, 1),
        (_NEVER, Attribute.SHAPE, Kind.VQ, 0, 8, 0),
        (_NEVER, Attribute.SCALE_FACTOR, Kind.SCALAR, 0, 12, 0),
    ],
    np.int64,
)
"""Streams of chunks that the profile `transform` writes."""

INDEXED_STREAMS: Final = TRANSFORM_STREAMS.copy()
"""Streams of chunks with a codebook of shapes, in the same rows: scales and quats are those of
escape rows."""
INDEXED_STREAMS[:2, [FLAGS, REQUIRED]] = ESCAPE, 0
INDEXED_STREAMS[5, PAYLOAD] = _NEVER
INDEXED_STREAMS[-2:, [PAYLOAD, REQUIRED]] = 0, 1

SCALES, QUATS, MEANS, OPACITIES, SH0 = range(5)
SCALE_DIGITS, MEAN_BITS, OPACITY_DIGITS, SH0_DIGITS, SHN, SHAPE, SCALE_FACTOR = range(5, 12)

NO_STREAM: Final = -1
"""Index of the last row of `ChunkPlanes.records`: zeros, the record of an absent stream."""

MAX_PLANES: Final = 192
"""Limit of planes in a chunk, above what the encoder writes at three bytes per code.

21 of grids, 3 of means, 21 of rotations, 8 of refinements, 73 of coordinates."""

COMPONENTS_OF: Final = np.array([0, *(COMPONENTS[a] for a in Attribute)], np.int64)
"""Number of components of each attribute, indexed by `Attribute`."""


@called_with(
    "Array(uint8, 1, 'C', True), int64[::1], int64, int64[:, ::1], int64[::1], int64, "
    "int64[:, ::1], int64[:, ::1], uint64[:, ::1], uint64[::1]"
)
@exact
def locate(
    data: U8,
    ends: I64,
    rows: int,
    streams: I64,
    components: I64,
    max_bytes: int,
    records: I64,
    spans: I64,
    frames: U64,
    sizes: U64,
) -> tuple[int, int, int]:
    """Find the streams and planes of a chunk (SPEC 6.1, 6.2).

    Parameters
    ----------
    data : uint8
        The payloads end to end.
    ends : (3,) int64
        End of head, refinement and tail in `data`.
    rows : int
        Splats of the chunk.
    streams : (s, 6) int64
        `TRANSFORM_STREAMS` or `INDEXED_STREAMS`.
    components : int64
        `COMPONENTS_OF`.
    max_bytes : int
        Limit of the total size of all planes after decompression and unpacking, bytes.
    records : (s + 1, 6) int64, out
        Record of each stream, as in `ChunkPlanes`.
    spans : (4, planes) int64, out
        Radix and positions of each plane, as in `ChunkPlanes`.
    frames : (planes, 2) uint64, out
        Position and length of each zstd frame in `data`.
    sizes : (planes,) uint64, out
        Decompressed size of each frame, bytes.

    Returns
    -------
    frames : int
        Number of zstd frames; -1 if a stream is not in `streams` or the chunk is invalid.
    expanded : int
        Decompressed size of all frames, bytes.
    symbols : int
        Number of symbols in all packed planes; unpacked, each takes a byte.
    """
    records[:] = 0
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
        count = u16(data, first)
        at = first + 2
        before = planes
        for _ in range(count):
            if at + 12 > end:
                return -1, 0, 0
            slot = -1
            for number in range(len(streams)):
                if streams[number, PAYLOAD] == payload and streams[number, ATTRIBUTE] == data[at]:
                    slot = number
            if slot < 0 or records[slot, PRESENT]:
                return -1, 0, 0
            if data[at + 1] != streams[slot, KIND] or data[at + 3] != streams[slot, FLAGS]:
                return -1, 0, 0
            if data[at + 2] != components[streams[slot, ATTRIBUTE]]:
                return -1, 0, 0
            own = u16(data, at + 8)
            params = u16(data, at + 10)
            stream_rows = u32(data, at + 4)
            # Readers check the rows of escape streams.
            if stream_rows > rows or (stream_rows != rows and not streams[slot, FLAGS]):
                return -1, 0, 0
            # Readers check parameters whose length varies, but for this fixed part.
            length = streams[slot, PARAM_LENGTH]
            if params != length and (length >= 0 or params < 16):
                return -1, 0, 0
            at += 12
            records[slot, PRESENT], records[slot, ROWS] = 1, stream_rows
            records[slot, PARAMS], records[slot, PARAM_BYTES] = at, params
            records[slot, FIRST_PLANE], records[slot, PLANES] = planes, own
            at += params
            if at + 4 * own > end or planes + own > spans.shape[1]:
                return -1, 0, 0
            # The row of radices holds the words until the planes are located.
            for plane in range(planes, planes + own):
                spans[RADIX, plane] = u32(data, at)
                at += 4
            planes += own
        for plane in range(before, planes):
            word = spans[RADIX, plane]
            stored = word & LENGTH_MASK
            start = at
            at += stored
            if at > end:
                return -1, 0, 0
            radix = 0
            if word & PACKED_FLAG:
                radix = signed(data[start]) if stored else 0
                if radix < 2 or radix > 16:
                    return -1, 0, 0
                start += 1
                stored -= 1
            size = stored
            if word & ZSTD_FLAG:
                frame_end, size = parse_frame(data, start, stored)
                if size <= 0 or size > MAX_PLANE_BYTES or frame_end != at:
                    return -1, 0, 0
                frames[frame_count, 0] = start
                frames[frame_count, 1] = stored
                sizes[frame_count] = size
                frame_count += 1
                start = ends[-1] + expanded
                expanded += size
            spans[RADIX, plane], spans[START, plane], spans[SIZE, plane] = radix, start, size
            spans[SYMBOLS, plane] = symbols
            if radix:
                symbols += size * digits_in_byte(radix)[0]
            if expanded + symbols > max_bytes:
                return -1, 0, 0
        if at != end:
            return -1, 0, 0
        first = end
    for slot in range(len(streams)):
        has_payload = streams[slot, PAYLOAD] != 2 or ends[2] > ends[1]
        if streams[slot, REQUIRED] and has_payload and not records[slot, PRESENT]:
            return -1, 0, 0
    for plane in range(planes):
        spans[SYMBOLS, plane] += ends[-1] + expanded
    return frame_count, expanded, symbols
