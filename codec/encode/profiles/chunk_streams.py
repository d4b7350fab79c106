"""Means with one step, and the order within a chunk, which all profiles share."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.streams import grid as grids
from cogsplat.codec.streams import scalar, sorted_means
from cogsplat.codec.streams.adaptive_step import StepModel
from cogsplat.codec.streams.records import Attribute, Stream

F32 = NDArray[np.float32]


def chunk_means(means: F32, step: float, sort: bool) -> tuple[NDArray[np.int64], Stream, F32]:
    """Quantise the means of a chunk with one step, in Morton order.

    Parameters
    ----------
    means : (n, 3) float32
        Means of the chunk, scene units.
    step : float
        Largest quantiser step, scene units.
    sort : bool
        Sort by Morton code and store differences; otherwise keep the order.

    Returns
    -------
    rows : (n,) int64
        Order of the chunk's rows.
    stream : Stream
        Coded means.
    decoded : (n, 3) float32
        Decoded means.
    """
    grid = grids.fit(means, step)
    if not sort:
        rows = np.arange(len(means), dtype=np.int64)
        decoded = grid.dequantise(grid.quantise(means))
        return rows, scalar.write(Attribute.MEANS, means, grid), decoded
    cells, bits = sorted_means.cell_grid(grid)
    extra = np.full(len(means), bits, np.uint8)
    codes = sorted_means.quantise(means, cells, extra)
    rows = sorted_means.morton_order(codes, extra)
    stream = sorted_means.write(codes[rows], cells, extra, StepModel.constant(bits))
    return rows, stream, sorted_means.dequantise(codes[rows], cells, extra)
