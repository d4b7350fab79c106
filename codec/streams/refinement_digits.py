"""Digits streams: low digits that refine codes of a coarse grid to a fine grid (SPEC 6.16)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError

from . import grid as grids
from . import grid_planes
from .grid import ENTRY_BYTES, Grid
from .records import Attribute, Kind, StoredStream, Stream

F32 = NDArray[np.float32]
U32 = NDArray[np.uint32]

MAX_RADIX: Final = 16
"""Maximum number of fine levels per coarse level (SPEC 6.16)."""


def write(attribute: Attribute, codes: U32, grid: Grid, radices: Sequence[int]) -> Stream:
    """Return a digits stream.

    Parameters
    ----------
    attribute : Attribute
        Attribute that is refined.
    codes : (n, c) uint32
        Codes on the fine grid.
    grid : Grid
        Fine grid.
    radices : sequence of int
        Radix of each component, 1 to `MAX_RADIX`: ``code // radix`` is the coarse code.
    """
    planes = [
        (codes[:, component] % np.uint32(radix)).astype(np.uint8)
        for component, radix in enumerate(radices)
        if radix > 1
    ]
    return Stream(attribute, Kind.DIGITS, len(codes), grid.pack() + bytes(radices), planes)


def parse(digits: StoredStream, components: int) -> tuple[Grid, list[int]]:
    """Return the fine grid and the radices of a digits stream.

    Raises
    ------
    FormatError
        ``stream-params``, ``grid-value``, ``grid-levels``, ``refinement-radix``,
        ``stream-planes``.
    """
    params = digits.require_params(components * (ENTRY_BYTES + 1))
    grid = grids.unpack(params[: components * ENTRY_BYTES], components, digits.where)
    radices = list(params[components * ENTRY_BYTES :])
    if min(radices) < 1 or max(radices) > MAX_RADIX:
        raise FormatError(
            "refinement-radix",
            f"{digits.where}: radices {radices}, expected 1 to {MAX_RADIX}",
            clause="6.16",
        )
    digits.require_planes(sum(radix > 1 for radix in radices))
    return grid, radices


def read(
    head: StoredStream, coarse: Grid, digits: StoredStream, out: F32, coarse_out: F32 | None = None
) -> None:
    """Decode the values of a stream on a grid, refined by a digits stream, into `out`.

    Parameters
    ----------
    head : StoredStream
        Stream of the head, with the planes of a scalar stream (SPEC 6.4).
    coarse : Grid
        Grid of the head.
    digits : StoredStream
        Digits stream of the refinement.
    out : (rows, c) float32
        Refined values.
    coarse_out : (rows, c) float32, optional
        Receives the values without refinement.

    Raises
    ------
    FormatError
        Codes of `parse`; ``code-range``: a code of the head, a digit or a fine code is out of
        range.
    """
    codes = grid_planes.read_codes(head, coarse)
    grid, radices = parse(digits, coarse.components)
    if coarse_out is not None:
        coarse_out[:] = coarse.dequantise(codes)
    plane = 0
    for component, radix in enumerate(radices):
        where = f"{digits.where}, component {component}"
        column = codes[:, component].astype(np.uint64)
        if radix > 1:
            digit = digits.plane(plane, digits.rows)
            plane += 1
            grid_planes.require_codes(digit, radix, where, "6.16")
            column = column * np.uint64(radix) + digit
        grid_planes.require_codes(column, int(grid.levels[component]), where, "6.16")
        codes[:, component] = column
    out[:] = grid.dequantise(codes)
