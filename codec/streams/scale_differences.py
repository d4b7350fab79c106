"""Differences streams: log scales from the longest axis to the shortest (SPEC 6.12)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from . import grid_planes, refinement_digits, scalar
from .grid import Grid
from .records import Attribute, Kind, StoredStream, Stream
from .stream_inputs import Inputs

F32 = NDArray[np.float32]


def differences_of(scales: F32) -> F32:
    """Return (n, 3) differences of (n, 3) log scales in the order middle, thin, long.

    The components are long, long minus middle, and middle minus thin.
    """
    middle, thin, long = scales.T
    return np.stack([long, long - middle, middle - thin], axis=1)


def scales_of(differences: F32) -> F32:
    """Return the (n, 3) log scales, middle, thin, long, of decoded differences (SPEC 6.12)."""
    out = np.empty_like(differences)
    out[:, 2] = differences[:, 0]
    out[:, 0] = differences[:, 0] - differences[:, 1]
    out[:, 1] = out[:, 0] - differences[:, 2]
    return out


def write(differences: F32, grid: Grid) -> Stream:
    """Return a differences stream of scales.

    Parameters
    ----------
    differences : (n, 3) float32
        Differences from `differences_of`.
    grid : Grid
        Grid of the three differences.
    """
    planes = grid_planes.split_components(grid.quantise(differences), grid)
    return Stream(Attribute.SCALES, Kind.DIFFERENCES, len(differences), grid.pack(), planes)


def read(stream: StoredStream, out: F32, inputs: Inputs) -> None:
    """Decode the log scales of a differences stream into (rows, 3) float32 `out`.

    If `inputs.refinement` is given, `out` receives the refined scales, and the array
    `inputs.coarse` the scales without refinement.

    Raises
    ------
    FormatError
        See `scalar.read`.
    """
    grid = scalar.parse(stream, 3)
    differences = np.empty((stream.rows, 3), np.float32)
    if inputs.refinement is None:
        grid_planes.read_values(stream, grid, differences)
    else:
        alone = None if inputs.coarse is None else np.empty_like(differences)
        refinement_digits.read(stream, grid, inputs.refinement, differences, alone)
        if inputs.coarse is not None and alone is not None:
            inputs.coarse[:] = scales_of(alone)
    out[:] = scales_of(differences)
