"""Basis streams of sh0: coordinates on three colour axes of the chunk's own (SPEC 6.13)."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError

from . import grid as grids
from . import grid_planes, refinement_digits
from .grid import ENTRY_BYTES, Grid
from .records import Attribute, Kind, StoredStream, Stream
from .stream_inputs import Inputs

F32 = NDArray[np.float32]

_AXES_BYTES: Final = 36


def write(coordinates: F32, axes: F32, grid: Grid) -> Stream:
    """Return a stream of sh0, stored as coordinates on three colour axes.

    Parameters
    ----------
    coordinates : (n, 3) float32
        Coordinates of sh0 on the axes.
    axes : (3, 3) float32
        Colour axes: row j is the direction of axis j in R G B; magnitudes at most 1.
    grid : Grid
        Grid of the coordinates.
    """
    planes = grid_planes.split_components(grid.quantise(coordinates), grid)
    params = grid.pack() + axes.astype("<f4").tobytes()
    return Stream(Attribute.SH0, Kind.BASIS, len(coordinates), params, planes)


def parse(stream: StoredStream) -> tuple[Grid, F32]:
    """Return the grid of the coordinates and the (3, 3) float32 axes.

    Raises
    ------
    FormatError
        ``stream-params``, ``grid-value``, ``grid-levels``; ``basis-value``: an axis beyond ±1.
    """
    params = stream.require_params(3 * ENTRY_BYTES + _AXES_BYTES)
    grid = grids.unpack(params[: 3 * ENTRY_BYTES], 3, stream.where)
    axes = np.frombuffer(params[3 * ENTRY_BYTES :], "<f4").reshape(3, 3).astype(np.float32)
    if not bool((np.abs(axes) <= 1).all()):
        raise FormatError(
            "basis-value",
            f"{stream.where}: axes {axes.tolist()}, expected values within ±1",
            clause="6.13",
        )
    return grid, axes


def read(stream: StoredStream, out: F32, inputs: Inputs) -> None:
    """Decode sh0 from coordinates on the stream's colour axes, into (rows, 3) float32 `out`.

    If `inputs.refinement` is given, its digits stream makes the coordinates finer.

    Raises
    ------
    FormatError
        Codes of `parse`; ``stream-planes``; ``code-range``.
    """
    grid, axes = parse(stream)
    coordinates = np.empty((stream.rows, 3), np.float32)
    if inputs.refinement is None:
        grid_planes.read_values(stream, grid, coordinates)
    else:
        refinement_digits.read(stream, grid, inputs.refinement, coordinates)
    for channel in range(3):
        a, b, c = axes[:, channel]
        x, y, z = coordinates.T
        out[:, channel] = (x * a + y * b) + z * c
