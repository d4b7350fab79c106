"""Tile lists: the footprints that reach each 16x16 px tile of an image, nearest first."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.compiling import called_with
from cogsplat.codec.threads import ordered_map

from .jit import inner_kernel, kernel
from .projection import HALF_HEIGHT, HALF_WIDTH, SHEAR, Footprints, X, Y, slack

TILE = 16

# Pairs of a tile and a splat listed at once, at most. It bounds memory (4 bytes per pair here, 12
# more while scoring) if huge splats cover every tile.
_PAIRS_AT_ONCE = 1 << 24
# Ranges of tiles per thread. Tiles differ in cost; several ranges keep all threads busy to the end.
_RANGES_PER_THREAD = 4


@dataclass(frozen=True, eq=False)
class TileLists:
    """Footprints that reach each tile of a range; tiles are numbered row by row.

    Parameters
    ----------
    first, last : int
        Half-open range of tiles.
    starts : (last - first + 1,) int64
        Start of each tile's run in `members`, and the end of the last run.
    members : (P,) int32
        Rows of the footprints, nearest first within each run.
    """

    first: int
    last: int
    starts: NDArray[np.int64]
    members: NDArray[np.int32]

    def split(self, parts: int) -> list[tuple[int, int]]:
        """Cut the tiles into at most `parts` ranges of about equally many pairs."""
        wanted = np.linspace(0, len(self.members), parts + 1)[1:-1]
        cuts = self.first + np.searchsorted(self.starts, wanted)
        edges = np.unique(np.concatenate(([self.first], cuts, [self.last])))
        return list(zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True))

    def of_pairs(self, kept: NDArray[np.bool_]) -> TileLists:
        """Return the lists of the pairs of a mask, (P,) bool."""
        before = np.zeros(len(kept) + 1, np.int64)
        np.cumsum(kept, out=before[1:])
        return TileLists(self.first, self.last, before[self.starts], self.members[kept])

    def pairs_in(self, tiles: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return a mask of the pairs, (P,) bool, in the tiles of a mask of all tiles, (T,) bool."""
        return np.repeat(tiles[self.first : self.last], np.diff(self.starts))

    def renumbered(self, places: NDArray[np.int32]) -> TileLists:
        """Return the lists with each member m replaced by ``places[m]``."""
        return TileLists(self.first, self.last, self.starts, places[self.members])

    def bands(self, pairs_at_once: int) -> Iterator[TileLists]:
        """Yield consecutive ranges of tiles: one tile, or at most `pairs_at_once` pairs."""
        at = 0
        while at < self.last - self.first:
            before = int(self.starts[at])
            after = int(np.searchsorted(self.starts, before + pairs_at_once, side="right")) - 1
            stop = max(after, at + 1)
            starts = self.starts[at : stop + 1] - before
            members = self.members[before : int(self.starts[stop])]
            yield TileLists(self.first + at, self.first + stop, starts, members)
            at = stop

    def for_ranges(self, work: Callable[[int, int], object], threads: int) -> None:
        """Call ``work(first, last)`` for half-open ranges of tiles on several threads.

        Parameters
        ----------
        work : callable
            Function of a range of tiles; calls may run in parallel.
        threads : int
            Number of threads, at least 1.
        """
        parts = 1 if threads == 1 else threads * _RANGES_PER_THREAD
        for _ in ordered_map(lambda tiles: work(*tiles), self.split(parts), threads):
            pass


def sampled_tiles(width: int, height: int, every: int, phase: int) -> NDArray[np.bool_]:
    """Return a mask of one in `every` tiles of an image, spread evenly.

    Parameters
    ----------
    width, height : int
        Image size, px.
    every : int
        Interval of the tiles, at least 1.
    phase : int
        Number of the sample: in `every` consecutive samples each tile occurs once.

    Returns
    -------
    (T,) bool
        By tile, row by row.
    """
    rows = np.arange(-(-height // TILE))[:, None]
    columns = np.arange(-(-width // TILE))
    # Half the interval from row to row keeps the tiles of a sample apart.
    chosen: NDArray[np.bool_] = (columns + (every + 1) // 2 * rows + phase) % every == 0
    return chosen.ravel()


def sampled_pixels(width: int, height: int, tiles: NDArray[np.bool_]) -> int:
    """Return the number of pixels in the tiles of a mask by tile of the image, (T,) bool."""
    rows = np.diff(np.append(np.arange(0, height, TILE), height))
    columns = np.diff(np.append(np.arange(0, width, TILE), width))
    return int(np.outer(rows, columns).ravel()[tiles].sum())


@inner_kernel
def _reach(ellipse: NDArray[np.float32]) -> float:
    """Return half the width of an ellipse's box, px."""
    half_width, tilt = float(ellipse[HALF_WIDTH]), float(ellipse[SHEAR] * ellipse[HALF_HEIGHT])
    return math.sqrt(half_width * half_width + tilt * tilt)


@inner_kernel
def _columns_between(left: float, right: float, margin: float, width: int) -> tuple[int, int]:
    """Return the half-open range of tile columns between two positions, px, with a margin."""
    # Clamped as floats: a NaN or a huge value must not reach the integers.
    left = left - 0.5 - margin
    if not left > 0.0:
        left = 0.0
    right = right - 0.5 + margin
    if not right < width - 1.0:
        right = width - 1.0
    if not left <= right:
        return 0, 0
    return math.ceil(left) // TILE, math.floor(right) // TILE + 1


@inner_kernel
def _tile_columns(
    ellipse: NDArray[np.float32], reach: float, first_row: int, last_row: int, width: int
) -> tuple[int, int]:
    """Return the half-open range of tile columns that an ellipse reaches between two image rows."""
    x, y = float(ellipse[X]), float(ellipse[Y])
    shear = float(ellipse[SHEAR])
    half_width, half_height = float(ellipse[HALF_WIDTH]), float(ellipse[HALF_HEIGHT])
    margin = slack(x, reach + abs(shear) * half_height)
    left, right = _columns_between(x - reach, x + reach, margin, width)
    if right - left <= 1:
        # Most splats of a large scene are small: their box is in one tile.
        return left, right
    # Offset of the row in which the ellipse extends furthest right; negated, furthest left.
    furthest = 0.0
    if reach > 0.0:
        furthest = shear * half_height * (half_height / reach)
    low = max(first_row + 0.5 - y, -half_height)
    high = min(last_row - 0.5 - y, half_height)
    right_row = min(max(furthest, low), high)
    left_row = min(max(-furthest, low), high)
    share = right_row / half_height if half_height > 0.0 else 0.0
    right_end = x + shear * right_row + half_width * math.sqrt(max(0.0, 1.0 - share * share))
    share = left_row / half_height if half_height > 0.0 else 0.0
    left_end = x + shear * left_row - half_width * math.sqrt(max(0.0, 1.0 - share * share))
    return _columns_between(left_end, right_end, margin, width)


@called_with(
    "float32[:, ::1], int32[:, ::1], int64, int64, boolean[::1], int64[::1], int64[::1], "
    "int32[:, ::1]"
)
@kernel
def _count(
    ellipse: NDArray[np.float32],
    rows: NDArray[np.int32],
    width: int,
    tiles_x: int,
    is_open: NDArray[np.bool_],
    first_spans: NDArray[np.int64],
    counts: NDArray[np.int64],
    spans: NDArray[np.int32],
) -> None:
    """Find the tiles that each footprint may reach, and count the footprints of each open tile.

    Parameters
    ----------
    ellipse, rows
        Arrays of `Footprints`.
    width : int
        Image width, px.
    tiles_x : int
        Number of tiles in a row of tiles.
    is_open : (T,) bool
        Tiles that are listed.
    first_spans : (M + 1,) int64
        First row of each footprint in `spans`.
    counts : (tiles,) int64
        Number of footprints by tile, increased in place.
    spans : (S, 2) int32
        Output, by footprint and row of tiles from the top: half-open range of tiles.
    """
    for i in range(len(ellipse)):
        reach = _reach(ellipse[i])
        tile_y = rows[i, 0] // TILE
        for span in range(first_spans[i], first_spans[i + 1]):
            top = max(rows[i, 0], tile_y * TILE)
            bottom = min(rows[i, 1], tile_y * TILE + TILE)
            left, right = _tile_columns(ellipse[i], reach, top, bottom, width)
            spans[span, 0] = tile_y * tiles_x + left
            spans[span, 1] = tile_y * tiles_x + right
            for tile in range(tile_y * tiles_x + left, tile_y * tiles_x + right):
                if is_open[tile]:
                    counts[tile] += 1
            tile_y += 1


@called_with("int64[::1], int32[:, ::1], boolean[::1], int64, int64, int64[::1], int32[::1]")
@kernel
def _fill(
    first_spans: NDArray[np.int64],
    spans: NDArray[np.int32],
    is_open: NDArray[np.bool_],
    first: int,
    last: int,
    cursors: NDArray[np.int64],
    members: NDArray[np.int32],
) -> None:
    """Append the footprints, in order, to the lists of the tiles that they may reach.

    Parameters
    ----------
    first_spans, spans, is_open
        Arguments and output of `_count`.
    first, last : int
        Half-open range of tiles.
    cursors : (last - first,) int64
        Position in `members` of each tile's next footprint, changed in place.
    members : (P,) int32
        Output: `TileLists.members`.
    """
    for i in range(len(first_spans) - 1):
        for span in range(first_spans[i], first_spans[i + 1]):
            for tile in range(max(spans[span, 0], first), min(spans[span, 1], last)):
                if is_open[tile]:
                    members[cursors[tile - first]] = i
                    cursors[tile - first] += 1


def tile_lists(
    footprints: Footprints,
    width: int,
    height: int,
    pairs_at_once: int = _PAIRS_AT_ONCE,
    is_open: NDArray[np.bool_] | None = None,
) -> Iterator[TileLists]:
    """Yield the footprints of every tile of an image, in bands of bounded memory.

    Parameters
    ----------
    footprints : Footprints
        Footprints, nearest first.
    width, height : int
        Image size, px.
    pairs_at_once : int
        Pairs of a tile and a splat in a band at most; a single tile may exceed it.

    is_open : (T,) bool, optional
        Tiles to list, row by row; the lists of others are empty. By default all.

    Yields
    ------
    TileLists
        Consecutive ranges of tiles that cover the image; they depend on the view only.
    """
    tiles_x = -(-width // TILE)
    num_tiles = tiles_x * -(-height // TILE)
    if is_open is None:
        is_open = np.ones(num_tiles, np.bool_)
    counts = np.zeros(num_tiles, np.int64)
    rows = footprints.rows
    first_spans = np.zeros(len(footprints) + 1, np.int64)
    np.cumsum((rows[:, 1] + (TILE - 1)) // TILE - rows[:, 0] // TILE, out=first_spans[1:])
    spans = np.empty((int(first_spans[-1]), 2), np.int32)
    _count(footprints.ellipse, rows, width, tiles_x, is_open, first_spans, counts, spans)
    ends = np.cumsum(counts)
    first = 0
    while first < num_tiles:
        before = int(ends[first - 1]) if first else 0
        last = int(np.searchsorted(ends, before + pairs_at_once, side="right"))
        last = min(max(last, first + 1), num_tiles)
        starts = np.zeros(last - first + 1, np.int64)
        starts[1:] = ends[first:last] - before
        members = np.empty(int(starts[-1]), np.int32)
        _fill(first_spans, spans, is_open, first, last, starts[:-1].copy(), members)
        yield TileLists(first, last, starts, members)
        first = last


@called_with("int32[::1], float32[:, ::1], float64[:, ::1], int64")
@kernel
def add_pair_sums(
    members: NDArray[np.int32],
    pair_sums: NDArray[np.float32],
    sums: NDArray[np.float64],
    peaks: int,
) -> None:
    """Add the sums of each pair of a tile and a footprint to the footprint's sums.

    Parameters
    ----------
    members : (P,) int32
        Row of each pair's footprint, from `TileLists`.
    pair_sums : (P, K) float32
        Sums of each pair.
    sums : (M, K) float64
        Sums of each footprint, changed in place.
    peaks : int
        Number of the last columns that hold maxima instead of sums.
    """
    columns = pair_sums.shape[1]
    for pair in range(len(members)):
        i = members[pair]
        for column in range(columns - peaks):
            sums[i, column] += pair_sums[pair, column]
        for column in range(columns - peaks, columns):
            sums[i, column] = max(sums[i, column], pair_sums[pair, column])


@called_with("int64[::1], int32[::1], int64, int64[::1], int32[::1]")
@kernel
def _append(
    starts: NDArray[np.int64],
    members: NDArray[np.int32],
    first: int,
    cursors: NDArray[np.int64],
    joined: NDArray[np.int32],
) -> None:
    """Append lists, the first of them that of tile `first`, to `joined`, and move the cursors."""
    for tile in range(len(starts) - 1):
        to = cursors[first + tile]
        for pair in range(starts[tile], starts[tile + 1]):
            joined[to] = members[pair]
            to += 1
        cursors[first + tile] = to


def join_lists(parts: Sequence[TileLists]) -> TileLists:
    """Join several parts: the list of a tile is its lists in all parts, one after the other.

    Parameters
    ----------
    parts : sequence of TileLists
        Lists of any ranges of tiles, whose members have the same numbers in all parts.
    """
    num_tiles = max(part.last for part in parts)
    starts = np.zeros(num_tiles + 1, np.int64)
    for part in parts:
        starts[part.first + 1 : part.last + 1] += np.diff(part.starts)
    np.cumsum(starts, out=starts)
    members = np.empty(int(starts[-1]), np.int32)
    cursors = starts[:-1].copy()
    for part in parts:
        _append(part.starts, part.members, part.first, cursors, members)
    return TileLists(0, num_tiles, starts, members)
