"""Bit fields of varying width, packed without gaps, lowest bit first (SPEC 6.15)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError

U8 = NDArray[np.uint8]
U64 = NDArray[np.uint64]
I64 = NDArray[np.int64]

MAX_WIDTH: Final = 62
"""Largest width of a field, bits: an offset of 7 bits and a value of 62 fit nine bytes."""


def pack(values: U64, widths: U8) -> U8:
    """Pack the low bits of each value into bytes.

    Parameters
    ----------
    values : (n,) uint64
        Values of the fields; bits above the width are ignored.
    widths : (n,) uint8
        Width of each field, bits; at most `MAX_WIDTH`.

    Returns
    -------
    (m,) uint8
        Packed fields; the last byte is padded with zero bits.
    """
    lengths = widths.astype(np.int64)
    starts = np.cumsum(lengths) - lengths
    out = np.zeros((int(lengths.sum()) + 7 >> 3) + 1, np.uint8)
    # One pass per bit of the widest field, over the fields that have this bit.
    for bit in range(int(lengths.max(initial=0))):
        rows = np.flatnonzero(lengths > bit)
        position = starts[rows] + bit
        value = (values[rows] >> np.uint64(bit)) & np.uint64(1)
        shifted = (value << (position & 7).astype(np.uint64)).astype(np.uint8)
        np.bitwise_or.at(out, position >> 3, shifted)
    return out[:-1]


def unpack(data: U8, widths: U8, where: str) -> U64:
    """Return the fields of packed bytes; the inverse of `pack`.

    Parameters
    ----------
    data : (m,) uint8
        Exactly `packed_bytes(widths)` bytes.
    widths : (n,) uint8
        Width of each field, bits; at most `MAX_WIDTH`, checked by the caller.
    where : str
        Name of the plane in messages.

    Raises
    ------
    FormatError
        ``bits-padding``: bits after the last field are not zero.
    """
    require_padding(data, widths, where)
    rows = np.flatnonzero(widths)
    if len(rows) * 2 < len(widths):
        # Fields of width 0 take no bits: skipping them saves time if they are many.
        fields = np.zeros(len(widths), np.uint64)
        if len(rows):
            fields[rows] = _fields(data, widths[rows])
        return fields
    return _fields(data, widths)


def require_padding(data: U8, widths: U8, where: str) -> None:
    """Raise ``bits-padding`` if bits after the last field are not zero."""
    total = int(widths.sum(dtype=np.int64))
    if total & 7 and int(data[-1]) >> (total & 7):
        raise FormatError(
            "bits-padding", f"{where}: padding bits are set, expected zeros", clause="6.15"
        )


def _fields(data: U8, widths: U8) -> U64:
    """Return the fields of packed bytes, padding unchecked."""
    lengths = widths.astype(np.int64)
    fields = windows(data, np.cumsum(lengths) - lengths)
    fields &= (np.uint64(1) << widths.astype(np.uint64)) - np.uint64(1)
    return fields


def windows(data: U8, positions: I64) -> U64:
    """Return the 64 bits that begin at each bit position; bits after the data are 0.

    Parameters
    ----------
    data : (m,) uint8
        Packed bytes.
    positions : (n,) int64
        Bit positions, at most 8 m.
    """
    words = np.zeros((len(data) + 7 >> 3) + 2, "<u8")
    words.view(np.uint8)[: len(data)] = data
    index = positions >> 6
    shift = (positions & 63).astype(np.uint64)
    out: U64 = words[index] >> shift
    # Two shifts, by 1 and by up to 63: a shift by 64 is undefined.
    high = words[index + 1] << np.uint64(1)
    high <<= np.uint64(63) - shift
    out |= high
    return out


def packed_bytes(widths: U8) -> int:
    """Return the length in bytes of packed fields."""
    return int(widths.sum(dtype=np.int64)) + 7 >> 3
