"""Clients that fetch single splats in the order of antimatter15/splat or SGSS.

Each splat costs the file's mean bytes per splat. That favours these clients: chunks that can be
decoded independently would cost more per splat.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.order import baselines
from cogsplat.codec.splats import Splats
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.tools.lab.partitions.basic_cuboids import BasicCuboids, basic_cuboids
from cogsplat.tools.lab.partitions.box_costs import Box, box_costs
from cogsplat.tools.lab.partitions.guillotine import cut_costs
from cogsplat.tools.lab.scheduling.chunk_ratios import sgss_priorities
from cogsplat.tools.lab.scheduling.poses import Pose

from .client import Priorities, Units

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

# Splats per request: finer than a chunk, and few enough pieces to sort.
_PIECE_SPLATS: Final = 256
# SGSS uses 300 to 2,000 basic cuboids (Zhu et al., MMSys 2025).
_CUBOIDS: Final = 300
# Cells of at least this priority PW are fetched first: SGSS requires log10(PW) of 1 or more.
_HIGH_PRIORITY: Final = 10.0


@dataclass(frozen=True, eq=False)
class RowClient:
    """Client that fetches fixed groups of splats, called pieces.

    Parameters
    ----------
    units : Units
        One unit per piece.
    rows : list of (n,) int64
        Rows of the scene in each piece.
    priorities : Priorities
        Urgency of each piece at a pose.
    """

    units: Units
    rows: list[I64]
    priorities: Priorities


def antimatter_client(splats: Splats, size_bytes: int, index_bytes: int) -> RowClient:
    """Return a client that fetches by volume times opacity, the order of antimatter15/splat.

    Parameters
    ----------
    splats : Splats
    size_bytes : int
        Total size of the splats.
    index_bytes : int
        Bytes fetched before the first piece.
    """
    rows = _pieces(baselines.sort_descending(baselines.antimatter(splats)))
    order: F64 = 1.0 / (1.0 + np.arange(len(rows), dtype=np.float64))

    def priorities(_: Camera, __: Collection[int] = ()) -> F64:
        return order

    return RowClient(_units(rows, size_bytes, index_bytes), rows, priorities)


def sgss_client(
    splats: Splats, cameras: Sequence[Camera], size_bytes: int, index_bytes: int
) -> RowClient:
    """Return a client with the cells, splat scores and cell priorities of SGSS.

    Parameters
    ----------
    splats : Splats
    cameras : sequence of Camera
        Views that the partition into cells is optimised for.
    size_bytes : int
        Total size of the splats.
    index_bytes : int
        Bytes fetched before the first piece.

    Notes
    -----
    Cells of high priority are fetched in parallel, then those of low priority, then those outside
    the frustum. The cells are the cheapest guillotine partition; the integer program of SGSS is
    cheaper by less than one percent.
    """
    grid = basic_cuboids(splats.means.astype(np.float64), cameras, _CUBOIDS)
    boxes = cut_costs(box_costs(grid)).partition()
    cells = _cells(grid, boxes, splats.means.astype(np.float64))
    order = baselines.sort_descending(baselines.sgss(splats))
    rows: list[I64] = []
    cell_of: list[int] = []
    part_of: list[float] = []
    for cell in range(len(boxes)):
        pieces = _pieces(order[cells[order] == cell])
        rows += pieces
        cell_of += [cell] * len(pieces)
        part_of += [piece / len(pieces) for piece in range(len(pieces))]
    owner, part = np.array(cell_of, np.int64), np.array(part_of)
    extents = _extents(grid, boxes)
    cell_priorities = sgss_priorities(
        extents, np.bincount(cells, minlength=len(boxes)).astype(np.float64)
    )

    def priorities(camera: Camera, _: Collection[int] = ()) -> F64:
        weight = cell_priorities(Pose.from_camera(camera))
        rank = np.where(weight > 0.0, np.where(weight >= _HIGH_PRIORITY, 2.0, 1.0), 0.0)
        result: F64 = rank[owner] - part + 1.0
        return result

    return RowClient(_units(rows, size_bytes, index_bytes), rows, priorities)


def _pieces(rows: I64) -> list[I64]:
    """Split rows into pieces of `_PIECE_SPLATS`."""
    return [rows[start : start + _PIECE_SPLATS] for start in range(0, len(rows), _PIECE_SPLATS)]


def _units(rows: Sequence[I64], size_bytes: int, index_bytes: int) -> Units:
    """Return one unit per piece, sized by its splats."""
    counts = np.cumsum([0, *(len(piece) for piece in rows)])
    ends = np.rint(counts * (size_bytes / max(int(counts[-1]), 1))).astype(np.int64)
    sizes = np.array([end - start for start, end in pairwise(ends.tolist())], np.int64)
    return Units(
        kind=np.full(len(rows), int(SegmentKind.HEAD), np.int64),
        row=np.arange(len(rows), dtype=np.int64),
        end=index_bytes + ends[1:],
        size_bytes=sizes,
        dependencies=[()] * len(rows),
        index_bytes=index_bytes,
    )


def _cells(grid: BasicCuboids, boxes: Sequence[Box], means: F64) -> I64:
    """Return the index of the box that contains each splat."""
    owner = np.zeros(grid.splats.shape, np.int64)
    for number, (a, b, c, d, e, f) in enumerate(boxes):
        owner[a:d, b:e, c:f] = number
    place = [
        np.searchsorted(grid.edges[axis][1:-1], means[:, axis], side="right") for axis in range(3)
    ]
    return owner[place[0], place[1], place[2]]


def _extents(grid: BasicCuboids, boxes: Sequence[Box]) -> F64:
    """Return the corners of boxes in scene units, (b, 6)."""
    return np.array(
        [
            [grid.edges[axis][box[axis + end]] for end in (0, 3) for axis in range(3)]
            for box in boxes
        ]
    )
