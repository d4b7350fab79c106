"""A visitor's client, simulated: it asks the scheduler again and again, stops, resumes and evicts.

It is the client of docs/streaming.md, 7 to 11, which the npm package's `Visit` is, over a link
whose answers share the bandwidth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.tools.lab.scheduling.chunk_ratios import PoseRatios, along
from cogsplat.tools.lab.scheduling.poses import Pose, path
from cogsplat.tools.lab.scheduling.scheduler import Holdings, Scheduler, Unit, window_bytes

from .client import LOOK_SECONDS, Arrivals, Link, Units
from .traces import Trace

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

# docs/streaming.md, 11.
_MOST_REQUESTS: Final = 6
_REQUEST_BYTES: Final = 65_536
_OBSERVED_SECONDS: Final = 0.25
# SPEC 8.8: the first request.
_FIRST_BYTES: Final = 65_536
# A visit ends so long after its trace, at the latest: what the last pose is worth has come by then,
# or the link is too slow for it.
_MOST_WAIT_SECONDS: Final = 600.0


@dataclass(frozen=True)
class Browser:
    """What a machine adds to the times of a network.

    Parameters
    ----------
    start_seconds : float
        From the first moment of a trace to the first request.
    splats_per_second : float
        That are decoded, one chunk after the other.
    decoder_seconds : float
        From the first moment of a trace to the start of the worker that decodes.
    """

    start_seconds: float = 0.0
    splats_per_second: float = np.inf
    decoder_seconds: float = 0.0


@dataclass
class _Request:
    """Units that are asked for together: the first comes first, of which bytes were received."""

    units: list[int]
    begins: float
    received: float = 0.0


@dataclass
class _State:
    """What a client has at a moment.

    What stands in the first bytes is taken from them when it is chosen, as often as it is:
    `opening` asks for them, `brought` has come with them, and `awaited` was chosen before that.
    """

    there: set[int] = field(default_factory=set)
    received: dict[int, float] = field(default_factory=dict)
    requests: list[_Request] = field(default_factory=list)
    opening: _Request | None = None
    brought: set[int] = field(default_factory=set)
    awaited: set[int] = field(default_factory=set)

    def under_way(self) -> list[int]:
        return [unit for request in self.requests for unit in request.units]

    def all_requests(self) -> list[_Request]:
        return self.requests if self.opening is None else [self.opening, *self.requests]


def visit(
    units: Units,
    splats: Sequence[int],
    ratios: PoseRatios,
    trace: Trace,
    link: Link,
    *,
    budget_splats: int = 0,
    browser: Browser | None = None,
) -> Arrivals:
    """Simulate a visitor who goes along a trace, and stays at its end until nothing more comes.

    Parameters
    ----------
    units : Units
    splats : sequence of int
        Of each chunk.
    ratios : PoseRatios
    trace : Trace
        Its first moment is that at which the scene is opened.
    link : Link
        What the client thinks of it is right.
    budget_splats : int
        Most splats in memory; 0 for any number.
    browser : Browser, optional
        By default one that takes no time.

    Returns
    -------
    Arrivals
        When each unit had been decoded and all that it needs, and when it was thrown away; one that
        was fetched again is there several times.
    """
    run = _Run(units, splats, ratios, trace, link, budget_splats, browser or Browser())
    return run.arrivals()


class _Run:
    """One visit while it is simulated."""

    def __init__(
        self,
        units: Units,
        splats: Sequence[int],
        ratios: PoseRatios,
        trace: Trace,
        link: Link,
        budget_splats: int,
        browser: Browser,
    ) -> None:
        self._units, self._splats, self._rule = units, splats, ratios
        self._trace, self._link, self._browser = trace, link, browser
        self._budget = budget_splats
        heads = (units.kind == SegmentKind.HEAD).tolist()
        rows = zip(
            units.chunk.tolist(),
            heads,
            units.end.tolist(),
            units.size_bytes.tolist(),
            units.after,
            strict=True,
        )
        self._scheduler = Scheduler([Unit(*row) for row in rows], splats)
        self._sizes: list[int] = units.size_bytes.tolist()
        self._state = _State()
        self._rate = link.bits_per_second / 8.0
        self._ratios: F64 | None = None
        self._looked = -np.inf
        self._decoded = browser.decoder_seconds
        self._came: list[int] = []
        self._seconds: list[float] = []
        self._leaves: list[float] = []

    def arrivals(self) -> Arrivals:
        """Run it."""
        now = self._open()
        end = self._trace.seconds + _MOST_WAIT_SECONDS
        self._decide(now)
        while now < end:
            later = self._next(now)
            if later is None:
                break
            self._advance(now, later)
            now = later
            self._decide(now)
        shown = self._drawn_at()
        order = np.argsort(shown, kind="stable")
        order = order[np.isfinite(shown[order])]
        return Arrivals(
            [self._came[k] for k in order.tolist()], shown[order], np.array(self._leaves)[order]
        )

    def _drawn_at(self) -> F64:
        """Return when each arrival is of use: not before what it needs (docs/streaming.md, 11).

        Infinite where that did not come before the end. What something needs is not thrown away
        before it.
        """
        arrivals: dict[int, list[int]] = {}
        for k, unit in enumerate(self._came):
            arrivals.setdefault(unit, []).append(k)
        shown: dict[int, float] = {}

        def drawn_at(k: int) -> float:
            if k not in shown:
                seconds = self._seconds[k]
                waits = []
                for before in self._units.after[self._came[k]]:
                    stay = [j for j in arrivals.get(before, ()) if self._leaves[j] > seconds]
                    waits.append(drawn_at(stay[0]) if stay else np.inf)
                shown[k] = max([seconds, *waits])
            return shown[k]

        return np.array([drawn_at(k) for k in range(len(self._came))], np.float64)

    def _open(self) -> float:
        """Ask for the first bytes; return when the index has come with them."""
        units = self._units
        first = self._browser.start_seconds + self._link.latency
        known = first + units.opening_bytes / self._rate
        brought = np.flatnonzero(units.end <= _FIRST_BYTES)
        if len(brought):
            # What stands in front of the first unit is the index.
            self._state.opening = _Request(brought.tolist(), known)
        return known

    def _pose(self, seconds: float) -> Pose:
        return Pose.of_camera(self._trace.at(max(seconds, 0.0)))

    def _is_moving(self, now: float) -> bool:
        return now < self._trace.seconds + _OBSERVED_SECONDS + LOOK_SECONDS

    def _decide(self, now: float) -> None:
        """Do what the scheduler says."""
        if self._ratios is None or (now - self._looked >= LOOK_SECONDS and self._is_moving(now)):
            poses = path(self._pose(now), self._pose(now - _OBSERVED_SECONDS), _OBSERVED_SECONDS)
            self._ratios, self._looked = along(self._rule, poses), now
        decision = self._scheduler.decide(self._ratios, self._holdings())
        if self._stop(decision.stop) > len(decision.stop):
            self._evict(decision.evict, now)
            decision = self._scheduler.decide(self._ratios, self._holdings())
            self._stop(decision.stop)
        self._evict(decision.evict, now)
        self._ask(decision.fetch, now)
        if self._state.brought.intersection(decision.fetch):
            self._decide(now)

    def _holdings(self) -> Holdings:
        state = self._state
        received = {unit: int(size) for unit, size in state.received.items()}
        way = frozenset([*state.under_way(), *state.awaited])
        there = frozenset(state.there)
        return Holdings(there, way, received, self._budget, self._rate, self._link.latency)

    def _stop(self, units: Sequence[int]) -> int:
        """Stop requests of units; return how many units were stopped."""
        going = [r for r in self._state.requests if set(units) & set(r.units)]
        self._state.requests = [r for r in self._state.requests if r not in going]
        return sum(len(request.units) for request in going)

    def _evict(self, chunks: Sequence[int], now: float) -> None:
        state = self._state
        for unit in np.flatnonzero(np.isin(self._units.chunk, chunks)).tolist():
            state.received.pop(unit, None)
            state.awaited.discard(unit)
            for request in state.requests:
                if unit in request.units:
                    request.units.remove(unit)
            if unit in state.there:
                state.there.remove(unit)
                last = len(self._came) - 1 - self._came[::-1].index(unit)
                self._leaves[last] = now
        state.requests = [request for request in state.requests if request.units]

    def _ask(self, wanted: Sequence[int], now: float) -> None:
        """Make requests of units that lie beside each other, as far as there is room."""
        state = self._state
        most = max(_REQUEST_BYTES, self._rate * self._link.latency / _MOST_REQUESTS)
        first = [unit for unit in wanted if self._units.end[unit] <= _FIRST_BYTES]
        for unit in first:
            if unit in state.brought:
                self._arrive(unit, now)
            else:
                state.awaited.add(unit)
        left = [unit for unit in wanted if unit not in first]
        window = window_bytes(self._rate, self._link.latency)
        while left and len(state.requests) < _MOST_REQUESTS:
            if state.requests and sum(self._left(unit) for unit in state.under_way()) >= window:
                break
            together = [left.pop(0)]
            size = self._left(together[0])
            while left and self._joins(together, left[0]) and size + self._left(left[0]) <= most:
                size += self._left(left[0])
                together.append(left.pop(0))
            together.sort()
            had = state.received.get(together[0], 0.0)
            state.requests.append(_Request(together, now + self._link.latency, had))

    def _joins(self, together: Sequence[int], unit: int) -> bool:
        """Whether a unit lies beside others, without a gap."""
        start = self._units.end - self._units.size_bytes
        begins = start[unit] + self._state.received.get(unit, 0.0)
        first = min(together)
        first_byte = start[first] + self._state.received.get(first, 0.0)
        return bool(begins == self._units.end[max(together)] or self._units.end[unit] == first_byte)

    def _left(self, unit: int) -> float:
        return self._sizes[unit] - self._state.received.get(unit, 0.0)

    def _next(self, now: float) -> float | None:
        """Return when something happens next; None where nothing will."""
        requests = self._state.all_requests()
        active = [request for request in requests if request.begins <= now]
        waits = [request.begins for request in requests if request.begins > now]
        share = self._rate / max(len(active), 1)
        ends = [
            now + (self._sizes[request.units[0]] - request.received) / share for request in active
        ]
        looks = [max(self._looked + LOOK_SECONDS, now + 1e-6)] if self._is_moving(now) else []
        return min([*waits, *ends, *looks], default=None)

    def _advance(self, now: float, later: float) -> None:
        """Let bytes come; answers share the link."""
        state = self._state
        active = [request for request in state.all_requests() if request.begins <= now]
        came = (later - now) * self._rate / max(len(active), 1)
        for request in active:
            unit = request.units[0]
            request.received += came
            is_opening = request is state.opening
            if request.received < self._sizes[unit] - 1e-6:
                if not is_opening:
                    state.received[unit] = request.received
                continue
            request.units.pop(0)
            request.received = 0.0
            if is_opening:
                state.brought.add(unit)
            else:
                state.received.pop(unit, None)
            if not is_opening or unit in state.awaited:
                self._arrive(unit, later)
        state.requests = [request for request in state.requests if request.units]
        if state.opening is not None and not state.opening.units:
            state.opening = None

    def _arrive(self, unit: int, now: float) -> None:
        self._state.there.add(unit)
        self._state.awaited.discard(unit)
        chunk = int(self._units.chunk[unit])
        rows = self._splats[chunk] if chunk >= 0 else 0
        self._decoded = max(self._decoded, now) + rows / self._browser.splats_per_second
        self._came.append(unit)
        self._seconds.append(self._decoded)
        self._leaves.append(np.inf)
