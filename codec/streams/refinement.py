"""Refinements: what makes the values of a coarse head fine (SPEC 6.16, 6.17)."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError

from . import bit_fields, compiled
from . import grid as grids
from .adaptive_step import KNEES, MAX_COEFFICIENT, MAX_HALVINGS, Resolution
from .grid import ENTRY_BYTES, Grid
from .records import INFINITIES, Attribute, Kind, StoredStream, Stream, read_grid_codes

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]
U32 = NDArray[np.uint32]
U64 = NDArray[np.uint64]
I64 = NDArray[np.int64]

MAX_RADIX: Final = 16
"""Most levels of a fine grid to one of a coarse grid (SPEC 6.16)."""

_CONSTANT: Final = struct.Struct("<f")


def digits(attribute: Attribute, codes: U32, grid: Grid, radices: Sequence[int]) -> Stream:
    """Return a digits stream: what (n, c) codes on a fine grid have below their coarse codes.

    Parameters
    ----------
    attribute : Attribute
    codes : (n, c) uint32
    grid : Grid
        The fine one.
    radices : sequence of int
        For each component 1 to `MAX_RADIX`: ``code // radix`` is its coarse code.
    """
    planes = [
        (codes[:, component] % np.uint32(radix)).astype(np.uint8)
        for component, radix in enumerate(radices)
        if radix > 1
    ]
    return Stream(attribute, Kind.DIGITS, len(codes), grid.pack() + bytes(radices), planes)


def read_digits(
    head: StoredStream, coarse: Grid, finer: StoredStream, out: F32, coarse_out: F32
) -> None:
    """Write the values that a stream on a grid and its digits give together.

    Parameters
    ----------
    head : StoredStream
        Its planes are those of a scalar stream (SPEC 6.4).
    coarse : Grid
        The head's.
    finer : StoredStream
    out : (rows, c) float32
    coarse_out : (rows, c) float32
        For the values of the head alone; with no rows where nobody asks.
    """
    if head.flags & INFINITIES:
        raise FormatError(
            "stream-kind",
            f"{finer.where}: digits for a stream with infinities, expected one without",
            clause="6.16",
        )
    finer.require_kind(Kind.DIGITS)
    count = coarse.components
    params = finer.require_params(count * (ENTRY_BYTES + 1))
    grid = grids.unpack(params[: count * ENTRY_BYTES], count, finer.where)
    radices = list(params[count * ENTRY_BYTES :])
    if min(radices) < 1 or max(radices) > MAX_RADIX:
        raise FormatError(
            "refinement-radix",
            f"{finer.where}: radices {radices}, expected 1 to {MAX_RADIX}",
            clause="6.16",
        )
    finer.require_planes(sum(radix > 1 for radix in radices))
    if compiled.ready() and _compiled_digits(head, coarse, finer, grid, radices, out, coarse_out):
        return
    codes = read_grid_codes(head, coarse)
    if len(coarse_out):
        coarse_out[:] = coarse.dequantise(codes)
    plane = 0
    for component, radix in enumerate(radices):
        column = codes[:, component].astype(np.uint64)
        if radix > 1:
            digit = finer.plane(plane, finer.rows)
            plane += 1
            _require_below(int(digit.max(initial=0)), radix, finer, component)
            column = column * np.uint64(radix) + digit
        _require_below(int(column.max(initial=0)), int(grid.levels[component]), finer, component)
        codes[:, component] = column
    out[:] = grid.dequantise(codes)


def _require_below(found: int, limit: int, finer: StoredStream, component: int) -> None:
    if found >= limit:
        raise FormatError(
            "code-range",
            f"{finer.where}: {found} in component {component}, expected below {limit}",
            clause="6.16",
        )


def _compiled_digits(
    head: StoredStream,
    coarse: Grid,
    finer: StoredStream,
    grid: Grid,
    radices: list[int],
    out: F32,
    coarse_out: F32,
) -> bool:
    from . import kernels

    counts = [grids.code_bytes(levels) for levels in coarse.levels.tolist()]
    head.require_planes(sum(counts))
    count = sum(counts) + sum(radix > 1 for radix in radices)
    planes = head.joined_with(finer, [head.rows] * count)
    return kernels.digit_rows(
        planes,
        (coarse.minimum, coarse.maximum, coarse.levels),
        sum(counts) * head.rows,
        np.array(radices, np.int64),
        (grid.minimum, grid.maximum, grid.levels),
        coarse_out,
        out,
    )


@dataclass(frozen=True, eq=False)
class Finer:
    """A bits stream, which adds halvings to the rows of a stream that has some (SPEC 6.17).

    Parameters
    ----------
    stream : StoredStream
    scales : (rows, 3) float32
        The same rows' scales, refined.
    """

    stream: StoredStream
    scales: F32

    def resolutions(self, coarse: Sequence[Resolution]) -> list[Resolution]:
        """Return the finer resolutions that belong to those of the head."""
        self.stream.require_kind(Kind.BITS)
        params = self.stream.require_params(len(coarse) * _CONSTANT.size)
        constants = [value for (value,) in _CONSTANT.iter_unpack(params)]
        if not all(abs(value) <= MAX_COEFFICIENT for value in constants):
            raise FormatError(
                "resolution-value",
                f"{self.stream.where}: constants {constants}, "
                f"expected magnitudes to {MAX_COEFFICIENT:g}",
                clause="6.17",
            )
        return [with_constant(one, c) for one, c in zip(coarse, constants, strict=True)]

    def extra(self, coarse: Sequence[Resolution], halvings: Sequence[U8]) -> list[U8]:
        """Return how many halvings the rows gain, for each resolution of the head."""
        finer = self.resolutions(coarse)
        return [gained(f, self.scales, h) for f, h in zip(finer, halvings, strict=True)]

    def plane(self, index: int, widths: U8) -> U8:
        """Return a plane of the rows' bits, its padding checked."""
        plane = self.stream.plane(index, bit_fields.packed_bytes(widths))
        bit_fields.require_padding(plane, widths, self.stream.where)
        return plane

    def fields(self, index: int, widths: U8) -> U64:
        """Return the rows' bits in a plane."""
        return bit_fields.unpack(self.plane(index, widths), widths, self.stream.where)

    def refuse(self) -> FormatError:
        """Return what to raise for a code that a row does not have."""
        return FormatError(
            "code-range",
            f"{self.stream.where}: a code beyond what the halvings of its row allow",
            clause="6.17",
        )


def with_constant(resolution: Resolution, constant: float) -> Resolution:
    """Return a resolution with another first coefficient."""
    return replace(resolution, coefficients=(constant, *resolution.coefficients[1:]))


def gained(finer: Resolution, scales: F32, halvings: U8) -> U8:
    """Return how many halvings a finer resolution adds to those that rows have."""
    if compiled.ready():
        from . import kernels

        coefficients = np.array(finer.coefficients, np.float32)
        out = np.empty_like(halvings)
        kernels.gained(scales, coefficients, KNEES, MAX_HALVINGS, halvings, out)
        return out
    wanted = finer.halvings(scales)
    return np.maximum(wanted, halvings) - halvings


def coarse_of(codes: U32, extra: U8) -> tuple[U32, U64]:
    """Split codes at finer halvings into the nearest codes at coarser ones and what is below.

    Parameters
    ----------
    codes : uint32
    extra : uint8
        Halvings between the two, broadcast against the codes.

    Returns
    -------
    coarse : uint32
    fields : uint64
        In `extra` bits.
    """
    wide = codes.astype(np.int64)
    half = half_of(extra)
    shift = extra.astype(np.int64)
    coarse = (wide + half) >> shift
    return coarse.astype(np.uint32), (wide + half - (coarse << shift)).astype(np.uint64)


def half_of(extra: U8) -> I64:
    """Return half of what one coarse level is worth in fine ones, 0 without extra halvings."""
    half: I64 = (np.int64(1) << extra.astype(np.int64)) >> 1
    return half


def bits_stream(
    attribute: Attribute, constants: Sequence[float], planes: Sequence[U8], rows: int
) -> Stream:
    """Return a bits stream of planes as SPEC 6.17 has them."""
    params = b"".join(_CONSTANT.pack(value) for value in constants)
    return Stream(attribute, Kind.BITS, rows, params, planes)
