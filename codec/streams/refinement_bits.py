"""Bits streams: bits that refine sorted means, the same number for every row (SPEC 6.17)."""

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
"""Maximum number of bits that a refinement adds to each axis (SPEC 6.17)."""

_PARAMS: Final = struct.Struct("<B3s")


def half_level(bits: int) -> int:
    """Return half a step of the head, counted in refined steps; each bit halves the step."""
    return 1 << bits >> 1


def coarse_codes(codes: I64, bits: int) -> I64:
    """Round refined codes to the codes that the head stores, which have `bits` fewer bits."""
    coarse: I64 = (codes + half_level(bits)) >> bits
    return coarse


def write(codes: I64, bits: int) -> Stream:
    """Return the bits stream of means.

    Parameters
    ----------
    codes : (n, 3) int64
        Refined codes in the order of the head, which stores their `coarse_codes`.
    bits : int
        Number of bits that the refinement adds to each axis, 1 to `MAX_BITS`.
    """
    low = (codes + half_level(bits) - (coarse_codes(codes, bits) << bits)).astype(np.uint64)
    fields = low[:, 0] | (low[:, 1] << np.uint64(bits)) | (low[:, 2] << np.uint64(2 * bits))
    plane = bit_fields.pack(fields, _field_widths(len(codes), bits))
    return Stream(Attribute.MEANS, Kind.BITS, len(codes), _PARAMS.pack(bits, bytes(3)), [plane])


def _field_widths(rows: int, bits: int) -> U8:
    """Return the width of each row's packed field: `bits` bits for each of three axes."""
    return np.full(rows, 3 * bits, np.uint8)


def parse(stream: StoredStream) -> int:
    """Return the bits that a refinement adds to each axis; the number of planes is checked.

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
        ``bits-padding``, or a code of `byte_planes.unpack_plane`.
    """
    widths = _field_widths(stream.rows, bits)
    plane = stream.plane(0, bit_fields.packed_bytes(widths))
    bit_fields.require_padding(plane, widths, stream.where)
    return plane


def read(stream: StoredStream, codes: I64) -> tuple[I64, int]:
    """Return refined codes and the bits added to each axis.

    Parameters
    ----------
    stream : StoredStream
        Bits stream of the refinement.
    codes : (rows, 3) int64
        Codes of the head.

    Raises
    ------
    FormatError
        Codes of `parse` and `read_plane`; ``code-range``: a refined code below 0.
    """
    bits = parse(stream)
    fields = bit_fields.unpack(
        read_plane(stream, bits), _field_widths(stream.rows, bits), stream.where
    )
    refined = codes << bits
    mask = np.uint64((1 << bits) - 1)
    for axis in range(3):
        low = (fields >> np.uint64(bits * axis)) & mask
        refined[:, axis] += low.astype(np.int64) - half_level(bits)
    if int(refined.min(initial=0)) < 0:
        raise FormatError(
            "code-range",
            f"{stream.where}: refined code {int(refined.min())}, expected at least 0",
            clause="6.17",
        )
    return refined, bits
