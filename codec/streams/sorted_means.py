"""Morton order of quantised means, and the deltas that store it (SPEC 6.5)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError
from cogsplat.codec.geometry.morton import (
    MAX_AXIS_BITS,
)

from .bit_fields import windows

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]
U32 = NDArray[np.uint32]
U64 = NDArray[np.uint64]

_MAX_CLASS: Final = 3 * MAX_AXIS_BITS


def pack_deltas(morton: U64) -> tuple[U8, U8]:
    """Return the class and the bits plane of ascending Morton codes.

    Parameters
    ----------
    morton : (n,) uint64
        Ascending.

    Returns
    -------
    classes : (n,) uint8
        Bit length of each code's difference to the one before (the first one's to 0).
    bits : (m,) uint8
        Every difference without its leading one, lowest bit first, packed without gaps.
    """
    deltas = np.diff(morton, prepend=np.uint64(0))
    classes = _bit_length(deltas)
    lengths = np.maximum(classes.astype(np.int64) - 1, 0)
    starts = np.cumsum(lengths) - lengths
    total = int(lengths.sum())
    # One row per bit: which difference it belongs to, and which bit of it.
    owner = np.repeat(np.arange(len(deltas)), lengths)
    bit = np.arange(total) - starts[owner]
    values = (deltas[owner] >> bit.astype(np.uint64)) & np.uint64(1)
    return classes, np.packbits(values.astype(np.uint8), bitorder="little")


def _bit_length(values: U64) -> U8:
    length = np.zeros(len(values), np.uint8)
    rest = values.copy()
    for shift in (32, 16, 8, 4, 2, 1):
        large = rest >= (np.uint64(1) << np.uint64(shift))
        length[large] += np.uint8(shift)
        rest[large] >>= np.uint64(shift)
    return length + (values > 0).astype(np.uint8)


def bits_length(classes: U8, where: str) -> int:
    """Return the length in bytes of the bits plane that belongs to a class plane.

    Raises
    ------
    FormatError
        ``morton-class``: a class above 63.
    """
    if len(classes) and int(classes.max()) > _MAX_CLASS:
        raise FormatError(
            "morton-class",
            f"{where}: class {int(classes.max())}, expected at most {_MAX_CLASS}",
            clause="6.5",
        )
    return bits_count(classes) + 7 >> 3


def bits_count(classes: U8) -> int:
    """Return how many bits the differences of these classes take."""
    # bincount keeps this exact and cheap for any number of rows.
    counts = np.bincount(classes, minlength=_MAX_CLASS + 1)
    return int((counts[1:] * np.arange(len(counts) - 1)).sum())


def unpack_deltas(classes: U8, bits: U8, where: str) -> U64:
    """Return the Morton codes of a class and a bits plane.

    Raises
    ------
    FormatError
        ``morton-padding``: bits behind the last difference are not zero; ``morton-range``: the
        sum leaves 63 bits.
    """
    lengths = np.maximum(classes, 1).astype(np.int64) - 1
    ends = np.cumsum(lengths)
    starts = ends - lengths
    total = int(ends[-1]) if len(ends) else 0
    if total & 7 and int(bits[-1]) >> (total & 7):
        raise FormatError(
            "morton-padding", f"{where}: padding bits are set, expected zeros", clause="6.5"
        )
    low = windows(bits, starts)
    width = lengths.astype(np.uint64)
    deltas = (low & ((np.uint64(1) << width) - np.uint64(1))) | (np.uint64(1) << width)
    deltas[classes == 0] = 0
    codes = np.cumsum(deltas, dtype=np.uint64)
    # Differences are below 2^63, so that the first step out of range shows as bit 63.
    if len(codes) and bool((codes >> np.uint64(63)).any()):
        raise FormatError("morton-range", f"{where}: a code needs more than 63 bits", clause="6.5")
    return codes


@dataclass(frozen=True, eq=False)
class Cells:
    """What Morton codes and the bits below them are worth.

    Parameters
    ----------
    levels : (3,) uint32
        Axis codes of a Morton code are below these.
    factors : (h, 3) float32
        Distance between values after 0, 1, … h - 1 halvings.
    minimum : (3,) float32
        Of code 0.
    """

    levels: U32
    factors: F32
    minimum: F32


def read_compiled(
    classes: U8,
    deltas: U8,
    halvings: U8,
    fields: U8,
    used: tuple[int, int],
    cells: Cells,
    out: F32,
    finer: tuple[U8, U8] | None = None,
) -> bool:
    """Write (n, 3) means as `unpack_deltas` and all that follows would, or find something wrong.

    Parameters
    ----------
    classes, deltas : uint8
        Planes, the second `bits_length` bytes.
    halvings : (n,) uint8
    fields : uint8
        Plane of three times as many bits a row (SPEC 6.15).
    used : tuple of int
        Bits that are used of the deltas and of the fields.
    cells : Cells
    out : (n, 3) float32
    finer : tuple of uint8 arrays, optional
        Halvings that a refinement adds to each row, and the plane of three times as many bits,
        its padding checked (SPEC 6.17).

    Returns
    -------
    bool
        False where codes or padding break SPEC 6.5, 6.15 or 6.17; `out` is then of no use.
    """
    from cogsplat.codec.streams import kernels

    for plane, total in zip((deltas, fields), used, strict=True):
        if total & 7 and int(plane[-1]) >> (total & 7):
            return False
    none = halvings[:0]
    extra, below = (none, none) if finer is None else finer
    return kernels.fine_means(
        classes,
        kernels.words(deltas),
        halvings,
        kernels.words(fields),
        kernels.AXES_OF_BITS,
        cells.levels.astype(np.int64),
        cells.factors,
        cells.minimum,
        extra,
        kernels.words(below),
        out,
    )
