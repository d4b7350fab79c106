"""Fields of differing width, packed without gaps, lowest bit first (SPEC 6.5)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from .errors import FormatError

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
    lengths = widths.astype(np.int64)
    ends = np.cumsum(lengths)
    starts = ends - lengths
    total = int(ends[-1]) if len(ends) else 0
    if total & 7 and int(data[-1]) >> (total & 7):
        raise FormatError(
            "bits-padding", f"{where}: padding bits are set, expected zeros", clause="6.5"
        )
    padded = np.zeros(len(data) + 16, np.uint8)
    padded[: len(data)] = data
    windows = np.lib.stride_tricks.as_strided(padded, (len(padded) - 7, 8), (1, 1), writeable=False)
    first = starts >> 3
    shift = (starts & 7).astype(np.uint64)
    fields: U64 = np.ascontiguousarray(windows[first]).view("<u8")[:, 0] >> shift
    if int(lengths.max(initial=0)) > 56:
        # The ninth byte; a shift by 64 would be undefined, two by 56 and 8 are not.
        high = padded[first + 8].astype(np.uint64)
        fields = fields | ((high << np.uint64(56)) << (np.uint64(8) - shift))
    fields &= (np.uint64(1) << widths.astype(np.uint64)) - np.uint64(1)
    return fields


def packed_bytes(widths: U8) -> int:
    """Return the length in bytes of packed fields."""
    return int(widths.sum(dtype=np.int64)) + 7 >> 3
