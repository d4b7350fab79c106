"""Simulation of the npm package's `Visit`: concurrent requests driven by the scheduler.

The client follows docs/streaming.md, 7 to 11. Responses share the bandwidth of the link equally.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.tools.lab.scheduling.chunk_ratios import weighted_ratios
from cogsplat.tools.lab.scheduling.poses import Pose, predicted_poses
from cogsplat.tools.lab.scheduling.scheduler import (
    EVICTED_SECONDS,
    ClientState,
    Decision,
    Scheduler,
    Unit,
    window_bytes,
)

from .client import CHUNK_KINDS, DECISION_INTERVAL, PAGE, Arrivals, Link, Units
from .policies import ClientRatios
from .traces import Trace

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

# docs/streaming.md, 11.
_MAX_REQUEST_BYTES: Final = 65_536
_OBSERVED_SECONDS: Final = 0.25
# Size of the first request (SPEC 8.8).
_FIRST_BYTES: Final = 65_536
# Time limit of the simulation after the end of the trace.
_MAX_WAIT_SECONDS: Final = 600.0


@dataclass(frozen=True)
class Browser:
    """Delays of a browser, added to the delays of the network.

    Parameters
    ----------
    start_seconds : float
        Time from the start of the trace to the first request.
    splats_per_second : float
        Decoding throughput; chunks are decoded one after the other.
    decoder_seconds : float
        Time from the start of the trace to the start of the decoding worker.
    """

    start_seconds: float = 0.0
    splats_per_second: float = np.inf
    decoder_seconds: float = 0.0


@dataclass
class _Request:
    """Request of adjacent units; `units` loses each unit once it is complete.

    The first byte arrives at `starts_at`; `received` counts the bytes of the first remaining unit.
    """

    units: list[int]
    starts_at: float
    received: float = 0.0


@dataclass
class _State:
    """Units and requests of a client.

    Units within the first bytes of the file are read from that buffer, again after an eviction.
    `first_request` fetches the buffer, and `buffered` are its units received. `awaited` are units
    chosen before they were received; at first, these are the root's units in the buffer, as far as
    the budget has room for their splats.
    `evicted` has the time and the worth of the last eviction of each chunk.
    """

    present: set[int] = field(default_factory=set)
    received: dict[int, float] = field(default_factory=dict)
    requests: list[_Request] = field(default_factory=list)
    first_request: _Request | None = None
    buffered: set[int] = field(default_factory=set)
    awaited: set[int] = field(default_factory=set)
    evicted: dict[int, tuple[float, float]] = field(default_factory=dict)

    def in_flight(self) -> list[int]:
        """Return the units of all requests except the first."""
        return [unit for request in self.requests for unit in request.units]

    def all_requests(self) -> list[_Request]:
        """Return the requests in flight, the first request of the file included."""
        if self.first_request is None:
            return self.requests
        return [self.first_request, *self.requests]


def simulate_visit(
    units: Units,
    splats: Sequence[int],
    contribution: F64,
    ratios: ClientRatios,
    trace: Trace,
    link: Link,
    *,
    budget_splats: int = 0,
    browser: Browser | None = None,
    until: float | None = None,
) -> Arrivals:
    """Simulate the client along a trace, and at its end until all fetches are complete.

    Parameters
    ----------
    units : Units
    splats : sequence of int
        Splat count of each chunk, and by which each page counts in a budget.
    contribution : (r,) float64
        Stored contribution of each chunk and page.
    ratios : ClientRatios
        Visibility ratios of the chunks and pages at a pose.
    trace : Trace
        Camera path; the scene is opened at its start.
    link : Link
        Link, whose bandwidth and latency the client estimates exactly.
    budget_splats : int
        Memory limit, splats; 0 for no limit.
    browser : Browser, optional
        Machine; by default one without delays.
    until : float, optional
        Time at which the simulation ends in any case, s; by default 600 s after the trace.

    Returns
    -------
    Arrivals
        Time at which each unit and its dependencies are decoded, and time of its eviction.
    """
    run = _Run(
        units, splats, contribution, ratios, trace, link, budget_splats, browser or Browser()
    )
    return run.arrivals(trace.seconds + _MAX_WAIT_SECONDS if until is None else until)


def scheduled_units(units: Units, present: Collection[int]) -> tuple[list[int], list[Unit]]:
    """Return the units that a client schedules: all listed ones but the pages that it has read.

    Parameters
    ----------
    units : Units
    present : collection of int
        Units that the client has.

    Returns
    -------
    listed, rows : list of int, list of Unit
        Numbers of the units, and the units as the scheduler takes them.
    """
    is_read = (units.kind == PAGE) & np.isin(np.arange(len(units)), list(present))
    listed = np.flatnonzero(units.listed(present) & ~is_read).tolist()
    number = {unit: k for k, unit in enumerate(listed)}
    columns = (units.row, units.is_head, units.gain, units.size_bytes)
    rows = [
        Unit(row, head, gain, size, tuple(number[other] for other in units.dependencies[unit]))
        for unit, row, head, gain, size in zip(
            listed, *(column[listed].tolist() for column in columns), strict=True
        )
    ]
    return listed, rows


class _Run:
    """Event loop of one simulated visit."""

    def __init__(
        self,
        units: Units,
        splats: Sequence[int],
        contribution: F64,
        ratios: ClientRatios,
        trace: Trace,
        link: Link,
        budget_splats: int,
        browser: Browser,
    ) -> None:
        self._units, self._splats, self._ratios_at = units, splats, ratios
        self._trace, self._link, self._browser = trace, link, browser
        self._contribution: list[float] = contribution.tolist()
        self._budget = budget_splats
        self._sizes: list[int] = units.size_bytes.tolist()
        self._state = _State()
        self._rate = link.bits_per_second / 8.0
        self._scheduler: Scheduler | None = None
        # Units that the scheduler knows, by their numbers there, and back.
        self._listed: list[int] = []
        self._number: dict[int, int] = {}
        self._ratios: F64 | None = None
        self._decided_at = -np.inf
        self._decoder_free_at = browser.decoder_seconds
        self._fetched: list[int] = []
        self._seconds: list[float] = []
        self._evicted_at: list[float] = []
        self._requested_at: list[float] = [browser.start_seconds]

    def arrivals(self, end: float) -> Arrivals:
        """Run the simulation up to a time."""
        now = self._open()
        self._decide(now)
        while now < end:
            later = self._next_event(now)
            if later is None:
                break
            self._advance(now, later)
            now = later
            self._decide(now)
        usable_at = self._usable_at()
        order = np.argsort(usable_at, kind="stable")
        order = order[np.isfinite(usable_at[order])]
        return Arrivals(
            [self._fetched[k] for k in order.tolist()],
            usable_at[order],
            np.array(self._evicted_at)[order],
            np.array(self._requested_at),
        )

    def _usable_at(self) -> F64:
        """Return the time from which each arrival can be drawn (docs/streaming.md, 11).

        A unit can be drawn once it and its dependencies have arrived. The time is infinite if a
        dependency never arrives. Dependencies are never evicted before their dependents.
        """
        arrivals: dict[int, list[int]] = {}
        for k, unit in enumerate(self._fetched):
            arrivals.setdefault(unit, []).append(k)
        usable: dict[int, float] = {}

        def usable_at(k: int) -> float:
            if k not in usable:
                seconds = self._seconds[k]
                waits = []
                for dependency in self._units.dependencies[self._fetched[k]]:
                    stay = [
                        j for j in arrivals.get(dependency, ()) if self._evicted_at[j] > seconds
                    ]
                    waits.append(usable_at(stay[0]) if stay else np.inf)
                usable[k] = max([seconds, *waits])
            return usable[k]

        return np.array([usable_at(k) for k in range(len(self._fetched))], np.float64)

    def _open(self) -> float:
        """Request the first bytes; return the time at which the index has arrived."""
        units = self._units
        first_byte = self._browser.start_seconds + self._link.latency
        index_at = first_byte + units.index_bytes / self._rate
        buffered = np.flatnonzero(units.end <= _FIRST_BYTES)
        if len(buffered):
            # The index precedes the first unit.
            self._state.first_request = _Request(buffered.tolist(), index_at)
        room = float(self._budget or np.inf)
        is_head = units.is_head
        for unit in buffered[units.listed(())[buffered]].tolist():
            splats = self._splats[units.row[unit]] if is_head[unit] else 0
            if splats <= room and self._state.awaited.issuperset(units.dependencies[unit]):
                self._state.awaited.add(unit)
                room -= splats
        return index_at

    def _pose(self, seconds: float) -> Pose:
        """Return the pose at a time of the trace."""
        return Pose.from_camera(self._trace.camera_at(max(seconds, 0.0)))

    def _is_moving(self, now: float) -> bool:
        """Whether the predicted poses can still change."""
        return now < self._trace.seconds + _OBSERVED_SECONDS + DECISION_INTERVAL

    def _decide(self, now: float) -> None:
        """Run the scheduler and execute its decision."""
        if self._scheduler is None:
            self._scheduler = self._enter_indices()
        if self._ratios is None or (
            now - self._decided_at >= DECISION_INTERVAL and self._is_moving(now)
        ):
            before = self._pose(now - _OBSERVED_SECONDS)
            poses = predicted_poses(self._pose(now), before, _OBSERVED_SECONDS)
            present = self._state.present
            self._ratios = weighted_ratios(lambda pose: self._ratios_at(pose, present), poses)
            self._decided_at = now
        decision = self._decision(self._scheduler, self._ratios, now)
        if self._abort(decision.abort) > len(decision.abort):
            self._evict(decision.evict, now)
            decision = self._decision(self._scheduler, self._ratios, now)
            self._abort(decision.abort)
        self._evict(decision.evict, now)
        self._request(decision.fetch, now)
        if self._state.buffered.intersection(decision.fetch):
            self._decide(now)

    def _enter_indices(self) -> Scheduler:
        """Return a scheduler of the units that the root and the pages read list."""
        self._listed, rows = scheduled_units(self._units, self._state.present)
        self._number = {unit: number for number, unit in enumerate(self._listed)}
        return Scheduler(rows, self._splats, self._contribution)

    def _decision(self, scheduler: Scheduler, ratios: F64, now: float) -> Decision:
        """Return the scheduler's decision, for the units of the file."""
        decision = scheduler.decide(ratios, self._client_state(now))
        abort, fetch = (
            [self._listed[k] for k in found] for found in (decision.abort, decision.fetch)
        )
        return Decision(abort, decision.evict, fetch)

    def _client_state(self, now: float) -> ClientState:
        """Return the input of the scheduler."""
        state, number = self._state, self._number
        received = {number[unit]: int(size) for unit, size in state.received.items()}
        in_flight = frozenset(number[unit] for unit in [*state.in_flight(), *state.awaited])
        present = frozenset(number[unit] for unit in state.present if unit in number)
        worths = {
            chunk: worth
            for chunk, (seconds, worth) in state.evicted.items()
            if now < seconds + EVICTED_SECONDS
        }
        return ClientState(
            present, in_flight, received, self._budget, self._rate, self._link.latency, worths
        )

    def _abort(self, units: Sequence[int]) -> int:
        """Abort the requests that contain units; return the number of units they contain."""
        aborted = [r for r in self._state.requests if set(units) & set(r.units)]
        self._state.requests = [r for r in self._state.requests if r not in aborted]
        return sum(len(request.units) for request in aborted)

    def _evict(self, worths: Mapping[int, float], now: float) -> None:
        """Drop the units of chunks, also from requests."""
        state = self._state
        state.evicted.update({chunk: (now, worth) for chunk, worth in worths.items()})
        for unit in np.flatnonzero(np.isin(self._units.row, list(worths))).tolist():
            state.received.pop(unit, None)
            state.awaited.discard(unit)
            for request in state.requests:
                if unit in request.units:
                    request.units.remove(unit)
            if unit in state.present:
                state.present.remove(unit)
                last = len(self._fetched) - 1 - self._fetched[::-1].index(unit)
                self._evicted_at[last] = now
        state.requests = [request for request in state.requests if request.units]

    def _request(self, chosen: Sequence[int], now: float) -> None:
        """Request chosen units, joining adjacent ones, until the window is full."""
        state = self._state
        link = self._link
        max_bytes = max(_MAX_REQUEST_BYTES, self._rate * link.latency / link.most_requests)
        in_buffer = [unit for unit in chosen if self._units.end[unit] <= _FIRST_BYTES]
        for unit in in_buffer:
            if unit in state.buffered:
                self._arrive(unit, now)
            else:
                state.awaited.add(unit)
        queue = [unit for unit in chosen if unit not in in_buffer]
        window = window_bytes(self._rate, link.latency)
        while queue and len(state.requests) < link.most_requests:
            if (
                state.requests
                and sum(self._remaining_bytes(unit) for unit in state.in_flight()) >= window
            ):
                break
            together = [queue.pop(0)]
            size = self._remaining_bytes(together[0])
            while (
                queue
                and self._is_adjacent(together, queue[0])
                and size + self._remaining_bytes(queue[0]) <= max_bytes
            ):
                size += self._remaining_bytes(queue[0])
                together.append(queue.pop(0))
            together.sort()
            received = state.received.get(together[0], 0.0)
            state.requests.append(_Request(together, now + self._link.latency, received))
            self._requested_at.append(now)

    def _is_adjacent(self, together: Sequence[int], unit: int) -> bool:
        """Whether a unit directly precedes or follows a range of units in the file."""
        start = self._units.end - self._units.size_bytes
        first_missing = start[unit] + self._state.received.get(unit, 0.0)
        first = min(together)
        first_byte = start[first] + self._state.received.get(first, 0.0)
        return bool(
            first_missing == self._units.end[max(together)] or self._units.end[unit] == first_byte
        )

    def _remaining_bytes(self, unit: int) -> float:
        """Return the bytes of a unit that are not received yet."""
        return self._sizes[unit] - self._state.received.get(unit, 0.0)

    def _next_event(self, now: float) -> float | None:
        """Return the time of the next event; None if there is none."""
        requests = self._state.all_requests()
        active = [request for request in requests if request.starts_at <= now]
        starts = [request.starts_at for request in requests if request.starts_at > now]
        share = self._rate / max(len(active), 1)
        ends = [
            now + (self._sizes[request.units[0]] - request.received) / share for request in active
        ]
        decisions = (
            [max(self._decided_at + DECISION_INTERVAL, now + 1e-6)] if self._is_moving(now) else []
        )
        # An evicted chunk may be fetched again then, also for a pose that rests.
        expiries = [seconds + EVICTED_SECONDS for seconds, _ in self._state.evicted.values()]
        later = [seconds for seconds in expiries if seconds > now]
        return min([*starts, *ends, *decisions, *later], default=None)

    def _advance(self, now: float, later: float) -> None:
        """Transfer bytes until a time, with equal shares of the link for all responses."""
        state = self._state
        active = [request for request in state.all_requests() if request.starts_at <= now]
        transferred = (later - now) * self._rate / max(len(active), 1)
        for request in active:
            unit = request.units[0]
            request.received += transferred
            is_first_request = request is state.first_request
            if request.received < self._sizes[unit] - 1e-6:
                if not is_first_request:
                    state.received[unit] = request.received
                continue
            request.units.pop(0)
            request.received = 0.0
            if is_first_request:
                state.buffered.add(unit)
            else:
                state.received.pop(unit, None)
            if not is_first_request or unit in state.awaited:
                self._arrive(unit, later)
        state.requests = [request for request in state.requests if request.units]
        if state.first_request is not None and not state.first_request.units:
            state.first_request = None

    def _arrive(self, unit: int, now: float) -> None:
        """Add a received unit and queue it for decoding."""
        self._state.present.add(unit)
        self._state.awaited.discard(unit)
        if self._units.tells_more(unit):
            self._scheduler, self._ratios = None, None
        is_decoded = self._units.kind[unit] in CHUNK_KINDS
        rows = self._splats[int(self._units.row[unit])] if is_decoded else 0
        self._decoder_free_at = (
            max(self._decoder_free_at, now) + rows / self._browser.splats_per_second
        )
        self._fetched.append(unit)
        self._seconds.append(self._decoder_free_at)
        self._evicted_at.append(np.inf)
