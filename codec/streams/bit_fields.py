"""Fields of differing width, packed without gaps, lowest bit first (SPEC 6.15)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError

U8 = NDArray[np.uint8]
U64 = NDArray[np.uint64]
I64 = NDArray[np.int64]

MAX_WIDTH: Final = 62
"""Widest field: 7 bits of offset and 62 of value fit nine bytes."""


def pack(values: U64, widths: U8) -> U8:
    """Return the low `widths` bits of each value, one field after the other.

    Parameters
    ----------
    values : (n,) uint64
        Bits above the width are ignored.
    widths : (n,) uint8
        At most `MAX_WIDTH`.

    Returns
    -------
    (m,) uint8
        Zero bits up to the end of the last byte.
    """
    lengths = widths.astype(np.int64)
    starts = np.cumsum(lengths) - lengths
    out = np.zeros((int(lengths.sum()) + 7 >> 3) + 1, np.uint8)
    # One pass per bit of the widest field: the fields that have it set their byte.
    for bit in range(int(lengths.max(initial=0))):
        rows = np.flatnonzero(lengths > bit)
        position = starts[rows] + bit
        value = (values[rows] >> np.uint64(bit)) & np.uint64(1)
        shifted = (value << (position & 7).astype(np.uint64)).astype(np.uint8)
        np.bitwise_or.at(out, position >> 3, shifted)
    return out[:-1]


def unpack(data: U8, widths: U8, where: str) -> U64:
    """Return the fields that `pack` stored.

    Parameters
    ----------
    data : (m,) uint8
        Exactly `packed_bytes(widths)` bytes.
    widths : (n,) uint8
        At most `MAX_WIDTH`, which the caller has checked.
    where : str
        Names the plane in messages.

    Raises
    ------
    FormatError
        ``bits-padding``: bits behind the last field are not zero.
    """
    require_padding(data, widths, where)
    rows = np.flatnonzero(widths)
    if len(rows) * 2 < len(widths):
        # Fields without bits take no place: leave them out while they are many.
        fields = np.zeros(len(widths), np.uint64)
        if len(rows):
            fields[rows] = _fields(data, widths[rows])
        return fields
    return _fields(data, widths)


def require_padding(data: U8, widths: U8, where: str) -> None:
    """Refuse bits behind the last field that are not zero, as `unpack` does."""
    total = int(widths.sum(dtype=np.int64))
    if total & 7 and int(data[-1]) >> (total & 7):
        raise FormatError(
            "bits-padding", f"{where}: padding bits are set, expected zeros", clause="6.15"
        )


def _fields(data: U8, widths: U8) -> U64:
    lengths = widths.astype(np.int64)
    fields = windows(data, np.cumsum(lengths) - lengths)
    fields &= (np.uint64(1) << widths.astype(np.uint64)) - np.uint64(1)
    return fields


def windows(data: U8, positions: I64) -> U64:
    """Return the 64 bits from each position on, the lowest first; zeros behind the data.

    Parameters
    ----------
    data : (m,) uint8
    positions : (n,) int64
        In bits, at most 8 m.
    """
    words = np.zeros((len(data) + 7 >> 3) + 2, "<u8")
    words.view(np.uint8)[: len(data)] = data
    index = positions >> 6
    shift = (positions & 63).astype(np.uint64)
    out: U64 = words[index] >> shift
    # Shifts by 64 would be undefined, by 1 and 63 are not.
    high = words[index + 1] << np.uint64(1)
    high <<= np.uint64(63) - shift
    out |= high
    return out


def packed_bytes(widths: U8) -> int:
    """Return the length in bytes of packed fields."""
    return int(widths.sum(dtype=np.int64)) + 7 >> 3
