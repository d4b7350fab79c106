"""What to fetch next, what to stop and what to throw away (docs/streaming.md, 7 to 9)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

_AHEAD_SECONDS: Final = 0.25
"""What is asked for beyond a round trip: requests never run dry, and none is made long before."""

# What is thrown away or stopped must be worth so many times less than what takes its place, or two
# chunks of nearly one worth would take turns.
_EVICT_FACTOR: Final = 2.0
_ABORT_FACTOR: Final = 4.0


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
    >>> from cogsplat.codec.scheduling.scheduler import Holdings, Scheduler, Unit
    >>> units = [Unit(k, True, 100 * k + 100, 100, (0,) * (k > 0)) for k in range(3)]
    >>> nothing = Holdings(frozenset(), frozenset(), {}, 0, 400.0, 0.25)
    >>> Scheduler(units, [10, 10, 10]).decide(np.array([1.0, 0.1, 1.0]), nothing).fetch
    [0, 2]
    """

    def __init__(self, units: Sequence[Unit], splats: Sequence[int]) -> None:
        self._units = units
        self._splats = splats
        self._heads = {unit.chunk: at for at, unit in enumerate(units) if unit.is_head}
        self._of_chunk: dict[int, list[int]] = {chunk: [] for chunk in self._heads}
        for at, unit in enumerate(units):
            if unit.chunk >= 0:
                self._of_chunk[unit.chunk].append(at)

    def urgency(self, ratios: F64) -> list[float]:
        """Return what a byte of each unit is thought to gain: its ratio over its place in the file.

        Parameters
        ----------
        ratios : (c,) float64
            Of each chunk, of `chunk_ratios.along`.
        """
        chunks = ratios.tolist()
        return [(chunks[unit.chunk] if unit.chunk >= 0 else 1.0) / unit.end for unit in self._units]

    def decide(self, ratios: F64, holdings: Holdings) -> Decision:
        """Return what to do now.

        Parameters
        ----------
        ratios : (c,) float64
            Of each chunk, of `chunk_ratios.along`.
        holdings : Holdings
        """
        urgency = self.urgency(ratios)
        order = sorted(range(len(self._units)), key=lambda unit: (-urgency[unit], unit))
        round_ = _Round(self._units, self._splats, self._heads, self._of_chunk, urgency, holdings)
        round_.stop_what_waits(order)
        round_.make_room(0, math.inf, ())
        for unit in order:
            if round_.is_full():
                break
            round_.want(unit)
        return Decision(round_.stopped, round_.evicted, round_.chosen)


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
        self._window = holdings.bytes_per_second * (holdings.latency + _AHEAD_SECONDS)
        self.stopped: list[int] = []
        self.evicted: list[int] = []
        self.chosen: list[int] = []

    def is_full(self) -> bool:
        """Whether as much is under way as the window holds."""
        left = sum(self._left(unit) for unit in self._coming)
        return left >= self._window and bool(self._coming)

    def stop_what_waits(self, order: Sequence[int]) -> None:
        """Stop units under way that are worth far less than the best that is not."""
        missing = (unit for unit in order if unit not in self._there and unit not in self._coming)
        best = next(missing, None)
        if best is None:
            return
        worths = self._worths()
        for unit in sorted(self._holdings.under_way, key=lambda u: (worths[u], -u)):
            wait = self._left(unit) / self._holdings.bytes_per_second
            if worths[unit] * _ABORT_FACTOR >= self._urgency[best]:
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
            left = [] if unit in self._there or unit in self._coming else [unit]
            while left:
                for before in self._units[left.pop()].after:
                    left.append(before)
                    if before in worths:
                        worths[before] = max(worths[before], self._urgency[unit])
        return worths

    def want(self, unit: int) -> None:
        """Choose a unit behind those that it is of no use without, where there is room for it."""
        if unit in self._there or unit in self._coming:
            return
        chain = self._needed(unit)
        # What was stopped or thrown away in this decision is not asked for by it again.
        if any(u in self.stopped or self._units[u].chunk in self.evicted for u in chain):
            return
        rows = sum(self._splats[self._units[u].chunk] for u in chain if self._units[u].is_head)
        if rows and not self.make_room(rows, self._urgency[unit], chain):
            return
        self._coming.update(chain)
        self.chosen += chain

    def _left(self, unit: int) -> int:
        return self._units[unit].size_bytes - self._received.get(unit, 0)

    def _needed(self, unit: int) -> list[int]:
        """Return a unit behind those that are neither there nor coming and that it needs."""
        out: list[int] = []
        for before in self._units[unit].after:
            if before not in self._there and before not in self._coming:
                out += [other for other in self._needed(before) if other not in out]
        return [*out, unit]

    def _is_needed(self, unit: int) -> bool:
        """Whether something that is there or coming is of no use without a unit."""
        return any(
            unit in self._units[other].after and (other in self._there or other in self._coming)
            for other in range(len(self._units))
        )

    def _held(self) -> set[int]:
        """Return the chunks whose heads are there or coming."""
        return {
            chunk
            for chunk, head in self._heads.items()
            if head in self._there or head in self._coming
        }

    def make_room(self, rows: int, urgency: float, chain: Sequence[int]) -> bool:
        """Evict chunks that are worth less until so many rows fit; none where they would not.

        Parameters
        ----------
        rows : int
            0 for what a budget that was lowered still has room for.
        urgency : float
            Of what the rows are of.
        chain : sequence of int
            Units that bring the rows.
        """
        budget = self._holdings.budget_splats
        if not budget:
            return True
        held = self._held()
        used = sum(self._splats[chunk] for chunk in held)
        kept = self._ancestors(chain)
        going: list[int] = []
        while used + rows > budget:
            chunk = self._least(held, kept, urgency)
            if chunk is None:
                return False
            held.remove(chunk)
            used -= self._splats[chunk]
            going.append(chunk)
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

    def _least(self, held: set[int], kept: set[int], urgency: float) -> int | None:
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
            and self._urgency[self._heads[chunk]] * _EVICT_FACTOR < urgency
        ]
        if not open_:
            return None
        return min(open_, key=lambda chunk: (self._urgency[self._heads[chunk]], -chunk))
