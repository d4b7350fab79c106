"""Scheduler: which units to fetch, abort and evict next (docs/streaming.md, 7 to 9)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

# Data in flight beyond bandwidth x latency. More would be chosen before the pages and view tables
# have arrived that tell what is visible; less would let the connection run idle. 0.25 s shows 1 to
# 2 dB less in the first second in a city and on paths through a house (docs/ablations.md).
_MARGIN_SECONDS: Final = 0.1

# Hysteresis: an evicted chunk or aborted unit must be worth less than its replacement by this
# factor. Without it, two chunks of similar value would replace each other in turn.
_HELD_FACTOR: Final = 2.0
_ABORT_FACTOR: Final = 16.0

EVICTED_SECONDS: Final = 1.0
"""Time after an eviction within which a chunk is fetched again only if its worth has doubled."""


@dataclass(frozen=True)
class Unit:
    """A segment or page that a client may fetch; units are numbered in the order of the file.

    Parameters
    ----------
    row : int
        Row of the chunk or page (`scene_rows.SceneRows`); -1 for a segment of no chunk, such as a
        codebook.
    is_head : bool
        Whether it is the head of the chunk, or the page.
    gain : float
        Gain for an average picture (docs/streaming.md, 7), in the unit of contributions.
    size_bytes : int
        Length of the segment.
    dependencies : tuple of int
        Units required to decode or draw the segment; for a head, the head of the parent chunk.
    """

    row: int
    is_head: bool
    gain: float
    size_bytes: int
    dependencies: tuple[int, ...]


@dataclass(frozen=True)
class ClientState:
    """Units that a client has or has requested, its budget and its connection.

    Parameters
    ----------
    present : set of int
        Units received completely.
    in_flight : set of int
        Units requested and not received completely.
    received : mapping of int to int
        Bytes received of incomplete units, in flight or aborted.
    budget_splats : int
        Limit on the splats of chunks whose heads are present or in flight; 0 for no limit.
    bytes_per_second : float
        Estimated bandwidth.
    latency : float
        Estimated time from a request to its first byte, s.
    evicted_worths : dict of int to float
        Worth, at its eviction, of each chunk evicted in the last `EVICTED_SECONDS`.
    """

    present: frozenset[int]
    in_flight: frozenset[int]
    received: dict[int, int]
    budget_splats: int
    bytes_per_second: float
    latency: float
    evicted_worths: dict[int, float]


@dataclass(frozen=True)
class Decision:
    """Actions of a client, in the order of execution.

    Parameters
    ----------
    abort : list of int
        Units in flight whose requests are aborted; bytes received so far are kept.
    evict : dict of int to float
        Chunks whose units are dropped from memory, in order, and their worth.
    fetch : list of int
        Units to request, by falling priority.
    """

    abort: list[int]
    evict: dict[int, float]
    fetch: list[int]


def urgencies(ratios: F64, row: I64, gain_per_byte: F64) -> F64:
    """Estimate the gain per byte of each unit at the current pose (docs/streaming.md, 7).

    Parameters
    ----------
    ratios : (r,) float64
        Visibility ratio of each row (`chunk_ratios.weighted_ratios`).
    row : (u,) int64
        Row of each unit; -1 for none.
    gain_per_byte : (u,) float64
        Gain of each unit ÷ its bytes (`Unit`).

    Returns
    -------
    (u,) float64
    """
    of_units = np.where(row >= 0, ratios[np.maximum(row, 0)], 1.0)
    result: F64 = of_units * np.minimum(of_units, 1.0) * gain_per_byte
    return result


def window_bytes(bytes_per_second: float, latency: float) -> float:
    """Return the minimum amount of data to keep in flight (docs/streaming.md, 7).

    Parameters
    ----------
    bytes_per_second : float
        Estimated bandwidth.
    latency : float
        Estimated time from a request to its first byte, s.

    Returns
    -------
    float
        Bytes.
    """
    return bytes_per_second * (latency + _MARGIN_SECONDS)


def best_chain(
    order: Iterable[int],
    urgency: Sequence[float] | F64,
    size_bytes: Sequence[int] | I64,
    dependencies: Sequence[Sequence[int]],
    is_missing: Callable[[int], bool],
) -> tuple[Sequence[int], float] | None:
    """Find the most valuable chain: a unit preceded by its missing dependencies (section 7).

    Parameters
    ----------
    order : iterable of int
        Candidate units, by falling urgency.
    urgency : (u,) float
        Urgency of every unit, at least 0.
    size_bytes : (u,) int
        Size of every unit.
    dependencies : sequence of sequence of int
        Direct dependencies of every unit.
    is_missing : callable
        Whether a unit still has to be requested.

    Returns
    -------
    chain, value : sequence of int, float
        The chain, to be fetched from its first unit on, and its mean urgency per byte. None if
        `order` is empty.

    Examples
    --------
    >>> from cogsplat.tools.lab.scheduling.scheduler import best_chain
    >>> best_chain([1, 2], [0.5, 4.0, 1.0], [10, 10, 10], [(), (0,), ()], lambda unit: True)
    ([0, 1], 2.25)
    """
    best: tuple[Sequence[int], float] | None = None
    for unit in order:
        chain = _chain(unit, dependencies, is_missing)
        if len(chain) == 1:
            value = float(urgency[unit])
        else:
            gain, size = 0.0, 0.0
            for part in chain:
                gain += float(urgency[part]) * float(size_bytes[part])
                size += float(size_bytes[part])
            value = gain / size
        if best is None or value > best[1]:
            best = chain, value
        if len(chain) == 1:
            break
    return best


def _chain(
    unit: int, dependencies: Sequence[Sequence[int]], is_missing: Callable[[int], bool]
) -> list[int]:
    """Return the missing transitive dependencies of a unit in fetch order, then the unit."""
    out: list[int] = []
    for dependency in dependencies[unit]:
        if is_missing(dependency):
            chain = _chain(dependency, dependencies, is_missing)
            out += [other for other in chain if other not in out]
    return [*out, unit]


class _Links:
    """Units of each chunk, its parent, and what depends on each unit, looked up once.

    Parameters
    ----------
    units : sequence of Unit

    Attributes
    ----------
    rows : list of int
        Rows of chunks and unread pages, ascending: parents precede their children.
    head_of : dict of int to int
        Number of the unit that is the head of each row.
    parent_of : dict of int to int
        Row of the parent of each row, on whose head its head depends; -1 for none.
    units_of : dict of int to list of int
        Numbers of all units of each row.
    sizes : list of int
        Size of each unit, bytes.
    dependencies, dependents : list of sequence of int
        Units that each unit depends on, and units that depend on it, directly.
    """

    def __init__(self, units: Sequence[Unit]) -> None:
        self.head_of = {unit.row: at for at, unit in enumerate(units) if unit.is_head}
        self.rows = sorted(self.head_of)
        self.units_of: dict[int, list[int]] = {row: [] for row in self.rows}
        self.sizes = [unit.size_bytes for unit in units]
        self.dependencies = [unit.dependencies for unit in units]
        self.dependents: list[list[int]] = [[] for _ in units]
        for at, unit in enumerate(units):
            if unit.row >= 0:
                self.units_of[unit.row].append(at)
            for dependency in unit.dependencies:
                self.dependents[dependency].append(at)
        self.parent_of = {
            row: max((units[other].row for other in units[head].dependencies), default=-1)
            for row, head in self.head_of.items()
        }


class Scheduler:
    """Scheduler for the units of one scene.

    Parameters
    ----------
    units : sequence of Unit
        All units, in the order of the file.
    splats : sequence of int
        Splat count of each row.
    contribution : sequence of float
        Stored contribution of each row.

    Examples
    --------
    >>> import numpy as np
    >>> from cogsplat.tools.lab.scheduling.scheduler import ClientState, Scheduler, Unit
    >>> units = [Unit(k, True, 3.0 - k, 100, (0,) * (k > 0)) for k in range(3)]
    >>> empty = ClientState(frozenset(), frozenset(), {}, 0, 400.0, 0.25, {})
    >>> Scheduler(units, [10] * 3, [1.0] * 3).decide(np.array([1.0, 0.1, 1.0]), empty).fetch
    [0, 2]
    """

    def __init__(
        self, units: Sequence[Unit], splats: Sequence[int], contribution: Sequence[float]
    ) -> None:
        self._units = units
        self._splats = splats
        self._contribution = np.array(contribution, np.float64)
        self._links = _Links(units)
        self._row = np.array([unit.row for unit in units], np.int64)
        gains = [unit.gain / float(unit.size_bytes) for unit in units]
        self._gain_per_byte = np.array(gains, np.float64)

    def decide(self, ratios: F64, state: ClientState) -> Decision:
        """Decide which units to abort, evict and fetch.

        Parameters
        ----------
        ratios : (c,) float64
            Visibility ratio of each chunk (`chunk_ratios.weighted_ratios`).
        state : ClientState
        """
        urgency = urgencies(ratios, self._row, self._gain_per_byte)
        shares: list[float] = (ratios * self._contribution).tolist()
        round_ = _Round(self._units, self._splats, self._links, self._row, shares, urgency, state)
        round_.make_room(0)
        round_.abort_outranked()
        while not round_.is_window_full():
            best = round_.best_chain()
            if best is None:
                break
            round_.request_first(best[0])
        return Decision(round_.aborted, round_.evicted, round_.chosen)


class _Round:
    """Working state of one decision."""

    def __init__(
        self,
        units: Sequence[Unit],
        splats: Sequence[int],
        links: _Links,
        row: I64,
        shares: Sequence[float],
        urgency: F64,
        state: ClientState,
    ) -> None:
        self._units, self._splats, self._links, self._row = units, splats, links, row
        # By row: its share of the picture, in the unit of contributions.
        self._shares = shares
        self._order = np.argsort(-urgency, kind="stable")
        self._urgency: list[float] = urgency.tolist()
        self._state = state
        # By unit: whether it is present or in flight.
        self._held = bytearray(len(units))
        for unit in (*state.present, *state.in_flight):
            self._held[unit] = 1
        self._in_flight = set(state.in_flight)
        self._received = dict(state.received)
        self._window = window_bytes(state.bytes_per_second, state.latency)
        self._skipped: set[int] = set()
        self._worth: dict[int, float] = {}
        self._target, self._evictable = self._choose_target()
        self._held_splats = sum(splats[chunk] for chunk in links.rows if self._is_held(chunk))
        self._candidates = self._wanted()
        self.aborted: list[int] = []
        self.evicted: dict[int, float] = {}
        self.chosen: list[int] = []

    def _choose_target(self) -> tuple[set[int] | None, list[int]]:
        """Choose the chunks to hold within the budget (section 9).

        Returns
        -------
        target, evictable : set of int or None, list of int
            The chunks to hold, None for all; and the other chunks held, in the order of their
            eviction.
        """
        if not self._state.budget_splats:
            return None, []
        worth, links = self._worth, self._links
        for chunk in links.rows:
            head = links.head_of[chunk]
            factor = _HELD_FACTOR if self._held[head] else 1.0
            worth[chunk] = self._shares[chunk] / float(max(self._splats[chunk], 1)) * factor
        for chunk in reversed(links.rows):
            parent = links.parent_of[chunk]
            if parent >= 0:
                worth[parent] = max(worth[parent], worth[chunk])
        order = sorted(links.rows, key=lambda chunk: (-worth[chunk], chunk))
        target = {-1}
        room = self._state.budget_splats
        for chunk in order:
            if links.parent_of[chunk] not in target or self._splats[chunk] > room:
                continue
            least = 0.0 if self._is_held(chunk) else self._state.evicted_worths.get(chunk, 0.0)
            if worth[chunk] >= least:
                target.add(chunk)
                room -= self._splats[chunk]
        evictable = [chunk for chunk in order[::-1] if self._is_held(chunk) and chunk not in target]
        return target - {-1}, evictable

    def _wanted(self) -> list[int]:
        """Return the missing units of chunks to hold and of no chunk, by falling urgency."""
        is_wanted = np.frombuffer(self._held, np.uint8) == 0
        if self._target is not None:
            is_wanted &= (self._row < 0) | np.isin(self._row, list(self._target))
        wanted: list[int] = self._order[is_wanted[self._order]].tolist()
        return wanted

    def is_window_full(self) -> bool:
        """Whether the bytes in flight reach the window."""
        remaining = sum(self._remaining_bytes(unit) for unit in self._in_flight)
        return remaining >= self._window and bool(self._in_flight)

    def best_chain(self) -> tuple[Sequence[int], float] | None:
        """Return the best chain and its value, without units skipped in this decision."""
        units = (
            unit for unit in self._candidates if not self._held[unit] and unit not in self._skipped
        )
        links = self._links
        return best_chain(units, self._urgency, links.sizes, links.dependencies, self._is_missing)

    def abort_outranked(self) -> None:
        """Abort units in flight whose value is far below that of the best missing unit."""
        best = self.best_chain()
        if best is None:
            return
        _, best_value = best
        values = self._in_flight_values()
        for unit in sorted(self._in_flight, key=lambda u: (values[u], -u)):
            transfer_seconds = self._remaining_bytes(unit) / self._state.bytes_per_second
            if values[unit] * _ABORT_FACTOR >= best_value:
                break
            # A unit that completes before a new response could start is not worth aborting.
            if transfer_seconds <= self._state.latency or self._is_required(unit):
                continue
            self._abort(unit)
        if self.aborted:
            self._candidates = self._wanted()

    def _abort(self, unit: int) -> None:
        self._held[unit] = 0
        self._in_flight.remove(unit)
        self.aborted.append(unit)
        if self._units[unit].is_head:
            self._held_splats -= self._splats[self._units[unit].row]

    def _in_flight_values(self) -> dict[int, float]:
        """Return per unit in flight the largest urgency of itself and its missing dependents."""
        known: dict[int, float] = {}

        def of_dependents(unit: int) -> float:
            if unit not in known:
                known[unit] = 0.0
                for other in self._links.dependents[unit]:
                    own = 0.0 if self._held[other] else self._urgency[other]
                    known[unit] = max(known[unit], own, of_dependents(other))
            return known[unit]

        return {unit: max(self._urgency[unit], of_dependents(unit)) for unit in self._in_flight}

    def request_first(self, chain: Sequence[int]) -> None:
        """Choose the first unit of a chain, after evictions for a head without room."""
        # Units aborted in this decision are not requested again by it.
        if any(unit in self.aborted for unit in chain):
            self._skipped.add(chain[-1])
            return
        first = self._units[chain[0]]
        if first.is_head:
            self.make_room(self._splats[first.row])
            self._held_splats += self._splats[first.row]
        self._held[chain[0]] = 1
        self._in_flight.add(chain[0])
        self.chosen.append(chain[0])

    def make_room(self, splats: int) -> None:
        """Evict chunks outside the target until `splats` more splats fit the budget.

        Parameters
        ----------
        splats : int
            Splats of the next chunk of the target; 0 to enforce a budget that was lowered.
        """
        while self._evictable and self._held_splats + splats > self._state.budget_splats:
            chunk = self._evictable.pop(0)
            # A head in flight may have been aborted.
            if not self._is_held(chunk):
                continue
            self.evicted[chunk] = self._worth[chunk]
            for unit in self._links.units_of[chunk]:
                if unit in self._in_flight:
                    self._abort(unit)
                elif self._held[unit] and self._units[unit].is_head:
                    self._held_splats -= self._splats[chunk]
                self._held[unit] = 0
                self._received.pop(unit, None)

    def _remaining_bytes(self, unit: int) -> int:
        return self._units[unit].size_bytes - self._received.get(unit, 0)

    def _is_held(self, chunk: int) -> bool:
        """Whether the head of a chunk is present or in flight."""
        return bool(self._held[self._links.head_of[chunk]])

    def _is_missing(self, unit: int) -> bool:
        return not self._held[unit]

    def _is_required(self, unit: int) -> bool:
        """Whether a unit that is present or in flight depends on this one."""
        return any(self._held[other] for other in self._links.dependents[unit])
