"""Streaming clients with one request in flight: fetchable units and their arrival times."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.formats.cogs.layout import COLOUR_BANDS, SegmentKind
from cogsplat.formats.cogs.reader import CogsFile
from cogsplat.tools.lab.scheduling.index_ratios import segment_places
from cogsplat.tools.lab.scheduling.scheduler import best_chain

from .traces import Trace

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

DECISION_INTERVAL: Final = 0.1
"""Time between two evaluations of the pose, s (docs/streaming.md, 11)."""

Priorities = Callable[[Camera], F64]
"""Function from a camera to the urgency of each unit, (u,) float64; 0 if not to be fetched."""


@dataclass(frozen=True, eq=False)
class Units:
    """Segments of a file that rendering needs, in the order of the file.

    Parameters
    ----------
    kind : (u,) int64
        `SegmentKind` of each unit.
    chunk : (u,) int64
        Chunk of a head, refinement or tail; -1 for codebooks.
    end : (u,) int64
        Offset of the first byte after each unit.
    size_bytes : (u,) int64
        Size of each unit.
    dependencies : list of tuple of int
        Units required to decode or draw each unit: head, head of the parent chunk, codebooks.
    index_bytes : int
        Size of preamble, root and pages, which are fetched before any unit.
    places : (u,) float64, optional
        Place of each unit, bytes (docs/streaming.md, 7); by default its end.
    """

    kind: I64
    chunk: I64
    end: I64
    size_bytes: I64
    dependencies: list[tuple[int, ...]]
    index_bytes: int
    places: F64 | None = None

    @property
    def place(self) -> F64:
        """Place of each unit, (u,) float64, bytes."""
        return self.end.astype(np.float64) if self.places is None else self.places

    def __len__(self) -> int:
        return len(self.kind)


@dataclass(frozen=True)
class Link:
    """Network link between client and server.

    Parameters
    ----------
    bits_per_second : float
        Bandwidth.
    latency : float
        Time from a request to the first byte of its response on an idle link, s.
    """

    bits_per_second: float
    latency: float


@dataclass(frozen=True, eq=False)
class Arrivals:
    """Arrival and eviction times of the units that a client fetched.

    Parameters
    ----------
    units : list of int
        Units in the order of arrival; a unit fetched again after eviction occurs again.
    seconds : (u,) float64
        Time at which each unit was complete.
    evicted_at : (u,) float64, optional
        Time at which each unit was evicted, infinite for never; by default never for all.
    """

    units: list[int]
    seconds: F64
    evicted_at: F64 | None = None

    def fetched_by(self, seconds: float) -> list[int]:
        """Return the units fetched until a time, with repetitions."""
        return self.units[: int(np.searchsorted(self.seconds, seconds, "right"))]

    def present_at(self, seconds: float) -> list[int]:
        """Return the units fetched and not evicted at a time."""
        fetched = self.fetched_by(seconds)
        if self.evicted_at is None:
            return fetched
        stays = self.evicted_at[: len(fetched)] > seconds
        return [unit for unit, is_present in zip(fetched, stays, strict=True) if is_present]


def units_of(file: CogsFile) -> Units:
    """List the fetchable units of a file; of a truncated file only complete chunks count."""
    kinds = file.segments.kind.astype(np.int64)
    chunk_kinds = [SegmentKind.HEAD, SegmentKind.REFINEMENT, SegmentKind.TAIL]
    fetched_kinds = [*chunk_kinds, *COLOUR_BANDS, SegmentKind.SHAPE_CODEBOOK]
    of_chunk = np.isin(kinds, chunk_kinds)
    is_fetchable = ~of_chunk | (file.segments.owner < file.complete_chunks())
    is_fetchable &= np.array([file.is_present(row) for row in range(len(kinds))], np.bool_)
    rows = np.flatnonzero(np.isin(kinds, fetched_kinds) & is_fetchable)
    rows = rows[np.argsort(file.offsets[rows], kind="stable")]
    of_chunk = of_chunk[rows]
    kind, owner = kinds[rows], file.segments.owner[rows].astype(np.int64)
    chunk = np.where(of_chunk, owner, -1)
    heads = {int(chunk[u]): u for u in np.flatnonzero(kind == SegmentKind.HEAD).tolist()}
    shapes = tuple(np.flatnonzero(kind == SegmentKind.SHAPE_CODEBOOK).tolist())
    colours = tuple(np.flatnonzero(np.isin(kind, COLOUR_BANDS)).tolist())
    parent_of = file.parents()
    dependencies: list[tuple[int, ...]] = []
    for u in range(len(rows)):
        if kind[u] == SegmentKind.HEAD:
            parent = int(parent_of[chunk[u]])
            dependencies.append(shapes + ((heads[parent],) if parent >= 0 else ()))
        elif kind[u] == SegmentKind.TAIL:
            dependencies.append((*colours, heads[int(chunk[u])]))
        elif kind[u] == SegmentKind.REFINEMENT:
            dependencies.append((heads[int(chunk[u])],))
        else:
            dependencies.append(())
    size = file.segments.length[rows].astype(np.int64)
    end = file.offsets[rows].astype(np.int64) + size
    # The first segment of the file follows the root.
    index = int(file.offsets[0]) if len(file.offsets) else file.file_length
    index += sum(file.page_bytes)
    places = segment_places(file.indices)[rows]
    return Units(kind, chunk, end, size, dependencies, index, places)


def simulate_fetch(units: Units, trace: Trace, link: Link, priorities: Priorities) -> Arrivals:
    """Simulate a client with one request in flight at any time.

    Parameters
    ----------
    units : Units
    trace : Trace
        Path of the client's camera.
    link : Link
    priorities : Priorities

    Returns
    -------
    Arrivals
        All units requested until the end of the trace. Each is the first unit of the best chain
        (docs/streaming.md, 7) at the pose one latency before its first byte.
    """
    now = link.latency + 8.0 * units.index_bytes / link.bits_per_second
    missing = np.ones(len(units), np.bool_)
    fetched: list[int] = []
    seconds = []
    while missing.any():
        # Nothing is chosen before the index has arrived.
        chosen_at = max(now - link.latency, 0.0)
        urgency = priorities(trace.camera_at(chosen_at))
        unit = _next_unit(units, urgency, _by_urgency(urgency), missing)
        if unit is None:
            if chosen_at >= trace.seconds:
                break
            now += DECISION_INTERVAL
            continue
        now += 8.0 * float(units.size_bytes[unit]) / link.bits_per_second
        missing[unit] = False
        fetched.append(unit)
        seconds.append(now)
    return Arrivals(fetched, np.array(seconds))


def fetch_order(units: Units, urgency: F64, present: Sequence[int] = ()) -> list[int]:
    """Return the order in which a client at a fixed pose fetches its missing units.

    Parameters
    ----------
    units : Units
    urgency : (u,) float64
        Urgency of each unit at the pose (`Priorities`).
    present : sequence of int
        Units fetched before.

    Returns
    -------
    list of int
        Missing units of urgency above 0, and their missing dependencies. Each is the first unit of
        the best chain (docs/streaming.md, 7) once the units before it are fetched.
    """
    missing = np.ones(len(units), np.bool_)
    missing[list(present)] = False
    order = _by_urgency(urgency)
    found: list[int] = []
    while (unit := _next_unit(units, urgency, order, missing)) is not None:
        missing[unit] = False
        found.append(unit)
    return found


def _by_urgency(urgency: F64) -> I64:
    """Return the units of urgency above 0, by falling urgency."""
    order = np.argsort(-urgency, kind="stable")
    return order[urgency[order] > 0.0]


def _next_unit(units: Units, urgency: F64, order: I64, missing: NDArray[np.bool_]) -> int | None:
    """Return the first unit of the best chain (docs/streaming.md, 7); None if none is missing.

    `order` is the result of `_by_urgency`.
    """
    best = best_chain(
        order[missing[order]].tolist(),
        urgency,
        units.size_bytes,
        units.dependencies,
        lambda unit: bool(missing[unit]),
    )
    return None if best is None else int(best[0][0])
