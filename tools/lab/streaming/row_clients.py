"""What other programs fetch, as clients of the same scene: splats one by one, in orders of theirs.

A splat costs the mean of what the file spends on one. Chunks that could be decoded on their own
would cost more, and the more the smaller they are, so that these clients have it easier than they
would.
"""

from __future__ import annotations

from collections.abc import Sequence
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
from cogsplat.tools.lab.scheduling.chunk_ratios import by_sgss
from cogsplat.tools.lab.scheduling.poses import Pose

from .client import Priorities, Units

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

# Splats that come at once: finer than a chunk, and few enough pieces to choose from.
_PIECE: Final = 256
# SGSS has 300 to 2,000 basic cuboids (Zhu et al., MMSys 2025).
_CUBOIDS: Final = 300
# SGSS fetches a cell of this priority PW before others: P, its decimal logarithm, is 1 or more.
_HIGH: Final = 10.0


@dataclass(frozen=True, eq=False)
class RowClient:
    """A client that fetches pieces of a scene.

    Parameters
    ----------
    units : Units
        The pieces.
    rows : list of (n,) int64
        Rows of the scene that each piece holds.
    wanted : Priorities
    """

    units: Units
    rows: list[I64]
    wanted: Priorities


def by_antimatter(splats: Splats, size_bytes: int, opening_bytes: int) -> RowClient:
    """Return a client that fetches by volume times opacity, as antimatter15/splat sorts.

    Parameters
    ----------
    splats : Splats
    size_bytes : int
        Of all of them.
    opening_bytes : int
        Before the first piece.
    """
    rows = _pieces(baselines.sort_descending(baselines.antimatter(splats)))
    order: F64 = 1.0 / (1.0 + np.arange(len(rows), dtype=np.float64))
    return RowClient(_units(rows, size_bytes, opening_bytes), rows, lambda _: order)


def by_sgss_cells(
    splats: Splats, cameras: Sequence[Camera], size_bytes: int, opening_bytes: int
) -> RowClient:
    """Return SGSS' client: cells of the cheapest cuts, splats by its score, cells by its priority.

    Parameters
    ----------
    splats : Splats
    cameras : sequence of Camera
        That the cells are cut for.
    size_bytes, opening_bytes : int
        As in `by_antimatter`.

    Notes
    -----
    Cells of high priority come together, each by the share of it that is there, before those of
    low priority, and those that are outside the frustum last. The cells are the cheapest that
    straight cuts make; the integer program's are at most a fraction of a percent cheaper.
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
    priorities = by_sgss(extents, np.bincount(cells, minlength=len(boxes)).astype(np.float64))

    def wanted(camera: Camera) -> F64:
        weight = priorities(Pose.of_camera(camera))
        rank = np.where(weight > 0.0, np.where(weight >= _HIGH, 2.0, 1.0), 0.0)
        result: F64 = rank[owner] - part + 1.0
        return result

    return RowClient(_units(rows, size_bytes, opening_bytes), rows, wanted)


def _pieces(rows: I64) -> list[I64]:
    return [rows[start : start + _PIECE] for start in range(0, len(rows), _PIECE)]


def _units(rows: Sequence[I64], size_bytes: int, opening_bytes: int) -> Units:
    counts = np.cumsum([0, *(len(piece) for piece in rows)])
    ends = np.rint(counts * (size_bytes / max(int(counts[-1]), 1))).astype(np.int64)
    sizes = np.array([after - before for before, after in pairwise(ends.tolist())], np.int64)
    return Units(
        kind=np.full(len(rows), int(SegmentKind.HEAD), np.int64),
        chunk=np.arange(len(rows), dtype=np.int64),
        end=opening_bytes + ends[1:],
        size_bytes=sizes,
        after=[()] * len(rows),
        opening_bytes=opening_bytes,
    )


def _cells(grid: BasicCuboids, boxes: Sequence[Box], means: F64) -> I64:
    """Return the box that each splat lies in."""
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
