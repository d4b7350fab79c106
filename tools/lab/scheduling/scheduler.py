"""What to fetch next, what to stop and what to throw away (docs/streaming.md, 7 to 9)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

# What is asked for beyond a round trip: requests never run dry, and none is made long before.
_AHEAD_SECONDS: Final = 0.25

# What is thrown away or stopped must be worth so many times less than what takes its place, or two
# chunks of nearly one worth would take turns.
_EVICT_FACTOR: Final = 2.0
_ABORT_FACTOR: Final = 16.0


@dataclass(frozen=True)
class Unit:
    """A segment that a client may fetch, in the order of the file.

    Parameters
    ----------
    chunk : int
        -1 for one that belongs to no chunk, such as a segment of a codebook.
    is_head : bool
        Whether the chunk's rows are there once it is.
    end : int
        Byte of the file behind the segment.
    size_bytes : int
    after : tuple of int
        Units that it is of no use without; the head of a chunk names that of its parent.
    """

    chunk: int
    is_head: bool
    end: int
    size_bytes: int
    after: tuple[int, ...]


@dataclass(frozen=True)
class Holdings:
    """What a client has, and its means.

    Parameters
    ----------
    there : set of int
        Units that have come.
    under_way : set of int
        Units that are asked for.
    received : mapping of int to int
        Bytes that have come of units that are not whole, under way or stopped.
    budget_splats : int
        Most splats of chunks whose heads are there or under way; 0 for any number.
    bytes_per_second : float
        What the connection is thought to bring.
    latency : float
        Seconds from a request to its first byte.
    """

    there: frozenset[int]
    under_way: frozenset[int]
    received: dict[int, int]
    budget_splats: int
    bytes_per_second: float
    latency: float


@dataclass(frozen=True)
class Decision:
    """What a client does now, in this order.

    Parameters
    ----------
    stop : list of int
        Units under way that are no longer wanted now. What has come of them stays.
    evict : list of int
        Chunks whose units are thrown away.
    fetch : list of int
        Units to ask for, the first first.
    """

    stop: list[int]
    evict: list[int]
    fetch: list[int]


def urgencies(ratios: F64, chunk: I64, end: I64) -> F64:
    """Return what a byte of each unit is thought to gain (docs/streaming.md, 7).

    Parameters
    ----------
    ratios : (c,) float64
        Of each chunk, of `chunk_ratios.along`.
    chunk : (u,) int64
        Chunk of each unit; -1 for one that belongs to none.
    end : (u,) int64
        Byte of the file behind each unit.

    Returns
    -------
    (u,) float64
    """
    of_units = np.where(chunk >= 0, ratios[np.maximum(chunk, 0)], 1.0)
    places = end.astype(np.float64)
    result: F64 = of_units / (places * places)
    return result


def window_bytes(bytes_per_second: float, latency: float) -> float:
    """Return how many bytes are kept under way, at least (docs/streaming.md, 7).

    Parameters
    ----------
    bytes_per_second : float
        What the connection is thought to bring.
    latency : float
        Seconds from a request to its first byte.

    Returns
    -------
    float
    """
    return bytes_per_second * (latency + _AHEAD_SECONDS)


def best_chain(
    order: Iterable[int],
    urgency: Sequence[float] | F64,
    size_bytes: Sequence[int] | I64,
    after: Sequence[Sequence[int]],
    is_missing: Callable[[int], bool],
) -> tuple[Sequence[int], float] | None:
    """Return the chain whose first unit is asked for next, and its worth (docs/streaming.md, 7).

    Parameters
    ----------
    order : iterable of int
        Units that may be asked for, by falling urgency.
    urgency : (u,) float
        Of all units, above 0.
    size_bytes : (u,) int
    after : sequence of sequence of int
        Units that each unit is of no use without.
    is_missing : callable
        Whether a unit is neither there nor under way.

    Returns
    -------
    chain, worth : sequence of int, float
        None where `order` is empty.

    Examples
    --------
    >>> from cogsplat.tools.lab.scheduling.scheduler import best_chain
    >>> best_chain([1, 2], [0.5, 4.0, 1.0], [10, 10, 10], [(), (0,), ()], lambda unit: True)
    ([0, 1], 2.25)
    """
    best: tuple[Sequence[int], float] | None = None
    for unit in order:
        chain = _chain(unit, after, is_missing)
        if len(chain) == 1:
            worth = float(urgency[unit])
        else:
            gain, size = 0.0, 0.0
            for part in chain:
                gain += float(urgency[part]) * float(size_bytes[part])
                size += float(size_bytes[part])
            worth = gain / size
        if best is None or worth > best[1]:
            best = chain, worth
        if len(chain) == 1:
            break
    return best


def _chain(
    unit: int, after: Sequence[Sequence[int]], is_missing: Callable[[int], bool]
) -> list[int]:
    """Return a unit behind those that it needs and that are missing."""
    out: list[int] = []
    for before in after[unit]:
        if is_missing(before):
            out += [other for other in _chain(before, after, is_missing) if other not in out]
    return [*out, unit]


class Scheduler:
    """Decides for one scene.

    Parameters
    ----------
    units : sequence of Unit
    splats : sequence of int
        Of each chunk.

    Examples
    --------
    >>> import numpy as np
    >>> from cogsplat.tools.lab.scheduling.scheduler import Holdings, Scheduler, Unit
    >>> units = [Unit(k, True, 100 * k + 100, 100, (0,) * (k > 0)) for k in range(3)]
    >>> nothing = Holdings(frozenset(), frozenset(), {}, 0, 400.0, 0.25)
    >>> Scheduler(units, [10, 10, 10]).decide(np.array([1.0, 0.1, 1.0]), nothing).fetch
    [0, 2]
    """

    def __init__(self, units: Sequence[Unit], splats: Sequence[int]) -> None:
        self._units = units
        self._splats = splats
        self._chunk = np.array([unit.chunk for unit in units], np.int64)
        self._end = np.array([unit.end for unit in units], np.int64)
        self._heads = {unit.chunk: at for at, unit in enumerate(units) if unit.is_head}
        self._of_chunk: dict[int, list[int]] = {chunk: [] for chunk in self._heads}
        for at, unit in enumerate(units):
            if unit.chunk >= 0:
                self._of_chunk[unit.chunk].append(at)

    def decide(self, ratios: F64, holdings: Holdings) -> Decision:
        """Return what to do now.

        Parameters
        ----------
        ratios : (c,) float64
            Of each chunk, of `chunk_ratios.along`.
        holdings : Holdings
        """
        urgency = urgencies(ratios, self._chunk, self._end).tolist()
        order = sorted(range(len(self._units)), key=lambda unit: (-urgency[unit], unit))
        round_ = _Round(self._units, self._splats, self._heads, self._of_chunk, urgency, holdings)
        round_.stop_what_waits(order)
        round_.make_room(math.inf, ())
        while not round_.is_full():
            best = round_.best(order)
            if best is None:
                break
            round_.want(best[0])
        return Decision(round_.stopped, round_.evicted, round_.chosen)


@dataclass
class _Held:
    """Chunks whose heads are there or coming, their splats, and what the least of them is worth."""

    chunks: set[int]
    splats: int
    least_worth: float

    def add(self, chunk: int, splats: int, worth: float) -> None:
        self.chunks.add(chunk)
        self.splats += splats
        self.least_worth = min(self.least_worth, worth)


class _Round:
    """One decision while it is made."""

    def __init__(
        self,
        units: Sequence[Unit],
        splats: Sequence[int],
        heads: dict[int, int],
        of_chunk: dict[int, list[int]],
        urgency: list[float],
        holdings: Holdings,
    ) -> None:
        self._units, self._splats, self._heads = units, splats, heads
        self._of_chunk, self._urgency, self._holdings = of_chunk, urgency, holdings
        self._there = set(holdings.there)
        self._coming = set(holdings.under_way)
        self._received = dict(holdings.received)
        self._window = window_bytes(holdings.bytes_per_second, holdings.latency)
        self._sizes = [unit.size_bytes for unit in units]
        self._after = [unit.after for unit in units]
        self._aside: set[int] = set()
        self._held: _Held | None = None
        self.stopped: list[int] = []
        self.evicted: list[int] = []
        self.chosen: list[int] = []

    def is_full(self) -> bool:
        """Whether as much is under way as the window holds."""
        left = sum(self._left(unit) for unit in self._coming)
        return left >= self._window and bool(self._coming)

    def best(self, order: Sequence[int]) -> tuple[Sequence[int], float] | None:
        """Return the chain to go on with, of units that were not set aside, and its worth."""
        units = (unit for unit in order if self._is_missing(unit) and unit not in self._aside)
        return best_chain(units, self._urgency, self._sizes, self._after, self._is_missing)

    def stop_what_waits(self, order: Sequence[int]) -> None:
        """Stop units under way that are worth far less than the best that is not."""
        best = self.best(order)
        if best is None:
            return
        _, worth = best
        worths = self._worths()
        for unit in sorted(self._holdings.under_way, key=lambda u: (worths[u], -u)):
            wait = self._left(unit) / self._holdings.bytes_per_second
            if worths[unit] * _ABORT_FACTOR >= worth:
                break
            # What would be here before another answer began is let come.
            if wait <= self._holdings.latency or self._is_needed(unit):
                continue
            self._coming.remove(unit)
            self.stopped.append(unit)

    def _worths(self) -> dict[int, float]:
        """Return what units under way are worth: as much as anything missing that needs them."""
        worths = {unit: self._urgency[unit] for unit in self._coming}
        for unit in range(len(self._units)):
            left = [unit] if self._is_missing(unit) else []
            while left:
                for before in self._units[left.pop()].after:
                    left.append(before)
                    if before in worths:
                        worths[before] = max(worths[before], self._urgency[unit])
        return worths

    def want(self, chain: Sequence[int]) -> None:
        """Choose the first unit of a chain, or set the last aside where there is no room for it."""
        first, last = self._units[chain[0]], chain[-1]
        # What was stopped or thrown away in this decision is not asked for by it again.
        is_gone = any(u in self.stopped or self._units[u].chunk in self.evicted for u in chain)
        if is_gone or (first.is_head and not self.make_room(self._keep(last), chain)):
            self._aside.add(last)
            return
        if first.is_head and self._held is not None:
            self._held.add(first.chunk, self._splats[first.chunk], self._keep(chain[0]))
        self._coming.add(chain[0])
        self.chosen.append(chain[0])

    def _keep(self, unit: int) -> float:
        """Return what it is worth to keep a unit: room costs the same wherever it stands."""
        return self._urgency[unit] * self._units[unit].end

    def _left(self, unit: int) -> int:
        return self._units[unit].size_bytes - self._received.get(unit, 0)

    def _is_missing(self, unit: int) -> bool:
        return unit not in self._there and unit not in self._coming

    def _is_needed(self, unit: int) -> bool:
        """Whether something that is there or coming is of no use without a unit."""
        return any(
            unit in after and not self._is_missing(other) for other, after in enumerate(self._after)
        )

    def _held_chunks(self) -> _Held:
        """Return the chunks whose heads are there or coming, found anew where some were evicted."""
        if self._held is None:
            chunks = {chunk for chunk, head in self._heads.items() if not self._is_missing(head)}
            least = min((self._keep(self._heads[chunk]) for chunk in chunks), default=math.inf)
            self._held = _Held(chunks, sum(self._splats[chunk] for chunk in chunks), least)
        return self._held

    def make_room(self, keep: float, chain: Sequence[int]) -> bool:
        """Evict chunks that are worth less until the first head of a chain fits.

        Parameters
        ----------
        keep : float
            What it is worth to have the chain.
        chain : sequence of int
            The first is a head; none for what a budget that was lowered still has room for.

        Returns
        -------
        bool
            False, and nothing is evicted, where not all heads of the chain would fit: a parent
            that nothing can follow would make room for others again, and so on without end.
        """
        budget = self._holdings.budget_splats
        if not budget:
            return True
        rows = [
            self._splats[unit.chunk] for unit in (self._units[u] for u in chain) if unit.is_head
        ]
        now = self._held_chunks()
        room = budget - now.splats
        if room >= sum(rows):
            return True
        # Most often there is nothing that is worth little enough, wherever it stands.
        if not now.least_worth * _EVICT_FACTOR < keep:
            return False
        held, kept = set(now.chunks), self._ancestors(chain)
        going: list[int] = []
        while room < sum(rows):
            chunk = self._least(held, kept, keep)
            if chunk is None:
                return False
            held.remove(chunk)
            going.append(chunk)
            room += self._splats[chunk]
        # The other heads take their room when they are asked for.
        while going and room - self._splats[going[-1]] >= sum(rows[:1]):
            room -= self._splats[going.pop()]
        self._held = None
        for chunk in going:
            self.evicted.append(chunk)
            for unit in self._of_chunk[chunk]:
                self._there.discard(unit)
                self._received.pop(unit, None)
                if unit in self._coming:
                    self._coming.remove(unit)
                    self.stopped.append(unit)
        return True

    def _ancestors(self, chain: Sequence[int]) -> set[int]:
        """Return the chunks of units and of all that these need."""
        found: set[int] = set()
        left = list(chain)
        while left:
            unit = left.pop()
            if self._units[unit].chunk >= 0:
                found.add(self._units[unit].chunk)
            left += self._units[unit].after
        return found

    def _least(self, held: set[int], kept: set[int], keep: float) -> int | None:
        """Return the chunk to evict first: worth least, parent of none that is held."""
        parents = {
            self._units[before].chunk
            for chunk in held
            for before in self._units[self._heads[chunk]].after
        }
        chosen = {self._units[unit].chunk for unit in self.chosen}
        open_ = [
            chunk
            for chunk in held
            if chunk not in kept
            and chunk not in parents
            and chunk not in chosen
            and self._keep(self._heads[chunk]) * _EVICT_FACTOR < keep
        ]
        if not open_:
            return None
        return min(open_, key=lambda chunk: (self._keep(self._heads[chunk]), -chunk))
