"""Compiled decoding of byte planes: packed digits and zstd frame headers (SPEC 6.3, 6.9)."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .kernels_bits import inner_exact, signed
from .payload_limits import MAX_PLANE_BYTES

I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]

# RFC 8878, 3.1.1: the magic number, and the descriptor's bit for a frame of a single segment.
_MAGIC: Final = 0xFD2FB528
_SINGLE_SEGMENT: Final = 0x20

PRESENT, ROWS, PARAMS, PARAM_BYTES, FIRST_PLANE, PLANES = range(6)
"""Columns of `ChunkPlanes.records`."""

RADIX, START, SIZE, SYMBOLS = range(4)
"""Rows of `ChunkPlanes.spans`."""


class ChunkPlanes(NamedTuple):
    """Streams and planes of one chunk, shared by the compiled readers.

    Parameters
    ----------
    data : (b,) uint8
        Payloads, then decompressed zstd frames, then space for the symbols of packed planes. At
        least two more bytes follow the last plane.
    records : (s + 1, 6) int64
        For each stream that a chunk can have: 1 if present, row count, byte position and length
        of its parameters, number of its first plane, and plane count. The last row stays zeros.
    spans : (4, p) int64
        For each plane: radix (0 if not packed), byte position and length of its bytes in `data`,
        and the position that its symbols are written to if it is packed.
    tables : (17, 256, 8) uint8
        Digits of each byte value by radix, from `byte_planes.digit_tables`.
    """

    data: U8
    records: I64
    spans: I64
    tables: U8


@inner_exact
def digits_in_byte(radix: int) -> tuple[int, int]:
    """Return the number of digits in a byte, and the number of byte values in use (SPEC 6.9)."""
    count = 1
    limit = radix
    while limit * radix <= 256:
        limit *= radix
        count += 1
    return count, limit


@inner_exact
def _unpack_digits(
    packed: U8, start: int, table: U8, count: int, out: U8, at: int, length: int
) -> int:
    """Unpack the digits of packed bytes; return the number of non-zero digits beyond `length`."""
    whole = length // count
    if count == 2:
        for i in range(whole):
            for j in range(2):
                out[at + 2 * i + j] = table[packed[start + i], j]
    elif count == 3:
        for i in range(whole):
            for j in range(3):
                out[at + 3 * i + j] = table[packed[start + i], j]
    elif count == 4:
        for i in range(whole):
            for j in range(4):
                out[at + 4 * i + j] = table[packed[start + i], j]
    elif count == 5:
        for i in range(whole):
            for j in range(5):
                out[at + 5 * i + j] = table[packed[start + i], j]
    else:
        for i in range(whole):
            for j in range(8):
                out[at + 8 * i + j] = table[packed[start + i], j]
    rest = length - whole * count
    beyond = 0
    if rest:
        for j in range(count):
            digit = table[packed[start + whole], j]
            if j < rest:
                out[at + whole * count + j] = digit
            elif digit:
                beyond += 1
    return beyond


@inner_exact
def parse_frame(data: U8, start: int, stored: int) -> tuple[int, int]:
    """Return the end and the decoded size of a zstd frame; -1 for both if it is not supported.

    Supported is the header of encoders that know the content size: a single segment, a size of 1, 2
    or 4 bytes, no dictionary and no checksum (RFC 8878, 3.1.1.1). Blocks are skipped undecoded.
    """
    # Magic number, descriptor, a size of one byte, the header of a block.
    if stored < 9:
        return -1, -1
    magic = int(data[start]) | int(data[start + 1]) << 8
    magic |= int(data[start + 2]) << 16 | int(data[start + 3]) << 24
    if magic != _MAGIC:
        return -1, -1
    descriptor = int(data[start + 4])
    at = start + 5
    if descriptor == _SINGLE_SEGMENT:
        size = int(data[at])
        at += 1
    elif descriptor == _SINGLE_SEGMENT | 1 << 6:
        size = (int(data[at]) | int(data[at + 1]) << 8) + 256
        at += 2
    elif descriptor == _SINGLE_SEGMENT | 2 << 6:
        size = int(data[at]) | int(data[at + 1]) << 8
        size |= int(data[at + 2]) << 16 | int(data[at + 3]) << 24
        at += 4
    else:
        return -1, -1
    end = start + stored
    last = False
    while not last:
        if at + 3 > end:
            return -1, -1
        block = int(data[at]) | int(data[at + 1]) << 8 | int(data[at + 2]) << 16
        last = (block & 1) == 1
        # A block of type 1 is one repeated byte, any other has the length of its header.
        at += 4 if (block >> 1 & 3) == 1 else 3 + (block >> 3)
    return at, int(np.int64(size))


@inner_exact
def plane_start(planes: ChunkPlanes, plane: int, length: int) -> int:
    """Return the position of a plane's symbols, unpacked if need be; -1 if the plane is invalid.

    Parameters
    ----------
    planes : ChunkPlanes
    plane : int
        Number of the plane in the chunk.
    length : int
        Number of symbols that the plane must hold.
    """
    spans, data = planes.spans, planes.data
    radix, start, size = spans[RADIX, plane], spans[START, plane], spans[SIZE, plane]
    out = int(spans[SYMBOLS, plane])
    if length > MAX_PLANE_BYTES:
        return -1
    if not radix:
        return int(start) if size == length else -1
    count, limit = digits_in_byte(radix)
    if size != -(-length // count):
        return -1
    top = 0
    for i in range(start, start + size):
        top = max(top, signed(data[i]))
    if top >= limit:
        return -1
    if _unpack_digits(data, start, planes.tables[radix], count, data, out, length):
        return -1
    return out


@inner_exact
def plane_starts(
    planes: ChunkPlanes, first: int, count: int, length: int, starts: I64, at: int
) -> bool:
    """Find the positions of consecutive planes of equal length; return False if one is invalid.

    Parameters
    ----------
    planes : ChunkPlanes
    first, count : int
        Number of the first plane in the chunk, and number of planes.
    length : int
        Number of symbols in each plane.
    starts : int64, out
        Positions of the planes, bytes.
    at : int
        Index in `starts` of the first position written.
    """
    for plane in range(count):
        start = plane_start(planes, first + plane, length)
        if start < 0:
            return False
        starts[at + plane] = start
    return True
