"""A client of a scene that is cut into chunks: what it may fetch, and when it has come."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.partition.nested_cells import parents
from cogsplat.formats.cogs.layout import COLOUR_BANDS, SegmentKind
from cogsplat.formats.cogs.reader import CogsFile
from cogsplat.tools.lab.scheduling.scheduler import best_chain

from .traces import Trace

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

LOOK_SECONDS: Final = 0.1
"""How long until a client looks again from where the visitor is then (docs/streaming.md, 11)."""

Priorities = Callable[[Camera], F64]
"""How much a byte of each unit of a file is wanted from a pose; 0 where it is not asked for."""


@dataclass(frozen=True, eq=False)
class Units:
    """The segments of a file that pictures need, in the order of the file.

    Parameters
    ----------
    kind : (u,) int64
        `SegmentKind` of each.
    chunk : (u,) int64
        Chunk of a head, a refinement or a tail; -1 for codebooks.
    end : (u,) int64
        Byte of the file behind the segment.
    size_bytes : (u,) int64
    after : list of tuple of int
        Units that a unit is of no use without: those of the chunk's parent, codebooks, its head.
    opening_bytes : int
        Preamble, root and pages of the index, without which nobody knows what there is.
    """

    kind: I64
    chunk: I64
    end: I64
    size_bytes: I64
    after: list[tuple[int, ...]]
    opening_bytes: int

    def __len__(self) -> int:
        return len(self.kind)


@dataclass(frozen=True)
class Link:
    """A network.

    Parameters
    ----------
    bits_per_second : float
    latency : float
        Seconds from a request to the first byte of its answer, when nothing else is under way.
    """

    bits_per_second: float
    latency: float


@dataclass(frozen=True, eq=False)
class Arrivals:
    """What a client has fetched.

    Parameters
    ----------
    units : list of int
        In the order of their arrival; one that was thrown away and fetched again several times.
    seconds : (u,) float64
        When each had arrived.
    leaves : (u,) float64, optional
        When each was thrown away; none is, by default.
    """

    units: list[int]
    seconds: F64
    leaves: F64 | None = None

    def came(self, seconds: float) -> list[int]:
        """Return the units that had been fetched by a moment, as often as they were."""
        return self.units[: int(np.searchsorted(self.seconds, seconds, "right"))]

    def there(self, seconds: float) -> list[int]:
        """Return the units that are there at a moment."""
        came = self.came(seconds)
        if self.leaves is None:
            return came
        stays = self.leaves[: len(came)] > seconds
        return [unit for unit, is_there in zip(came, stays, strict=True) if is_there]


def units_of(file: CogsFile) -> Units:
    """Return what a client may fetch of a file: of a part of one, the chunks that are complete."""
    kinds = file.segments.kind.astype(np.int64)
    wanted = [SegmentKind.HEAD, SegmentKind.REFINEMENT, SegmentKind.TAIL, *COLOUR_BANDS]
    of_chunk = np.isin(kinds, wanted[:3])
    there = ~of_chunk | (file.segments.owner < file.complete_chunks())
    there &= np.array([file.is_present(row) for row in range(len(kinds))], np.bool_)
    rows = np.flatnonzero(np.isin(kinds, [*wanted, SegmentKind.SHAPE_CODEBOOK]) & there)
    rows = rows[np.argsort(file.offsets[rows], kind="stable")]
    of_chunk = of_chunk[rows]
    kind, owner = kinds[rows], file.segments.owner[rows].astype(np.int64)
    chunk = np.where(of_chunk, owner, -1)
    heads = {int(chunk[u]): u for u in np.flatnonzero(kind == SegmentKind.HEAD).tolist()}
    shapes = tuple(np.flatnonzero(kind == SegmentKind.SHAPE_CODEBOOK).tolist())
    colours = tuple(np.flatnonzero(np.isin(kind, COLOUR_BANDS)).tolist())
    above = parents(file.chunks.cell)
    after: list[tuple[int, ...]] = []
    for u in range(len(rows)):
        if kind[u] == SegmentKind.HEAD:
            parent = int(above[chunk[u]])
            after.append(shapes + ((heads[parent],) if parent >= 0 else ()))
        elif kind[u] == SegmentKind.TAIL:
            after.append((*colours, heads[int(chunk[u])]))
        elif kind[u] == SegmentKind.REFINEMENT:
            after.append((heads[int(chunk[u])],))
        else:
            after.append(())
    size = file.segments.length[rows].astype(np.int64)
    end = file.offsets[rows].astype(np.int64) + size
    # The first segment of the file stands behind the root.
    index = int(file.offsets[0]) if len(file.offsets) else file.file_length
    index += sum(page.length for page in file.root.pages)
    return Units(kind, chunk, end, size, after, index)


def fetch(units: Units, trace: Trace, link: Link, priorities: Priorities) -> Arrivals:
    """Simulate a client that always has its next request under way.

    Parameters
    ----------
    units : Units
    trace : Trace
        Whose poses the client looks from.
    link : Link
    priorities : callable
        Of a pose: what the client wants.

    Returns
    -------
    Arrivals
        All units that are asked for before the end of the trace. What comes next was chosen one
        latency before its first byte, from the pose of that moment: the first unit of the chain
        that is worth most (docs/streaming.md, 7).
    """
    now = link.latency + 8.0 * units.opening_bytes / link.bits_per_second
    missing = np.ones(len(units), np.bool_)
    came: list[int] = []
    seconds = []
    while missing.any():
        # Without any answer yet, nobody knows what there is to choose from.
        chosen_at = max(now - link.latency, 0.0)
        wanted = priorities(trace.at(chosen_at))
        unit = _next_unit(units, wanted, _by_want(wanted), missing)
        if unit is None:
            if chosen_at >= trace.seconds:
                break
            now += LOOK_SECONDS
            continue
        now += 8.0 * float(units.size_bytes[unit]) / link.bits_per_second
        missing[unit] = False
        came.append(unit)
        seconds.append(now)
    return Arrivals(came, np.array(seconds))


def waited_for(units: Units, wanted: F64, there: Sequence[int] = ()) -> list[int]:
    """Return what somebody fetches who stays at a pose, in that order.

    Parameters
    ----------
    units : Units
    wanted : (u,) float64
        Of the pose, as `Priorities` give it.
    there : sequence of int
        Units that were fetched before.

    Returns
    -------
    list of int
        All others that the pose wants.
    """
    missing = np.ones(len(units), np.bool_)
    missing[list(there)] = False
    order = _by_want(wanted)
    found: list[int] = []
    while (unit := _next_unit(units, wanted, order, missing)) is not None:
        missing[unit] = False
        found.append(unit)
    return found


def _by_want(wanted: F64) -> I64:
    """Return the units that are asked for, those that are wanted most first."""
    order = np.argsort(-wanted, kind="stable")
    return order[wanted[order] > 0.0]


def _next_unit(units: Units, wanted: F64, order: I64, missing: NDArray[np.bool_]) -> int | None:
    """Return the first unit of the missing chain that is worth most (docs/streaming.md, 7).

    None where nothing is wanted. The order is that of `_by_want`.
    """
    best = best_chain(
        order[missing[order]].tolist(),
        wanted,
        units.size_bytes,
        units.after,
        lambda unit: bool(missing[unit]),
    )
    return None if best is None else int(best[0][0])
