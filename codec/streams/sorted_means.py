"""Sorted means: Morton-sorted cells, and each splat's own number of bits below (SPEC 6.5, 6.15)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError
from cogsplat.codec.geometry import morton
from cogsplat.codec.geometry.morton import MAX_AXIS_BITS

from . import adaptive_step as step_models
from . import bit_fields, refinement_bits
from . import grid as grids
from .adaptive_step import MAX_EXTRA_BITS, MODEL_BYTES, StepModel
from .bit_fields import windows
from .grid import ENTRY_BYTES, Grid
from .inputs import Inputs
from .records import Attribute, Kind, StoredStream, Stream
from .refinement_bits import Finer

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
U32 = NDArray[np.uint32]
U64 = NDArray[np.uint64]

_MAX_CLASS: Final = 3 * MAX_AXIS_BITS
_THREE: Final = np.uint8(3)

# Powers of two: the product with the step is exact.
POWERS: Final = np.ldexp(np.float32(1), -np.arange(MAX_EXTRA_BITS + 1)).astype(np.float32)


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


def codes_of(means: F32, grid: Grid, extra_bits: U8) -> U32:
    """Return the (n, 3) codes of means on each row's own halving of a grid."""
    minimum = grid.minimum.astype(np.float64)
    step = np.ldexp(grid.step.astype(np.float64), -extra_bits.astype(np.int32)[:, None])
    codes = np.rint((means.astype(np.float64) - minimum) / np.where(step > 0, step, 1))
    top = np.ldexp(grid.levels.astype(np.float64), extra_bits.astype(np.int32)[:, None]) - 1
    out: U32 = np.clip(codes, 0, top).astype(np.uint32)
    return out


def values(codes: U32, grid: Grid, extra_bits: U8) -> F32:
    """Return the (n, 3) means of codes on each row's own halving of a grid."""
    out: F32 = codes.astype(np.float32) * (POWERS[extra_bits][:, None] * grid.step) + grid.minimum
    return out


def morton_order(codes: U32, extra_bits: U8) -> I64:
    """Return the rows sorted by the Morton code of their coarse cells, ties as they were."""
    keys = morton.interleave(codes >> extra_bits[:, None])
    return np.argsort(keys, kind="stable").astype(np.int64)


def refine(codes: U32, extra: U8, constant: float) -> tuple[U32, Stream]:
    """Return the codes that a head stores and what refines them.

    Parameters
    ----------
    codes : (n, 3) uint32
        At all extra_bits.
    extra : (n,) uint8
        Those of them that are the refinement's.
    constant : float
        First coefficient of the finer model.
    """
    fields = np.zeros(len(codes), np.uint64)
    coarse = np.empty_like(codes)
    for axis in range(3):
        coarse[:, axis], field = refinement_bits.coarse_of(codes[:, axis], extra)
        fields |= field << (extra.astype(np.uint64) * np.uint64(axis))
    plane = bit_fields.pack(fields, extra * _THREE)
    return coarse, refinement_bits.bits_stream(Attribute.MEANS, [constant], [plane], len(codes))


def write(codes: U32, grid: Grid, extra_bits: U8, model: StepModel) -> Stream:
    """Return a fine stream of means in `morton_order`."""
    classes, deltas = pack_deltas(morton.interleave(codes >> extra_bits[:, None]))
    rest = bit_fields.pack(_fields(codes, extra_bits), extra_bits * _THREE)
    params = grid.pack() + model.pack()
    return Stream(Attribute.MEANS, Kind.FINE, len(codes), params, [classes, deltas, rest])


def _fields(codes: U32, extra_bits: U8) -> U64:
    wide = extra_bits.astype(np.uint64)
    low = codes.astype(np.uint64) & ((np.uint64(1) << wide) - np.uint64(1))[:, None]
    fields: U64 = low[:, 0] | (low[:, 1] << wide) | (low[:, 2] << (wide + wide))
    return fields


def write_cells(axis_codes: U32, grid: Grid) -> Stream:
    """Return a morton stream of (n, 3) axis codes whose Morton codes ascend."""
    classes, bits = pack_deltas(morton.interleave(axis_codes))
    return Stream(Attribute.MEANS, Kind.MORTON, len(axis_codes), grid.pack(), [classes, bits])


def parse_cells(stream: StoredStream) -> Grid:
    """Return the grid of a morton stream, whose number of planes is checked."""
    params = stream.require_params(3 * ENTRY_BYTES)
    grid = grids.unpack(params, 3, stream.where, morton.MAX_LEVELS)
    stream.require_planes(2)
    return grid


def parse(stream: StoredStream) -> tuple[Grid, StepModel]:
    """Return the coarse grid and the step model of a fine stream, its number of planes checked."""
    params = stream.require_params(3 * ENTRY_BYTES + MODEL_BYTES)
    grid = grids.unpack(params[: 3 * ENTRY_BYTES], 3, stream.where, morton.MAX_LEVELS)
    model = step_models.unpack(params[3 * ENTRY_BYTES :], stream.where)
    if len(stream.words) != 3:
        raise FormatError(
            "stream-planes", f"{stream.where}: {len(stream.words)} planes, expected 3",
            clause="6.15",
        )  # fmt: skip
    return grid, model


def finer_of(inputs: Inputs) -> Finer | None:
    """Return what refines a stream with an adaptive step, None where nothing does."""
    if inputs.refinement is None or inputs.refined_scales is None:
        return None
    return Finer(inputs.refinement, inputs.refined_scales)


def scales_of(inputs: Inputs) -> F32:
    """Return the scales that the step of a stream follows from."""
    if inputs.scales is None:
        raise ValueError("no scales for a stream with an adaptive step")
    return inputs.scales


def _cells(stream: StoredStream, grid: Grid, clause: str) -> U32:
    classes = stream.plane(0, stream.rows)
    deltas = stream.plane(1, bits_length(classes, stream.where))
    coarse = morton.deinterleave(unpack_deltas(classes, deltas, stream.where))
    top = coarse.max(axis=0, initial=0)
    if bool((top >= grid.levels).any()):
        raise FormatError(
            "code-range",
            f"{stream.where}: codes up to {top.tolist()}, expected below {grid.levels.tolist()}",
            clause=clause,
        )
    return coarse


def read_cells(stream: StoredStream, out: F32, inputs: Inputs) -> None:
    """Write the values of a morton stream into (rows, 3) float32 `out`."""
    grid = parse_cells(stream)
    out[:] = grid.dequantise(_cells(stream, grid, "6.5"))


def read(stream: StoredStream, out: F32, inputs: Inputs) -> None:
    """Write the values of a fine stream of means into (rows, 3) float32 `out`."""
    grid, model = parse(stream)
    finer = finer_of(inputs)
    extra_bits = model.extra_bits(scales_of(inputs))
    coarse = _cells(stream, grid, "6.15")
    widths = extra_bits * _THREE
    fields = bit_fields.unpack(
        stream.plane(2, bit_fields.packed_bytes(widths)), widths, stream.where
    )
    extra = np.zeros_like(extra_bits)
    below = np.zeros(stream.rows, np.uint64)
    if finer is not None:
        (extra,) = finer.extra([model], [extra_bits])
        finer.stream.require_planes(1)
        below = finer.fields(0, extra * _THREE)
    wide, more = extra_bits.astype(np.uint64), extra.astype(np.uint64)
    half = refinement_bits.half_of(extra)
    scale = POWERS[extra_bits + extra]
    step = grid.step
    for axis in range(3):
        codes = (coarse[:, axis].astype(np.uint64) << wide) | _field(fields, wide, axis)
        refined = ((codes << more) | _field(below, more, axis)).astype(np.int64) - half
        if finer is not None and int(refined.min(initial=0)) < 0:
            raise finer.refuse()
        np.multiply(refined.astype(np.float32), scale * step[axis], out=out[:, axis])
    out += grid.minimum


def _field(fields: U64, wide: U64, axis: int) -> U64:
    """Return one axis' bits of fields of three times so many."""
    mask = (np.uint64(1) << wide) - np.uint64(1)
    out: U64 = (fields >> (wide * np.uint64(axis))) & mask
    return out
