"""Sorted streams: means as Morton-sorted cells and extra bits within the cells (SPEC 6.5)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError
from cogsplat.codec.geometry import morton

from . import adaptive_step as step_models
from . import bit_fields, refinement_bits
from . import grid as grids
from .adaptive_step import MAX_EXTRA_BITS, MODEL_BYTES, StepModel
from .grid import ENTRY_BYTES, Grid
from .records import Attribute, Kind, StoredStream, Stream
from .stream_inputs import Inputs

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
U32 = NDArray[np.uint32]
U64 = NDArray[np.uint64]

CELL_AXIS_BITS: Final = 17
"""Bits of a cell's coordinate along one axis."""
MAX_CELLS: Final = 1 << CELL_AXIS_BITS
"""Maximum number of cells along an axis (SPEC 6.5)."""

MORTON_BITS: Final = 3 * CELL_AXIS_BITS
"""Morton codes stay below 2^51: a double holds them and their differences (SPEC 6.5)."""

_THREE: Final = np.uint8(3)

POWERS: Final = np.ldexp(
    np.float32(1), -np.arange(MAX_EXTRA_BITS + refinement_bits.MAX_BITS + 1)
).astype(np.float32)
"""2^-m for each number m of bits below a cell; products with a step are exact or underflow."""


def cell_grid(grid: Grid) -> tuple[Grid, int]:
    """Return a coarse grid of cells for a fine grid, and the number of bits below a cell.

    Parameters
    ----------
    grid : Grid
        Fine grid of three components with any number of levels.

    Returns
    -------
    cells : Grid
        Grid of the cells, at most `MAX_CELLS` levels along each axis.
    bits : int
        Number of times that a cell is halved to reach the fine step; 0 if cells are fine levels.
    """
    bits = max(0, (int(grid.levels.max()) - 1).bit_length() - CELL_AXIS_BITS)
    levels = (grid.levels.astype(np.int64) + (1 << bits) - 1) >> bits
    # A single level would have no step to halve.
    levels = np.where(grid.levels > 1, np.maximum(levels, 2), 1)
    step = grid.step.astype(np.float64) * 2.0**bits
    maximum = grid.minimum.astype(np.float64) + (levels - 1) * step
    if bits == 0:
        return grid, 0
    return Grid(grid.minimum, maximum.astype(np.float32), levels.astype(np.uint32)), bits


def quantise(means: F32, grid: Grid, extra_bits: U8, refined_by: int = 0) -> I64:
    """Return the codes of means; the step of a row is the cell size halved once per extra bit.

    Parameters
    ----------
    means : (n, 3) float32
        Scene units.
    grid : Grid
        Grid of the cells.
    extra_bits : (n,) uint8
        Number of bits below the cell that the head stores for each row, per axis.
    refined_by : int
        Number of bits that a refinement adds to each axis.

    Returns
    -------
    (n, 3) int64
        Refined codes; the nearest code of the head is within the head's levels.
    """
    total = extra_bits.astype(np.int32)[:, None] + refined_by
    step = np.ldexp(grid.step.astype(np.float64), -total)
    minimum = grid.minimum.astype(np.float64)
    codes = np.rint((means.astype(np.float64) - minimum) / np.where(step > 0, step, 1))
    top = (
        np.ldexp(grid.levels.astype(np.float64), total) - 1 - refinement_bits.half_level(refined_by)
    )
    out: I64 = np.clip(codes, 0, top).astype(np.int64)
    return out


def dequantise(codes: I64, grid: Grid, bits: U8) -> F32:
    """Return the (n, 3) float32 means of codes with `bits` bits below the cell (SPEC 6.5)."""
    same = len(bits) > 0 and int(bits.min()) == int(bits.max())
    powers = POWERS[bits[:1]] if same else POWERS[bits]
    step = powers[:, None] * grid.step
    out: F32 = codes.astype(np.float32) * step + grid.minimum
    return out


def morton_order(codes: I64, extra_bits: U8) -> I64:
    """Return the stable sort order of rows by the Morton codes of their cells."""
    keys = morton.interleave(_cells(codes, extra_bits))
    return np.argsort(keys, kind="stable").astype(np.int64)


def _cells(codes: I64, extra_bits: U8) -> U32:
    """Return the (n, 3) grid cells of codes: each code shifted right by its row's extra bits."""
    cells: U32 = (codes >> extra_bits.astype(np.int64)[:, None]).astype(np.uint32)
    return cells


def write(codes: I64, grid: Grid, extra_bits: U8, model: StepModel) -> Stream:
    """Return a sorted stream of means.

    Parameters
    ----------
    codes : (n, 3) int64
        Codes in `morton_order`.
    grid : Grid
        Grid of the cells, at most `MAX_CELLS` levels along an axis.
    extra_bits : (n,) uint8
        Number of extra bits of each row, as the model gives it for the head's decoded scales.
    model : StepModel
        Step model from which decoders derive the extra bits.
    """
    classes, differences = pack_differences(morton.interleave(_cells(codes, extra_bits)))
    wide = extra_bits.astype(np.uint64)
    low = codes.astype(np.uint64) & ((np.uint64(1) << wide) - np.uint64(1))[:, None]
    fields = low[:, 0] | (low[:, 1] << wide) | (low[:, 2] << (wide + wide))
    below = bit_fields.pack(fields, extra_bits * _THREE)
    params = grid.pack() + model.pack()
    return Stream(Attribute.MEANS, Kind.SORTED, len(codes), params, [classes, differences, below])


def pack_differences(codes: U64) -> tuple[U8, U8]:
    """Split the differences of ascending Morton codes into bit lengths and packed bits.

    Parameters
    ----------
    codes : (n,) uint64
        Ascending Morton codes.

    Returns
    -------
    classes : (n,) uint8
        Bit length of each code's difference from the previous code, the first one's from 0.
    differences : (m,) uint8
        Differences without their leading 1 bit, lowest bit first, packed without gaps.
    """
    deltas = np.diff(codes, prepend=np.uint64(0))
    classes = _bit_length(deltas)
    return classes, bit_fields.pack(deltas, np.maximum(classes, 1) - np.uint8(1))


def _bit_length(values: U64) -> U8:
    """Return the bit length of each value; 0 for 0."""
    length = np.zeros(len(values), np.uint8)
    rest = values.copy()
    for shift in (32, 16, 8, 4, 2, 1):
        large = rest >= (np.uint64(1) << np.uint64(shift))
        length[large] += np.uint8(shift)
        rest[large] >>= np.uint64(shift)
    return length + (values > 0).astype(np.uint8)


def difference_widths(classes: U8, where: str) -> U8:
    """Return the number of packed bits of each Morton difference, given its class.

    The class is the bit length of the difference; its leading 1 bit is not stored.

    Raises
    ------
    FormatError
        ``morton-class``: a class above 51, the bits of a Morton code.
    """
    if int(classes.max(initial=0)) > MORTON_BITS:
        raise FormatError(
            "morton-class",
            f"{where}: class {int(classes.max())}, expected at most {MORTON_BITS}",
            clause="6.5",
        )
    widths: U8 = np.maximum(classes, 1) - np.uint8(1)
    return widths


def unpack_differences(classes: U8, differences: U8, where: str) -> U64:
    """Return the (n,) Morton codes of classes and packed differences, as of `pack_differences`.

    Raises
    ------
    FormatError
        ``morton-class``; ``bits-padding``; ``morton-range``: a code of 2^51 or more.
    """
    widths = difference_widths(classes, where)
    deltas = bit_fields.unpack(differences, widths, where)
    deltas |= np.uint64(1) << widths.astype(np.uint64)
    deltas[classes == 0] = 0
    # The first sum out of range stays below 2^52, so the check finds it; later ones may wrap.
    codes = np.cumsum(deltas, dtype=np.uint64)
    if len(codes) and bool((codes >> np.uint64(MORTON_BITS)).any()):
        raise FormatError(
            "morton-range",
            f"{where}: a Morton code of more than {MORTON_BITS} bits, expected no more",
            clause="6.5",
        )
    return codes


def parse(stream: StoredStream) -> tuple[Grid, StepModel]:
    """Return the grid of the cells and the step model; the number of planes is checked.

    Raises
    ------
    FormatError
        ``stream-params``, ``grid-value``, ``grid-levels``, ``step-model``, ``stream-planes``.
    """
    params = stream.require_params(3 * ENTRY_BYTES + MODEL_BYTES)
    grid = grids.unpack(params[: 3 * ENTRY_BYTES], 3, stream.where, MAX_CELLS)
    model = step_models.unpack(params[3 * ENTRY_BYTES :], stream.where)
    stream.require_planes(3)
    return grid, model


def read(stream: StoredStream, out: F32, inputs: Inputs) -> None:
    """Decode the means of a sorted stream into (rows, 3) float32 `out`.

    Needs `inputs.scales`. If `inputs.refinement` is given, its bits refine the means.

    Raises
    ------
    FormatError
        Codes of `parse`, `unpack_differences` and `refinement_bits.read`;
        ``bits-padding``; ``code-range``: a cell or a refined code beyond the grid.
    ValueError
        The inputs have no scales.
    """
    grid, model = parse(stream)
    classes = stream.plane(0, stream.rows)
    widths = difference_widths(classes, stream.where)
    differences = stream.plane(1, bit_fields.packed_bytes(widths))
    cells = morton.deinterleave(unpack_differences(classes, differences, stream.where))
    top = cells.max(axis=0, initial=0)
    if bool((top >= grid.levels).any()):
        raise FormatError(
            "code-range",
            f"{stream.where}: cells up to {top.tolist()}, expected below {grid.levels.tolist()}",
            clause="6.5",
        )
    extra_bits = model.extra_bits(step_models.require_scales(inputs))
    widths = extra_bits * _THREE
    plane = stream.plane(2, bit_fields.packed_bytes(widths))
    if not len(plane) and inputs.refinement is None:
        # No bits below the cells.
        out[:] = grid.dequantise(cells)
        return
    codes = cells.astype(np.int64)
    if len(plane):
        fields = bit_fields.unpack(plane, widths, stream.where)
        wide = extra_bits.astype(np.uint64)
        mask = (np.uint64(1) << wide) - np.uint64(1)
        for axis in range(3):
            low = (fields >> (wide * np.uint64(axis))) & mask
            codes[:, axis] = (codes[:, axis] << wide.astype(np.int64)) | low.astype(np.int64)
    if inputs.refinement is not None:
        codes, more = refinement_bits.read(inputs.refinement, codes)
        extra_bits = extra_bits + np.uint8(more)
    out[:] = dequantise(codes, grid, extra_bits)
