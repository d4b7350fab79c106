"""Compiled decoding of byte planes: several at once, end to end (SPEC 6.3, 6.9)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.compiling import called_with

from .byte_planes import digit_tables, expand, packing_of
from .kernels_bits import exact
from .records import StoredStream

I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]


@exact
def _spread(packed: U8, start: int, table: U8, count: int, out: U8, at: int, length: int) -> int:
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


@exact
def _copy(packed: U8, start: int, out: U8, at: int, length: int) -> None:
    """Copy bytes. Not by slices: numba compiles its error messages about shapes for seconds."""
    for i in range(length):
        out[at + i] = packed[start + i]


@called_with("Array(uint8, 1, 'C', True), int64[:, ::1], uint8[:, :, ::1], uint8[::1]")
@exact
def _unpack(packed: U8, spans: I64, tables: U8, out: U8) -> int:
    """Write planes end to end from packed ones (SPEC 6.3, 6.9), and what stands behind the last.

    Parameters
    ----------
    packed : uint8
        Planes end to end, digits still packed.
    spans : (3, p) int64
        Radix (0 where nothing is packed), length in `packed` and in `out` of each plane.
    tables : (17, 256, 8) uint8
        Digits of each byte by radix.
    out : uint8

    Returns
    -------
    int
        The first plane with a byte or digit out of range, -1 where there is none.
    """
    start = 0
    at = 0
    for plane in range(spans.shape[1]):
        radix, size, length = spans[0, plane], spans[1, plane], spans[2, plane]
        if radix:
            count = 1
            limit = radix
            while limit * radix <= 256:
                limit *= radix
                count += 1
            top = 0
            for i in range(start, start + size):
                top = max(top, int(packed[i]))
            if top >= limit or _spread(packed, start, tables[radix], count, out, at, length):
                return plane
        else:
            _copy(packed, start, out, at, length)
        start += size
        at += length
    _copy(packed, start, out, at, len(packed) - start)
    return -1


def join(parts: Sequence[tuple[StoredStream, int, int]]) -> U8:
    """Return planes end to end, and two zeros behind them.

    Parameters
    ----------
    parts : sequence of (StoredStream, int, int)
        For each plane its stream, its number there and the bytes it decompresses to.

    Raises
    ------
    FormatError
        As `byte_planes.unpack_plane`.
    """
    bodies: list[bytes | memoryview] = []
    spans = np.zeros((3, len(parts)), np.int64)
    for place, (stream, number, length) in enumerate(parts):
        stored, word = stream.bodies[number], int(stream.words[number])
        where = f"{stream.where}, plane {number}"
        radix, size = packing_of(stored, word, length, where)
        bodies.append(expand(stored[1:] if radix else stored, word, size, where))
        spans[:, place] = radix, size, length
    bodies.append(b"\0\0")
    packed = np.frombuffer(b"".join(bodies), np.uint8)
    if not spans[0].any():
        return packed
    out = np.empty(int(spans[2].sum()) + 2, np.uint8)
    wrong = _unpack(packed, spans, digit_tables(), out)
    if wrong >= 0:
        stream, number, length = parts[wrong]
        # Raises the error that names what is wrong with the plane.
        stream.plane(number, length)
    # As the planes that zstd gives: kernels are compiled for one kind of array.
    out.flags.writeable = False
    return out


def join_run(stream: StoredStream, first: int, lengths: Sequence[int]) -> U8:
    """Return consecutive planes of a stream, from number `first` on, as `join` does."""
    return join([(stream, first + i, length) for i, length in enumerate(lengths)])
