"""What all profiles store the same way in a chunk: means, opacities, and the order inside."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.geometry import morton
from cogsplat.codec.streams import grid as grids
from cogsplat.codec.streams import scalar, sorted_means
from cogsplat.codec.streams.grid import Grid
from cogsplat.codec.streams.records import Attribute, Stream

F32 = NDArray[np.float32]

MAX_LOGIT: Final = 12.0
"""Opacities beyond ± this are stored as this: σ(12) differs from 1 by 6e-6, far below 1/255."""


def chunk_means(means: F32, step: float, sort: bool) -> tuple[NDArray[np.int64], Stream]:
    """Return the order inside a chunk and its means in that order.

    Parameters
    ----------
    means : (n, 3) float32
        Scene units.
    step : float
        Largest distance between levels.
    sort : bool
        Whether to sort by Morton code and store the differences.

    Returns
    -------
    rows : (n,) int64
        Permutation of the chunk's rows.
    stream : Stream
    """
    grid = _cap(grids.fit(means, step))
    codes = grid.quantise(means)
    if not sort:
        rows = np.arange(len(means), dtype=np.int64)
        return rows, scalar.write(Attribute.MEANS, means, grid)
    keys = morton.interleave(codes)
    rows = np.argsort(keys, kind="stable").astype(np.int64)
    return rows, sorted_means.write_cells(codes[rows], grid)


def _cap(grid: Grid) -> Grid:
    levels = np.minimum(grid.levels, np.uint32(morton.MAX_LEVELS))
    return Grid(grid.minimum, grid.maximum, levels)


def chunk_opacities(opacities: F32, step: float) -> Stream:
    """Return the opacities of a chunk, clipped to ±`MAX_LOGIT`."""
    values = np.clip(opacities, -MAX_LOGIT, MAX_LOGIT)[:, None]
    return scalar.write(Attribute.OPACITIES, values, grids.fit(values, step))
