"""Streaming clients with one request in flight: fetchable units and their arrival times."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.formats.cogs.layout import COLOUR_BANDS, SegmentKind
from cogsplat.formats.cogs.reader import CogsFile
from cogsplat.tools.lab.scheduling.index_ratios import unit_gains
from cogsplat.tools.lab.scheduling.scene_rows import pages_in_file_order, scene_rows
from cogsplat.tools.lab.scheduling.scheduler import best_chain

from .traces import Trace

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

DECISION_INTERVAL: Final = 0.1
"""Time between two evaluations of the pose, s (docs/streaming.md, 11)."""

PAGE: Final = 0
"""Kind of a unit that is a page; no segment has it (SPEC 5.2)."""

CHUNK_KINDS: Final = (SegmentKind.HEAD, SegmentKind.REFINEMENT, SegmentKind.TAIL)
"""Kinds of the units that are segments of chunks."""

Priorities = Callable[[Camera, Collection[int]], F64]
"""Function from a camera and the units present to the urgency of each unit, (u,) float64.

0 if not to be fetched.
"""


@dataclass(frozen=True, eq=False)
class Units:
    """Segments of a file that rendering needs, and its pages, in the order of the file.

    Parameters
    ----------
    kind : (u,) int64
        `SegmentKind` of each unit, or `PAGE`.
    row : (u,) int64
        Row of the chunk or page (`scene_rows.SceneRows`), of a chunk its number; -1 for codebooks
        and view tables.
    end : (u,) int64
        Offset of the first byte after each unit.
    size_bytes : (u,) int64
        Size of each unit.
    dependencies : list of tuple of int
        Units required to decode or draw each unit: head, head of the parent chunk, codebooks.
    index_bytes : int
        Size of preamble and root, which are fetched before any unit.
    gains : (u,) float64, optional
        Gain of each unit (docs/streaming.md, 7), in the unit of contributions; by default 0, for
        clients that do not use it.
    page_of : (u,) int64, optional
        Unit of the page that lists each unit, -1 for the root; by default the root lists all.
    """

    kind: I64
    row: I64
    end: I64
    size_bytes: I64
    dependencies: list[tuple[int, ...]]
    index_bytes: int
    gains: F64 | None = None
    page_of: I64 | None = None

    def listed(self, present: Collection[int]) -> NDArray[np.bool_]:
        """Return a mask, (u,) bool, of the units listed by the root or by a present page."""
        if self.page_of is None:
            return np.ones(len(self), np.bool_)
        return np.isin(self.page_of, [-1, *present])

    def pages_in(self, present: Collection[int]) -> list[int]:
        """Return the rows of the pages among units."""
        return [int(self.row[unit]) for unit in present if self.kind[unit] == PAGE]

    def tells_more(self, unit: int) -> bool:
        """Whether urgencies or the units listed change when a unit has arrived."""
        return bool(self.kind[unit] in (PAGE, SegmentKind.VIEW_TABLE))

    @property
    def gain(self) -> F64:
        """Gain of each unit, (u,) float64."""
        return np.zeros(len(self)) if self.gains is None else self.gains

    @property
    def is_head(self) -> NDArray[np.bool_]:
        """Mask of the heads of chunks and the pages, (u,) bool."""
        return np.isin(self.kind, [SegmentKind.HEAD, PAGE])

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
    most_requests : int
        Requests in flight at most: 6 over HTTP/1.1, 24 over HTTP/2 and HTTP/3 (SPEC 8.8).
    """

    bits_per_second: float
    latency: float
    most_requests: int = 6


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
    requested_at : (q,) float64, optional
        Time of each request, ascending; by default each unit had its own.
    """

    units: list[int]
    seconds: F64
    evicted_at: F64 | None = None
    requested_at: F64 | None = None

    def requests_by(self, seconds: float) -> int:
        """Return the number of requests made until a time, that of the root included."""
        if self.requested_at is None:
            return 1 + len(self.fetched_by(seconds))
        return int(np.searchsorted(self.requested_at, seconds, "right"))

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
    fetched_kinds = [
        *CHUNK_KINDS,
        *COLOUR_BANDS,
        SegmentKind.SHAPE_CODEBOOK,
        SegmentKind.VIEW_TABLE,
    ]
    of_chunk = np.isin(kinds, CHUNK_KINDS)
    is_fetchable = ~of_chunk | (file.segments.owner < file.complete_chunks())
    is_fetchable &= np.array([file.is_present(row) for row in range(len(kinds))], np.bool_)
    rows = np.flatnonzero(np.isin(kinds, fetched_kinds) & is_fetchable)
    nodes, scene = file.indices, scene_rows(file.indices, file.parents())
    of_segments, of_pages = unit_gains(nodes)
    lengths = file.segments.length.astype(np.int64)
    node_of = np.repeat(np.arange(len(nodes)), [len(node.tables.segments) for node in nodes])
    paths = [node.path for node in nodes]
    # Pages that the source lacks are no units.
    listed = [
        (row, node, place)
        for row, (node, place) in enumerate(pages_in_file_order(nodes))
        if place.path in paths
    ]
    page_rows = np.array([row for row, *_ in listed], np.int64)
    kind = np.concatenate([kinds[rows], np.full(len(listed), PAGE)])
    owner = np.where(of_chunk, file.segments.owner.astype(np.int64), -1)[rows]
    chunk = np.concatenate([owner, scene.chunks + page_rows])
    size = np.concatenate([lengths[rows], [place.length for *_, place in listed]]).astype(np.int64)
    starts = np.concatenate([file.offsets[rows], [place.start for *_, place in listed]])
    end = starts.astype(np.int64) + size
    gains = np.concatenate([of_segments[rows], of_pages[page_rows]])
    listing = np.concatenate([node_of[rows], [paths.index(node.path) for _, node, _ in listed]])
    order = np.argsort(end, kind="stable")
    kind, chunk, end, size = kind[order], chunk[order], end[order], size[order]
    # All pages but the root, in file order, are those of the nodes behind the first.
    pages = np.array([-1, *np.flatnonzero(kind == PAGE).tolist()], np.int64)
    page_of = pages[listing[order].astype(np.int64)]
    dependencies = _dependencies(kind, chunk, scene.parent)
    # The first segment of the file follows the root.
    index = int(file.offsets[0]) if len(file.offsets) else file.file_length
    return Units(kind, chunk, end, size, dependencies, index, gains[order], page_of)


def _dependencies(kind: I64, chunk: I64, parent: I64) -> list[tuple[int, ...]]:
    """Return the dependencies of each unit (docs/streaming.md, 7)."""
    heads = {int(chunk[u]): u for u in np.flatnonzero(kind == SegmentKind.HEAD).tolist()}
    shapes = tuple(np.flatnonzero(kind == SegmentKind.SHAPE_CODEBOOK).tolist())
    colours = tuple(np.flatnonzero(np.isin(kind, COLOUR_BANDS)).tolist())
    dependencies: list[tuple[int, ...]] = []
    for of_kind, row in zip(kind.tolist(), chunk.tolist(), strict=True):
        above = (heads[int(parent[row])],) if row >= 0 and parent[row] >= 0 else ()
        if of_kind == SegmentKind.HEAD:
            dependencies.append(shapes + above)
        elif of_kind == PAGE:
            dependencies.append(above)
        elif of_kind == SegmentKind.TAIL:
            dependencies.append((*colours, heads[row]))
        elif of_kind == SegmentKind.REFINEMENT:
            dependencies.append((heads[row],))
        else:
            dependencies.append(())
    return dependencies


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
        urgency = priorities(trace.camera_at(chosen_at), fetched)
        unit = _next_unit(units, urgency, _by_urgency(urgency, units.listed(fetched)), missing)
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


def fetch_order(
    units: Units, priorities: Priorities, camera: Camera, present: Sequence[int] = ()
) -> list[int]:
    """Return the order in which a client at a fixed pose fetches its missing units.

    Parameters
    ----------
    units : Units
    priorities : Priorities
        Urgency of each unit.
    camera : Camera
        Pose of the client.
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
    found: list[int] = []
    tells_more = True
    while tells_more:
        there = [*present, *found]
        urgency = priorities(camera, there)
        order = _by_urgency(urgency, units.listed(there))
        tells_more = False
        while not tells_more and (unit := _next_unit(units, urgency, order, missing)) is not None:
            missing[unit] = False
            found.append(unit)
            tells_more = units.tells_more(unit)
    return found


def _by_urgency(urgency: F64, is_listed: NDArray[np.bool_]) -> I64:
    """Return the listed units of urgency above 0, by falling urgency."""
    order = np.argsort(-urgency, kind="stable")
    return order[(urgency[order] > 0.0) & is_listed[order]]


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
