"""Compiled decoding of byte planes: several at once, end to end (SPEC 6.3, 6.9)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.compiling import called_with

from . import zstd_frames
from .byte_planes import LENGTH_MASK, PACKED_FLAG, ZSTD_FLAG, digit_tables
from .kernels_bits import exact, inner_exact
from .limits import MAX_PLANE_BYTES
from .records import StoredStream

I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
U64 = NDArray[np.uint64]

# RFC 8878, 3.1.1: the magic number, and the descriptor's bit for a frame of a single segment.
_MAGIC: Final = 0xFD2FB528
_SINGLE_SEGMENT: Final = 0x20


@inner_exact
def spread(packed: U8, start: int, table: U8, count: int, out: U8, at: int, length: int) -> int:
    """Write the digits of bytes of one radix; return the digits behind the last that are not 0."""
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
def _copy(packed: U8, start: int, out: U8, at: int, length: int) -> None:
    """Copy bytes. Not by slices: numba compiles its error messages about shapes for seconds."""
    for i in range(length):
        out[at + i] = packed[start + i]


@inner_exact
def frame(octets: U8, start: int, stored: int) -> tuple[int, int]:
    """Return where a zstd frame ends and what it holds, -1 where its header is not the usual one.

    Usual is what encoders write who know the size: one segment, its size in 1, 2 or 4 bytes,
    neither dictionary nor checksum (RFC 8878, 3.1.1.1). Blocks are counted, not decoded.
    """
    # Magic number, descriptor, a size of one byte, the header of a block.
    if stored < 9:
        return -1, -1
    magic = int(octets[start]) | int(octets[start + 1]) << 8
    magic |= int(octets[start + 2]) << 16 | int(octets[start + 3]) << 24
    if magic != _MAGIC:
        return -1, -1
    descriptor = int(octets[start + 4])
    at = start + 5
    if descriptor == _SINGLE_SEGMENT:
        stated = int(octets[at])
        at += 1
    elif descriptor == _SINGLE_SEGMENT | 1 << 6:
        stated = (int(octets[at]) | int(octets[at + 1]) << 8) + 256
        at += 2
    elif descriptor == _SINGLE_SEGMENT | 2 << 6:
        stated = int(octets[at]) | int(octets[at + 1]) << 8
        stated |= int(octets[at + 2]) << 16 | int(octets[at + 3]) << 24
        at += 4
    else:
        return -1, -1
    end = start + stored
    last = False
    while not last:
        if at + 3 > end:
            return -1, -1
        block = int(octets[at]) | int(octets[at + 1]) << 8 | int(octets[at + 2]) << 16
        last = (block & 1) == 1
        # One byte that is repeated, or as many as the header says.
        at += 4 if (block >> 1 & 3) == 1 else 3 + (block >> 3)
    return at, int(np.int64(stated))


@called_with("Array(uint8, 1, 'C', True), int64[:, ::1], uint64[:, ::1], uint64[::1]")
@exact
def _locate(octets: U8, spans: I64, frames: U64, sizes: U64) -> int:
    """Find the bytes of planes, before digits are taken apart.

    Parameters
    ----------
    octets : uint8
        The payload.
    spans : (5, p) int64, in and out
        In: word, end in the payload and decoded length of each plane. Out: radix (0 where nothing
        is packed), where its bytes start, its decoded length, how many bytes there are, and
        whether they are in a zstd frame; then they start where they will stand once all frames
        are decompressed.
    frames : (p, 2) uint64, out
        Start and length of each zstd frame.
    sizes : (p,) uint64, out
        Bytes that each holds.

    Returns
    -------
    int
        How many frames there are; -1 where anything is unusual.
    """
    found = 0
    expanded = 0
    for plane in range(spans.shape[1]):
        word, end, length = spans[0, plane], spans[1, plane], spans[2, plane]
        stored = word & LENGTH_MASK
        start = end - stored
        size = length
        radix = 0
        if length > MAX_PLANE_BYTES:
            return -1
        if word & PACKED_FLAG:
            radix = int(octets[start]) if stored else 0
            if radix < 2 or radix > 16:
                return -1
            size = -(-length // digits_in_byte(radix)[0])
            start += 1
            stored -= 1
        zipped = word & ZSTD_FLAG
        if zipped:
            if size == 0 or frame(octets, start, stored) != (end, size):
                return -1
            frames[found, 0] = start
            frames[found, 1] = stored
            sizes[found] = size
            found += 1
            start = expanded
            expanded += size
        elif stored != size:
            return -1
        spans[0, plane], spans[1, plane] = radix, start
        spans[3, plane], spans[4, plane] = size, zipped
    return found


@inner_exact
def digits_in_byte(radix: int) -> tuple[int, int]:
    """Return how many digits fit a byte, and how many values they have (SPEC 6.9)."""
    count = 1
    limit = radix
    while limit * radix <= 256:
        limit *= radix
        count += 1
    return count, limit


@called_with(
    "Array(uint8, 1, 'C', True), Array(uint8, 1, 'C', True), int64[:, ::1], "
    "uint8[:, :, ::1], uint8[::1], int64"
)
@exact
def _unpack(octets: U8, expanded: U8, spans: I64, tables: U8, out: U8, at: int) -> bool:
    """Write planes end to end from what is stored (SPEC 6.3, 6.9).

    Parameters
    ----------
    octets : uint8
        The payload.
    expanded : uint8
        What its zstd frames hold.
    spans : (5, p) int64
        As `_locate` leaves them.
    tables : (17, 256, 8) uint8
        Digits of each byte by radix.
    out : uint8
    at : int
        Where the first plane goes.

    Returns
    -------
    bool
        False where a byte or a digit is out of range.
    """
    for plane in range(spans.shape[1]):
        radix, start, length, size = (
            spans[0, plane],
            spans[1, plane],
            spans[2, plane],
            spans[3, plane],
        )
        packed = expanded if spans[4, plane] else octets
        if radix:
            count, limit = digits_in_byte(radix)
            top = 0
            for i in range(start, start + size):
                top = max(top, int(packed[i]))
            if top >= limit or spread(packed, start, tables[radix], count, out, at, length):
                return False
        else:
            _copy(packed, start, out, at, length)
        at += length
    return True


Run = tuple[StoredStream, int, Sequence[int]]
"""Consecutive planes: their stream, the first one's number there, and what each decodes to."""


def join(runs: Sequence[Run]) -> U8:
    """Return the planes of runs end to end, and two zeros behind them.

    Raises
    ------
    FormatError
        As `byte_planes.unpack_plane`.
    """
    total = sum(sum(lengths) for _, _, lengths in runs)
    out = np.empty(total + 2, np.uint8)
    out[total:] = 0
    at = 0
    for stream, first, lengths in runs:
        if not _write_run(stream, first, lengths, out, at):
            # One by one, which raises the error that names what is wrong, if anything is.
            for number, length in enumerate(lengths, start=first):
                out[at : at + length] = stream.plane(number, length)
                at += length
        else:
            at += sum(lengths)
    # As planes are that numpy reads: kernels are compiled for one kind of array.
    out.flags.writeable = False
    return out


def _write_run(stream: StoredStream, first: int, lengths: Sequence[int], out: U8, at: int) -> bool:
    """Write planes end to end all at once; False where one of them is wrong, or unusual."""
    planes = stream.planes
    count = len(lengths)
    own = slice(stream.first + first, stream.first + first + count)
    spans = np.empty((5, count), np.int64)
    spans[0] = planes.words[own]
    spans[1] = planes.ends[own]
    spans[2] = lengths
    frames = np.empty((count, 2), np.uint64)
    sizes = np.empty(count, np.uint64)
    found = _locate(planes.octets, spans, frames, sizes)
    if found < 0:
        return False
    expanded = planes.octets[:0]
    if found:
        raw = zstd_frames.decompress_located(planes.payload, frames[:found], sizes[:found])
        if raw is None:
            return False
        expanded = np.frombuffer(raw, np.uint8)
    return _unpack(planes.octets, expanded, spans, digit_tables(), out, at)


def join_run(stream: StoredStream, first: int, lengths: Sequence[int]) -> U8:
    """Return consecutive planes of a stream, from number `first` on, as `join` does."""
    return join([(stream, first, lengths)])
