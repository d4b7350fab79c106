"""Means on a Morton-sorted grid, each as much finer as its splat is small (SPEC 6.15)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError
from cogsplat.codec.geometry import morton

from . import adaptive_step as resolutions
from . import bit_fields, compiled, refinement, sorted_means
from . import grid as grids
from .adaptive_step import MAX_HALVINGS, RESOLUTION_BYTES, Resolution
from .grid import ENTRY_BYTES, Grid
from .records import Attribute, Kind, StoredStream, Stream
from .refinement import Finer

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]
U8 = NDArray[np.uint8]
U32 = NDArray[np.uint32]
U64 = NDArray[np.uint64]

_THREE: Final = np.uint8(3)

# Powers of two: the product with the step is exact.
_SCALES: Final = np.ldexp(np.float32(1), -np.arange(MAX_HALVINGS + 1)).astype(np.float32)


def fine_codes(means: F32, grid: Grid, halvings: U8) -> U32:
    """Return the (n, 3) codes of means on each row's own halving of a grid."""
    minimum = grid.minimum.astype(np.float64)
    step = np.ldexp(grid.step.astype(np.float64), -halvings.astype(np.int32)[:, None])
    codes = np.rint((means.astype(np.float64) - minimum) / np.where(step > 0, step, 1))
    top = np.ldexp(grid.levels.astype(np.float64), halvings.astype(np.int32)[:, None]) - 1
    out: U32 = np.clip(codes, 0, top).astype(np.uint32)
    return out


def values(codes: U32, grid: Grid, halvings: U8) -> F32:
    """Return the (n, 3) means of codes on each row's own halving of a grid."""
    out: F32 = codes.astype(np.float32) * (_SCALES[halvings][:, None] * grid.step) + grid.minimum
    return out


def morton_order(codes: U32, halvings: U8) -> I64:
    """Return the rows sorted by the Morton code of their coarse cells, ties as they were."""
    keys = morton.interleave(codes >> halvings[:, None])
    return np.argsort(keys, kind="stable").astype(np.int64)


def refine(codes: U32, extra: U8, constant: float) -> tuple[U32, Stream]:
    """Return the codes that a head stores and what refines them.

    Parameters
    ----------
    codes : (n, 3) uint32
        At all halvings.
    extra : (n,) uint8
        Those of them that are the refinement's.
    constant : float
        First coefficient of the finer resolution.
    """
    fields = np.zeros(len(codes), np.uint64)
    coarse = np.empty_like(codes)
    for axis in range(3):
        coarse[:, axis], field = refinement.coarse_of(codes[:, axis], extra)
        fields |= field << (extra.astype(np.uint64) * np.uint64(axis))
    plane = bit_fields.pack(fields, extra * _THREE)
    return coarse, refinement.bits_stream(Attribute.MEANS, [constant], [plane], len(codes))


def fine_means(codes: U32, grid: Grid, halvings: U8, resolution: Resolution) -> Stream:
    """Return a fine stream of means in `morton_order`."""
    classes, deltas = sorted_means.pack_deltas(morton.interleave(codes >> halvings[:, None]))
    rest = bit_fields.pack(_fields(codes, halvings), halvings * _THREE)
    params = grid.pack() + resolution.pack()
    return Stream(Attribute.MEANS, Kind.FINE, len(codes), params, [classes, deltas, rest])


def _fields(codes: U32, halvings: U8) -> U64:
    wide = halvings.astype(np.uint64)
    low = codes.astype(np.uint64) & ((np.uint64(1) << wide) - np.uint64(1))[:, None]
    fields: U64 = low[:, 0] | (low[:, 1] << wide) | (low[:, 2] << (wide + wide))
    return fields


def read_fine_means(
    stream: StoredStream, scales: F32, out: F32, finer: Finer | None = None
) -> None:
    """Write the values of a fine stream of means into (rows, 3) float32 `out`.

    Parameters
    ----------
    stream : StoredStream
    scales : (rows, 3) float32
        The same rows' scales, as the head alone has them.
    out : (rows, 3) float32
    finer : Finer, optional
        What refines them (SPEC 6.17).
    """
    stream.require_kind(Kind.FINE)
    params = stream.require_params(3 * ENTRY_BYTES + RESOLUTION_BYTES)
    grid = grids.unpack(params[: 3 * ENTRY_BYTES], 3, stream.where, morton.MAX_LEVELS)
    resolution = resolutions.unpack(params[3 * ENTRY_BYTES :], stream.where)
    if len(stream.words) != 3:
        raise FormatError(
            "stream-planes", f"{stream.where}: {len(stream.words)} planes, expected 3",
            clause="6.15",
        )  # fmt: skip
    classes = stream.plane(0, stream.rows)
    if compiled.ready() and _compiled_means(
        stream, classes, scales, (grid, resolution), finer, out
    ):
        return
    halvings = resolution.halvings(scales)
    deltas = stream.plane(1, sorted_means.bits_length(classes, stream.where))
    coarse = morton.deinterleave(sorted_means.unpack_deltas(classes, deltas, stream.where))
    top = coarse.max(axis=0, initial=0)
    if bool((top >= grid.levels).any()):
        raise FormatError(
            "code-range",
            f"{stream.where}: codes up to {top.tolist()}, expected below {grid.levels.tolist()}",
            clause="6.15",
        )
    widths = halvings * _THREE
    fields = bit_fields.unpack(
        stream.plane(2, bit_fields.packed_bytes(widths)), widths, stream.where
    )
    extra = np.zeros_like(halvings)
    if finer is not None:
        (extra,) = finer.extra([resolution], [halvings])
    below = np.zeros(stream.rows, np.uint64)
    if finer is not None:
        finer.stream.require_planes(1)
        below = finer.fields(0, extra * _THREE)
    wide, more = halvings.astype(np.uint64), extra.astype(np.uint64)
    half = refinement.half_of(extra)
    scale = _SCALES[halvings + extra]
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


def _compiled_means(
    stream: StoredStream,
    classes: U8,
    scales: F32,
    given: tuple[Grid, Resolution],
    finer: Finer | None,
    out: F32,
) -> bool:
    from . import kernels

    grid, resolution = given
    coefficients = np.array(resolution.coefficients, np.float32)
    halvings = np.empty(stream.rows, np.uint8)
    bits_of_deltas, bits_of_fields = kernels.fine_plan(
        classes, scales, coefficients, resolutions.KNEES, MAX_HALVINGS, halvings
    )
    if bits_of_deltas < 0:
        return False
    deltas = stream.plane(1, bits_of_deltas + 7 >> 3)
    fields = stream.plane(2, bits_of_fields + 7 >> 3)
    cells = sorted_means.Cells(grid.levels, _SCALES[:, None] * grid.step, grid.minimum)
    used = (bits_of_deltas, bits_of_fields)
    if finer is None:
        return sorted_means.read_compiled(classes, deltas, halvings, fields, used, cells, out)
    (extra,) = finer.extra([resolution], [halvings])
    finer.stream.require_planes(1)
    below = finer.plane(0, extra * _THREE)
    return sorted_means.read_compiled(
        classes, deltas, halvings, fields, used, cells, out, (extra, below)
    )
