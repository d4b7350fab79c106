"""Bits streams: the same number of further bits for every row of sorted means (SPEC 6.17)."""

from __future__ import annotations

import struct
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError

from . import bit_fields
from .records import Attribute, Kind, StoredStream, Stream

I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]

MAX_BITS: Final = 15
"""Most bits that a refinement adds to an axis (SPEC 6.17)."""

_PARAMS: Final = struct.Struct("<B3s")


def half_of(bits: int) -> int:
    """Return half a level of the head in levels of the refinement, 0 where nothing is refined."""
    return 1 << bits >> 1


def coarse_codes(codes: I64, bits: int) -> I64:
    """Return the codes of the head that are nearest to refined codes."""
    coarse: I64 = (codes + half_of(bits)) >> bits
    return coarse


def write(codes: I64, bits: int) -> Stream:
    """Return the bits stream of means.

    Parameters
    ----------
    codes : (n, 3) int64
        Refined codes, in the order of the head; the head has their `coarse_codes`.
    bits : int
        1 to `MAX_BITS`.
    """
    low = (codes + half_of(bits) - (coarse_codes(codes, bits) << bits)).astype(np.uint64)
    fields = low[:, 0] | (low[:, 1] << np.uint64(bits)) | (low[:, 2] << np.uint64(2 * bits))
    plane = bit_fields.pack(fields, _widths(len(codes), bits))
    return Stream(Attribute.MEANS, Kind.BITS, len(codes), _PARAMS.pack(bits, bytes(3)), [plane])


def _widths(rows: int, bits: int) -> U8:
    return np.full(rows, 3 * bits, np.uint8)


def parse(stream: StoredStream) -> int:
    """Return the number of bits that each axis gains; the number of planes is checked.

    Raises
    ------
    FormatError
        ``stream-params``, ``refinement-bits``, ``stream-planes``.
    """
    bits, reserved = _PARAMS.unpack(stream.require_params(_PARAMS.size))
    if not 1 <= bits <= MAX_BITS or any(reserved):
        raise FormatError(
            "refinement-bits",
            f"{stream.where}: {bits} bits and reserved bytes {reserved.hex()}, "
            f"expected 1 to {MAX_BITS}, and zeros",
            clause="6.17",
        )
    stream.require_planes(1)
    return int(bits)


def read_plane(stream: StoredStream, bits: int) -> U8:
    """Return the plane of a bits stream, its padding checked.

    Raises
    ------
    FormatError
        ``bits-padding``, or what is wrong with the plane.
    """
    widths = _widths(stream.rows, bits)
    plane = stream.plane(0, bit_fields.packed_bytes(widths))
    bit_fields.require_padding(plane, widths, stream.where)
    return plane


def read(stream: StoredStream, codes: I64) -> tuple[I64, int]:
    """Return refined codes, and how many bits they have gained.

    Parameters
    ----------
    stream : StoredStream
    codes : (rows, 3) int64
        Of the head.

    Raises
    ------
    FormatError
        As `parse` and `read_plane`; ``code-range``: a refined code below 0.
    """
    bits = parse(stream)
    fields = bit_fields.unpack(read_plane(stream, bits), _widths(stream.rows, bits), stream.where)
    refined = codes << bits
    mask = np.uint64((1 << bits) - 1)
    for axis in range(3):
        low = (fields >> np.uint64(bits * axis)) & mask
        refined[:, axis] += low.astype(np.int64) - half_of(bits)
    if int(refined.min(initial=0)) < 0:
        raise FormatError(
            "code-range",
            f"{stream.where}: refined code {int(refined.min())}, expected at least 0",
            clause="6.17",
        )
    return refined, bits
