"""Opacities of a later level as differences from the logits of the head (SPEC 6.12, 7.5)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from . import grid_planes, scalar
from .grid import Grid
from .records import Attribute, Kind, StoredStream, Stream
from .stream_inputs import Inputs

F32 = NDArray[np.float32]


def write(differences: F32, grid: Grid) -> Stream:
    """Return a stream of the opacities of one LapisGS level, as differences from the head.

    Parameters
    ----------
    differences : (n, 1) float32
        Logits of the splats in the level, minus the logits that the chunk's head stores.
    grid : Grid
        Grid of one component for the differences.
    """
    planes = grid_planes.split_components(grid.quantise(differences), grid)
    return Stream(Attribute.OPACITIES, Kind.DIFFERENCES, len(differences), grid.pack(), planes)


def read(stream: StoredStream, out: F32, inputs: Inputs) -> None:
    """Add a stream of differences to (rows, 1) float32 `out`, which holds the logits of the head.

    Raises
    ------
    FormatError
        See `scalar.read`.
    """
    grid = scalar.parse(stream, 1)
    differences = np.empty((stream.rows, 1), np.float32)
    grid_planes.read_values(stream, grid, differences)
    out += differences
