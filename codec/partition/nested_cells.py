"""Nested cells: an order cut into layers, and each layer into chunks of one box each.

The first layer is one chunk of the whole scene. Each further layer has more splats. Its cells are
those of the layer before, halved if they hold too many splats. A client can thus fetch a coarse
version of the whole scene, and details of visible cells only (as in COPC's octree of points).
The scene is first split into regions: its surroundings, such as the sky, which would make the box
of any cell endless, and those that views tell apart, such as rooms. Each has layers of its own: a
view in one room fetches few coarse splats of the others.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.finite_fields import require_finite

from .chunk_tree import chunk_tree

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

DEFAULT_CELL_SPLATS: Final = 8192
"""Default of the largest number of splats in a chunk: a trade of bytes for selectivity."""
# Growth of the bytes of heads, refinements, tails and codebooks relative to chunks without cells,
# at a nominal 40 dB; PSNR in held-out views, dB, of the whole scene and of the first 35, 50 and
# 70 % of the splats, uncompensated:
#                                       captured room              house of 6 rooms
#   not cut                               39.77 27.6 31.5 35.0         30.20 20.5 23.1 25.6
#   most 16,384, layers grow by 1.5 +0.5% 39.79 27.6 31.6 34.7   +1.4% 30.29 20.9 23.2 25.5
#   most 8,192, layers grow by 1.5  +1.5% 39.77 27.9 31.2 34.8   +2.8% 30.31 20.8 22.7 24.9
#   most 4,096, layers grow by 1.5                               +5.7% 30.29 20.8 22.9 24.8
#   most 8,192, layers grow by 2    +5.9% 39.74 27.2 30.9 32.4
# If layers double, the splats of a chunk are too different for common steps, and half of the
# picture is coarse while the last layer arrives. Layers of at most a sixth of the splats were tried
# in the room: 0.5 % fewer bytes at equal PSNR, and 0.3 dB more in 384 KiB. A client that fetches by
# the views nearest to its pose then has 0.9 dB less at half of the bytes (and 0.3 dB more at 70 %),
# because fewer chunks of the middle layers are cut.

WHOLE: Final = 1
"""Number of the cell of the whole scene; the halves of cell c are 2c and 2c + 1 (SPEC 5.4)."""

# Largest cell number whose halves have numbers of 32 bits, as the chunk table requires.
_MAX_HALVED: Final = (1 << 31) - 1
# A region that is split has a coarse chunk if it holds at most a quarter of the splats of the
# smallest region around it with such a chunk: about one for each room. Without these chunks, the
# first 64 KiB of a house of six rooms show 8 dB in place of 12 dB.
_COARSENING: Final = 4
# Share of the splats ignored at each end of an axis when a cell's length is measured: distant
# floaters would make it cut across the wrong axis.
_OUTLIERS: Final = 0.02
# Share of the splats ignored at each end of an axis when surroundings are looked for, and their
# distance from the box of the others, as a share of its longest side. Chosen, not measured: of a
# city of a million, 8 % are land and sky around it, up to six sides away.
_FAR_OUT: Final = 0.1
_SURROUNDING: Final = 1.0


@dataclass(frozen=True, eq=False)
class Region:
    """Node of the binary tree of regions: a region is split by a plane, or by a box.

    Parameters
    ----------
    axis : int
        Axis that the plane is perpendicular to.
    plane : float
        Coordinate of the plane, scene units; lower coordinates belong to the first half.
    halves : tuple of Region, optional
        Regions on both sides, or inside and outside; None for a region that is not split.
    box : tuple of six float, optional
        Minimum, then maximum corner, scene units; in place of the plane.
    """

    axis: int = 0
    plane: float = 0.0
    halves: tuple[Region, Region] | None = None
    box: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        require_finite(self)

    @property
    def is_told_apart(self) -> bool:
        """Whether views tell parts of it apart: a plane splits this region or one inside it.

        A box does not count: it separates surroundings, whatever views see.
        """
        if self.halves is None:
            return False
        return self.box is None or any(half.is_told_apart for half in self.halves)

    def in_second_half(self, means: NDArray[np.floating], places: I64) -> NDArray[np.bool_]:
        """Return a mask, (p,) bool, of the rows `places` of (n, 3) means beyond plane or box.

        A mean with a NaN where it is compared is in the first half.
        """
        if self.box is None:
            return means[:, self.axis].take(places) >= self.plane
        is_outside = np.zeros(len(places), np.bool_)
        for axis, (low, high) in enumerate(zip(self.box[:3], self.box[3:], strict=True)):
            column = means[:, axis].take(places)
            is_outside |= (column < low) | (column > high)
        return is_outside


WHOLE_SCENE: Final = Region()
"""Region of a scene that views do not tell apart."""


@dataclass(frozen=True, eq=False)
class NestedCells:
    """Order cut into chunks by layers and cells.

    Parameters
    ----------
    order : (n,) int64
        Positions in the original order, chunk by chunk, ascending within a chunk.
    slices : list of slice
        Consecutive ranges of `order`, one per chunk.
    layers : (c,) int64
        Layer of each chunk; ascending in an index of the file (`chunk_tree`).
    cells : (c,) int64
        Number of each chunk's cell.
    """

    order: I64
    slices: list[slice]
    layers: I64
    cells: I64


def parents(cells: NDArray[np.integer], subtrees: Sequence[tuple[int, int]] = ()) -> I64:
    """Return each chunk's parent: the chunk that it adds detail to (SPEC 5.4).

    Parameters
    ----------
    cells : (c,) integer
        Cell number of each chunk, in the order of the chunks; 0 if chunks are not cut by cell.
    subtrees : sequence of (int, int)
        First and end number of the chunks below each page of the index, ascending by the first and
        then outer before inner. They are no parents of chunks behind.

    Returns
    -------
    (c,) int64
        Number of the parent chunk; -1 for a chunk without parent.

    Examples
    --------
    >>> from cogsplat.codec.partition.nested_cells import parents
    >>> parents(np.array([1, 1, 3, 2, 5])).tolist()
    [-1, 0, 1, 1, 3]

    Chunk 4 is below another page than its cell's chunk 3.

    >>> parents(np.array([1, 1, 3, 2, 2]), [(2, 4), (4, 5)]).tolist()
    [-1, 0, 1, 1, 1]
    """
    last: dict[int, int] = {}
    found = []
    # Ends of the subtrees around the chunk, each with the last chunks before it.
    outer: list[tuple[int, dict[int, int]]] = []
    coming = deque(each for each in subtrees if each[0] < each[1])
    for chunk, cell in enumerate(cells.tolist()):
        while outer and outer[-1][0] <= chunk:
            last = outer.pop()[1]
        while coming and coming[0][0] <= chunk:
            outer.append((coming.popleft()[1], dict(last)))
        around = (cell >> k for k in range(cell.bit_length()))
        found.append(max((last.get(above, -1) for above in around), default=-1))
        last[cell] = chunk
    return np.array(found, np.int64)


@dataclass(eq=False)
class _Cell:
    """Node of the binary tree of cells: a halved cell has a plane, a leaf has pending splats.

    `pending` holds positions of splats that are not in a chunk yet; `last_chunk` is the number of
    the leaf's latest chunk, or -1.
    """

    number: int
    pending: list[I64] = field(default_factory=list)
    last_chunk: int = -1
    axis: int = -1
    plane: float = 0.0
    halves: tuple[_Cell, _Cell] | None = None


@dataclass(eq=False)
class _Chunk:
    """Layer, cell number and splat positions of one chunk."""

    layer: int
    cell: int
    places: I64


@dataclass(frozen=True)
class _Sizes:
    """Sizes of layers and chunks; see `nested_cells`."""

    first: int
    growth: float
    smallest: int
    largest: int


def nested_cells(
    means: F64,
    weights: F64,
    *,
    first: int,
    growth: float,
    smallest: int,
    largest: int,
    regions: Region = WHOLE_SCENE,
) -> NestedCells:
    """Cut an order into growing layers, and each layer into cells.

    Parameters
    ----------
    means : (n, 3) float64
        Means of the splats in their order, scene units.
    weights : (n,) float64
        Contribution of each splat. Within a layer, chunks are sorted by mean contribution.
    first : int
        Splats of the first layer.
    growth : float
        Ratio of a layer's size to the layer before, above 1.
    smallest, largest : int
        Limits of the splats of a chunk, with ``smallest ≤ first ≤ largest`` and
        ``2 · smallest ≤ largest``. A scene of fewer than `smallest` splats is one chunk.
    regions : Region
        Regions whose splats share no chunk but coarse ones; by default the scene is one region.

    Returns
    -------
    NestedCells
        Chunks. If a cell has fewer than `smallest` splats of a layer, they move to the next layer.

    Raises
    ------
    ValueError
        The sizes or the growth contradict each other.
    """
    if not 1 <= smallest <= first <= largest or 2 * smallest > largest or not growth > 1.0:
        raise ValueError(
            f"chunks of {smallest} to {largest} splats, {first} in the first layer, growing by "
            f"{growth}: expected the first layer between these, the largest at least twice the "
            "smallest, and growth above 1"
        )
    chunks: list[_Chunk] = []
    sizes = _Sizes(first, growth, smallest, largest)
    _cut_region(regions, WHOLE, np.arange(len(means)), 0, np.inf, means, sizes, chunks)
    for chunk in chunks:
        chunk.places.sort()
    chunks.sort(key=lambda chunk: (chunk.layer, -float(weights[chunk.places].mean()), chunk.cell))
    tree = chunk_tree(np.array([chunk.cell for chunk in chunks], np.int64))
    chunks = [chunks[at] for at in tree.order()]
    stops = np.cumsum([len(chunk.places) for chunk in chunks]).tolist()
    return NestedCells(
        np.concatenate([np.zeros(0, np.int64), *(chunk.places for chunk in chunks)]),
        [slice(a - len(chunk.places), a) for a, chunk in zip(stops, chunks, strict=True)],
        np.array([chunk.layer for chunk in chunks], np.int64),
        np.array([chunk.cell for chunk in chunks], np.int64),
    )


def _cut_region(
    region: Region,
    number: int,
    places: I64,
    layer: int,
    outer_splats: float,
    means: F64,
    sizes: _Sizes,
    chunks: list[_Chunk],
) -> None:
    """Append the chunks of a region, which is the cell `number`.

    Its chunks start at `layer`. `outer_splats` is the number of splats of the smallest region
    around it that has a coarse chunk.
    """
    # Numbers of deeper cells would exceed 32 bits.
    if region.halves is not None and number <= _MAX_HALVED:
        has_coarse = len(places) * _COARSENING <= outer_splats
        coarse, rest = np.split(places, [sizes.first * has_coarse])
        is_low = ~region.in_second_half(means, rest)
        below = int(np.count_nonzero(is_low))
        # Pruning may have left few splats on one side.
        if min(below, len(rest) - below) >= sizes.smallest:
            if has_coarse:
                outer_splats = len(places)
                chunks.append(_Chunk(layer, number, coarse))
                layer += 1
            for side, half in enumerate(region.halves):
                inner = rest[is_low ^ bool(side)]
                _cut_region(
                    half, 2 * number + side, inner, layer, outer_splats, means, sizes, chunks
                )
            return
    # Below a coarse chunk, the first layer has half of the splats, or of a chunk.
    most = min(len(places), sizes.largest) // 2
    first = max(sizes.first, most) if layer else sizes.first
    _cut_layers(_Cell(number), places, layer, first, means, sizes, chunks)


def _cut_layers(
    root: _Cell,
    places: I64,
    layer: int,
    first: int,
    means: F64,
    sizes: _Sizes,
    chunks: list[_Chunk],
) -> None:
    """Append the chunks of a cell, in growing layers from `layer` on."""
    for number, run in enumerate(_layers(len(places), first, sizes.growth), start=layer):
        _distribute(root, places[run], means)
        for leaf in _leaves(root):
            _cut(leaf, number, means, sizes.smallest, sizes.largest, chunks)
    for leaf in _leaves(root):
        _chunk_pending(leaf, sizes.largest, chunks)


def _layers(splats: int, first: int, growth: float) -> list[slice]:
    """Return growing ranges of splats; a rest below half of the next range joins the last range."""
    runs: list[slice] = []
    start, size = 0, first
    while start < splats:
        stop = min(start + size, splats)
        if splats - stop < growth * size / 2:
            stop = splats
        runs.append(slice(start, stop))
        start, size = stop, int(growth * size)
    return runs


def _leaves(cell: _Cell) -> list[_Cell]:
    """Return the leaves below a cell."""
    if cell.halves is None:
        return [cell]
    return _leaves(cell.halves[0]) + _leaves(cell.halves[1])


def _distribute(cell: _Cell, places: I64, means: F64) -> None:
    """Add splats to the pending splats of the leaves that they lie in."""
    if cell.halves is None:
        cell.pending.append(places)
        return
    is_low = means[places, cell.axis] < cell.plane
    _distribute(cell.halves[0], places[is_low], means)
    _distribute(cell.halves[1], places[~is_low], means)


def _cut(
    cell: _Cell, layer: int, means: F64, smallest: int, largest: int, chunks: list[_Chunk]
) -> None:
    """Append chunks of a leaf's pending splats, halving the leaf if they exceed one chunk."""
    places = np.concatenate(cell.pending)
    if len(places) < smallest:
        cell.pending = [places]
        return
    cell.pending = []
    if len(places) > largest:
        plane = None
        if cell.number <= _MAX_HALVED:
            plane = dividing_plane(means[places], smallest, largest)
        if plane is not None:
            cell.axis, cell.plane = plane
            cell.halves = (_Cell(2 * cell.number), _Cell(2 * cell.number + 1))
            _distribute(cell, places, means)
            for half in cell.halves:
                _cut(half, layer, means, smallest, largest, chunks)
            return
    # No plane separates coincident splats: they go to several chunks of one cell.
    count = -(-len(places) // largest)
    for part in np.array_split(places, count):
        cell.last_chunk = len(chunks)
        chunks.append(_Chunk(layer, cell.number, part))


def dividing_plane(means: F64, smallest: int, largest: int) -> tuple[int, float] | None:
    """Return the plane that cuts splats across the longest side of their inner box.

    Parameters
    ----------
    means : (n, 3) float64
        Means of the splats, scene units.
    smallest : int
        Least number of splats on each side of the plane.
    largest : int
        Splats of a chunk: each side gets a whole number of equal chunks, as even as possible.

    Returns
    -------
    axis : int
        Axis that the plane is perpendicular to.
    plane : float
        Coordinate of the plane; lower coordinates are on its first side. None instead of both if no
        plane has enough splats on both sides.
    """
    parts = -(-len(means) // largest)
    wanted = len(means) * (parts // 2) // parts
    low, high = inner_box(means)
    for axis in np.argsort(low - high, kind="stable").tolist():
        values = np.sort(means[:, axis])
        plane = float(values[wanted])
        below = int(np.searchsorted(values, plane, side="left"))
        if min(below, len(means) - below) >= smallest:
            return axis, plane
    return None


def inner_box(means: F64) -> tuple[F64, F64]:
    """Return both corners of the box around (n, 3) means, less 2 % at each end of an axis."""
    low, high = np.quantile(means, [_OUTLIERS, 1.0 - _OUTLIERS], axis=0)
    return low, high


def box_of_most(means: NDArray[np.floating]) -> tuple[float, ...]:
    """Return the box outside of which splats count as surroundings, such as hills and the sky.

    It is the box of (n, 3) means less 10 % at each end of an axis, extended at each side by the
    length of its longest side.

    Returns
    -------
    tuple of six float
        Minimum, then maximum corner.

    Examples
    --------
    >>> from cogsplat.codec.partition.nested_cells import box_of_most
    >>> box_of_most(np.array([[0.0, 0, 0], [8, 1, 0]] * 100))
    (-8.0, -8.0, -8.0, 16.0, 9.0, 8.0)
    """
    low, high = np.quantile(means, [_FAR_OUT, 1.0 - _FAR_OUT], axis=0)
    margin = _SURROUNDING * float((high - low).max())
    return (*(low - margin).tolist(), *(high + margin).tolist())


def _chunk_pending(cell: _Cell, largest: int, chunks: list[_Chunk]) -> None:
    """Add a leaf's pending splats to its last chunk, or split both evenly into two chunks."""
    left = np.concatenate([np.zeros(0, np.int64), *cell.pending])
    if not len(left):
        return
    if cell.last_chunk < 0:
        # Only the root of a scene with fewer splats than `smallest` has no chunk yet.
        chunks.append(_Chunk(0, cell.number, left))
        return
    last = chunks[cell.last_chunk]
    places = np.sort(np.concatenate([last.places, left]))
    if len(places) <= largest:
        last.places = places
        return
    middle = len(places) // 2
    last.places = places[:middle]
    chunks.append(_Chunk(last.layer + 1, cell.number, places[middle:]))
