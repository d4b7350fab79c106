"""Cells in layers: an order cut into chunks that each lie in one box, finer from layer to layer.

The first layer is one chunk of the whole scene. Each further layer has more splats, and its cells
are those of the layer before, halved where they hold too many. So a client can fetch the beginning
of everything, and more of what it looks at (as COPC's octree of points).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

DEFAULT_LARGEST: Final = 8192
"""Most splats of a chunk unless asked: bytes against selectivity, see below."""
# Bytes of heads, refinements, tails and codebooks over those of chunks that are not cut by cell, at
# a nominal 40 dB; PSNR in dB of the whole in held-out views, and of the first 35, 50 and 70 % of
# the splats, uncompensated:
#                                       captured room              house of 6 rooms
#   not cut                               39.77 27.6 31.5 35.0         30.20 20.5 23.1 25.6
#   most 16,384, layers grow by 1.5 +0.5% 39.79 27.6 31.6 34.7   +1.4% 30.29 20.9 23.2 25.5
#   most 8,192, layers grow by 1.5  +1.5% 39.77 27.9 31.2 34.8   +2.8% 30.31 20.8 22.7 24.9
#   most 4,096, layers grow by 1.5                               +5.7% 30.29 20.8 22.9 24.8
#   most 8,192, layers grow by 2    +5.9% 39.74 27.2 30.9 32.4
# Layers that double hold splats too different for one chunk's steps, and while the last layer
# arrives, half of the picture is coarse. Layers of a sixth of the splats at most were tried in the
# room: 0.5 % fewer bytes at equal PSNR, and 384 KiB show 0.3 dB more, but who chooses by the views
# nearest to a pose sees 0.9 dB less with half of the bytes (and 0.3 dB more with 70 %), as fewer
# chunks of the middle layers are cut.

WHOLE: Final = 1
"""Number of the cell that is the whole scene; the halves of cell c are 2c and 2c + 1 (SPEC 5.4)."""

# A cell is not halved where the numbers of its halves would leave the 32 bits of the chunk table.
_MOST_HALVED: Final = (1 << 31) - 1
# Share of the splats, at each end of each axis, that do not count in how long a cell is: floaters
# far outside would have it cut across the wrong axis.
_OUTSIDE: Final = 0.02


@dataclass(frozen=True, eq=False)
class NestedCells:
    """An order that is cut into chunks by layers and cells.

    Parameters
    ----------
    order : (n,) int64
        Places of the order that was cut, in the order of the chunks.
    slices : list of slice
        The chunks: consecutive runs of `order`, inside each by their places.
    layers : (c,) int64
        Layer of each chunk, ascending.
    cells : (c,) int64
        Number of each chunk's cell.
    """

    order: I64
    slices: list[slice]
    layers: I64
    cells: I64


def parents(cells: NDArray[np.integer]) -> I64:
    """Return the chunk that each chunk adds detail to (SPEC 5.4).

    Parameters
    ----------
    cells : (c,) integer
        Number of each chunk's cell, in the order of the chunks; 0 where chunks are not cut by cell.

    Returns
    -------
    (c,) int64
        -1 for a chunk that has no parent.

    Examples
    --------
    >>> from cogsplat.codec.partition.nested_cells import parents
    >>> parents(np.array([1, 1, 3, 2, 5])).tolist()
    [-1, 0, 1, 1, 3]
    """
    last: dict[int, int] = {}
    found = []
    for chunk, cell in enumerate(cells.tolist()):
        around = (cell >> k for k in range(cell.bit_length()))
        found.append(max((last.get(above, -1) for above in around), default=-1))
        last[cell] = chunk
    return np.array(found, np.int64)


@dataclass(eq=False)
class _Cell:
    """A cell while layers are cut: its plane once it was halved, else what waits for a chunk."""

    number: int
    waiting: list[I64] = field(default_factory=list)
    last_chunk: int = -1
    axis: int = -1
    plane: float = 0.0
    halves: tuple[_Cell, _Cell] | None = None


@dataclass(eq=False)
class _Chunk:
    layer: int
    cell: int
    places: I64


def nested_cells(
    means: F64, weights: F64, *, first: int, growth: float, least: int, most: int
) -> NestedCells:
    """Cut an order into layers that grow, and each layer into cells.

    Parameters
    ----------
    means : (n, 3) float64
        Of the splats in their order, scene units.
    weights : (n,) float64
        What splats contribute: inside a layer, chunks that contribute more for their splats come
        first.
    first : int
        Splats of the first layer.
    growth : float
        How many times larger each layer is than the one before, above 1.
    least, most : int
        Splats of a chunk, but for scenes of fewer than `least`. `least` is at most `first` and at
        most half of `most`, and `first` at most `most`.

    Returns
    -------
    NestedCells
        A cell's splats of a layer that are fewer than `least` wait for the next layer.

    Raises
    ------
    ValueError
        Numbers of splats that do not go together.
    """
    if not 1 <= least <= first <= most or 2 * least > most or not growth > 1.0:
        raise ValueError(
            f"chunks of {least} to {most} splats, {first} in the first layer, growing by {growth}: "
            "expected the first layer between least and most, most at least twice least, growth"
        )
    root = _Cell(WHOLE)
    chunks: list[_Chunk] = []
    for layer, run in enumerate(_layers(len(means), first, growth)):
        _share_out(root, np.arange(run.start, run.stop), means)
        for leaf in _leaves(root):
            _cut(leaf, layer, means, least, most, chunks)
    for leaf in _leaves(root):
        _finish(leaf, most, chunks)
    for chunk in chunks:
        chunk.places.sort()
    chunks.sort(key=lambda chunk: (chunk.layer, -float(weights[chunk.places].mean()), chunk.cell))
    stops = np.cumsum([len(chunk.places) for chunk in chunks]).tolist()
    return NestedCells(
        np.concatenate([np.zeros(0, np.int64), *(chunk.places for chunk in chunks)]),
        [slice(a - len(chunk.places), a) for a, chunk in zip(stops, chunks, strict=True)],
        np.array([chunk.layer for chunk in chunks], np.int64),
        np.array([chunk.cell for chunk in chunks], np.int64),
    )


def _layers(splats: int, first: int, growth: float) -> list[slice]:
    """Return runs that grow; a rest of less than half of the next run joins the last one."""
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
    if cell.halves is None:
        return [cell]
    return _leaves(cell.halves[0]) + _leaves(cell.halves[1])


def _share_out(cell: _Cell, places: I64, means: F64) -> None:
    """Give splats to the leaves that they lie in."""
    if cell.halves is None:
        cell.waiting.append(places)
        return
    is_low = means[places, cell.axis] < cell.plane
    _share_out(cell.halves[0], places[is_low], means)
    _share_out(cell.halves[1], places[~is_low], means)


def _cut(cell: _Cell, layer: int, means: F64, least: int, most: int, chunks: list[_Chunk]) -> None:
    """Make chunks of what waits in a leaf, and halve it where that is more than a chunk holds."""
    places = np.concatenate(cell.waiting)
    if len(places) < least:
        cell.waiting = [places]
        return
    cell.waiting = []
    if len(places) > most:
        plane = _plane(means[places], least, most) if cell.number <= _MOST_HALVED else None
        if plane is not None:
            cell.axis, cell.plane = plane
            cell.halves = (_Cell(2 * cell.number), _Cell(2 * cell.number + 1))
            _share_out(cell, places, means)
            for half in cell.halves:
                _cut(half, layer, means, least, most, chunks)
            return
    # Splats in one place cannot be told apart by planes: several chunks of one cell hold them.
    count = -(-len(places) // most)
    for part in np.array_split(places, count):
        cell.last_chunk = len(chunks)
        chunks.append(_Chunk(layer, cell.number, part))


def _plane(means: F64, least: int, most: int) -> tuple[int, float] | None:
    """Return an axis and where to cut it, or None where no plane leaves enough on both sides."""
    parts = -(-len(means) // most)
    wanted = len(means) * (parts // 2) // parts
    low, high = np.quantile(means, [_OUTSIDE, 1.0 - _OUTSIDE], axis=0)
    for axis in np.argsort(low - high, kind="stable").tolist():
        values = np.sort(means[:, axis])
        plane = float(values[wanted])
        below = int(np.searchsorted(values, plane, side="left"))
        if min(below, len(means) - below) >= least:
            return axis, plane
    return None


def _finish(cell: _Cell, most: int, chunks: list[_Chunk]) -> None:
    """Add what still waits in a leaf to its last chunk, or share both between two chunks."""
    left = np.concatenate([np.zeros(0, np.int64), *cell.waiting])
    if not len(left):
        return
    if cell.last_chunk < 0:
        # Leaves have a chunk since they were made; this is a scene of fewer than `least`.
        chunks.append(_Chunk(0, cell.number, left))
        return
    last = chunks[cell.last_chunk]
    places = np.sort(np.concatenate([last.places, left]))
    if len(places) <= most:
        last.places = places
        return
    middle = len(places) // 2
    last.places = places[:middle]
    chunks.append(_Chunk(last.layer + 1, cell.number, places[middle:]))
