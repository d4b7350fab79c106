"""Scalar streams: values on one uniform grid per component (SPEC 6.4)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from . import grid as grids
from . import grid_planes, refinement_digits
from .grid import ENTRY_BYTES, Grid
from .records import ESCAPE, INFINITIES, Attribute, Kind, StoredStream, Stream
from .stream_inputs import Inputs

F32 = NDArray[np.float32]


def write(attribute: Attribute, values: F32, grid: Grid, *, escape: bool = False) -> Stream:
    """Quantise values on a grid; return a scalar stream.

    Parameters
    ----------
    attribute : Attribute
        Attribute of the values.
    values : (n, c) float32
        Finite values; values beyond the grid become its first or last level.
    grid : Grid
        Grid of c components.
    escape : bool
        Whether the rows are escape rows: rows stored in full, outside a codebook.
    """
    planes = grid_planes.split_components(grid.quantise(values), grid)
    flags = ESCAPE if escape else 0
    return Stream(attribute, Kind.SCALAR, len(values), grid.pack(), planes, flags)


def write_with_infinities(attribute: Attribute, values: F32, grid: Grid) -> Stream:
    """Return a scalar stream of (n, 1) float32 values that may be infinite.

    The grid has one component and at most `grid.MAX_LEVELS` - 2 levels: two more codes mean +inf
    and -inf.
    """
    finite = np.isfinite(values)
    codes = grid.quantise(np.where(finite, values, grid.minimum))[:, 0]
    levels = int(grid.levels[0])
    codes[np.isposinf(values[:, 0])] = levels
    codes[np.isneginf(values[:, 0])] = levels + 1
    planes = grid_planes.split_planes(codes, levels + 2)
    return Stream(attribute, Kind.SCALAR, len(values), grid.pack(), planes, INFINITIES)


def parse(stream: StoredStream, components: int) -> Grid:
    """Return the grid of a scalar stream, read from its parameters.

    Raises
    ------
    FormatError
        ``stream-params``, ``grid-value``, ``grid-levels``.
    """
    params = stream.require_params(components * ENTRY_BYTES)
    return grids.unpack(params, components, stream.where, grids.MAX_LEVELS - infinity_codes(stream))


def infinity_codes(stream: StoredStream) -> int:
    """Return the number of codes above the grid's levels that stand for infinities, 0 or 2."""
    return 2 if stream.flags & INFINITIES else 0


def read(stream: StoredStream, out: F32, inputs: Inputs) -> None:
    """Decode the values of a scalar stream into (rows, c) float32 `out`.

    If `inputs.refinement` is given, `out` receives the refined values, and the array
    `inputs.coarse` the values without refinement.

    Raises
    ------
    FormatError
        Codes of `parse`; ``stream-planes``; ``code-range``.
    """
    grid = parse(stream, out.shape[1])
    if inputs.refinement is None:
        grid_planes.read_values(stream, grid, out, extra=infinity_codes(stream))
    else:
        refinement_digits.read(stream, grid, inputs.refinement, out, inputs.coarse)
