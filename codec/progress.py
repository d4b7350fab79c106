"""How long work reports: one callback, which may also stop it."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final

Progress = Callable[[str, int, int], None]
"""``progress(stage, done, total)``; raising `Cancelled` from it stops the work."""


def silent(stage: str, done: int, total: int) -> None:
    """Report nothing."""


class TimedProgress:
    """A `Progress` that adds up the seconds of every stage and passes each report on.

    The time between two reports belongs to the stage that reports second, so that the seconds of
    all stages add up to the time of the whole work. Processor time is counted beside it.

    Parameters
    ----------
    progress : Progress
        Receives every report.

    Attributes
    ----------
    seconds : dict of str to float
        Wall-clock time by stage, in the order in which the stages began.
    cpu_seconds : dict of str to float
        Processor time of all threads of this process by stage, in the same order. Divided by the
        wall-clock time it says how many cores a stage kept busy. Other processes do not count.
    totals : dict of str to int
        Steps that each stage announced.
    """

    def __init__(self, progress: Progress = silent) -> None:
        self.seconds: dict[str, float] = {}
        self.cpu_seconds: dict[str, float] = {}
        self.totals: dict[str, int] = {}
        self._progress = progress
        self.restart()

    def restart(self) -> None:
        """Leave out the time since the last report: the next stage begins now."""
        self._last = time.monotonic(), time.process_time()

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Add the time since the last report to a stage and pass the report on."""
        now, now_cpu = time.monotonic(), time.process_time()
        last, last_cpu = self._last
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - last
        self.cpu_seconds[stage] = self.cpu_seconds.get(stage, 0.0) + now_cpu - last_cpu
        self.totals[stage] = total
        self._last = now, now_cpu
        self._progress(stage, done, total)


@dataclass(frozen=True)
class StageCost:
    """What a stage is expected to cost, in any unit that all stages of the work share.

    Parameters
    ----------
    stage : str
        As it is reported.
    cost : float
        Of each step that is counted in `steps`, or of the whole stage where that is None.
    steps : int or None
        Steps expected; what the stage reports counts once it has begun.
    inner : str
        For a search, whose trials nobody knows in advance: the stage that each trial goes through
        again. Empty for others.
    parts : tuple of tuple of StageCost
        For a stage each of whose steps goes through stages of its own, such as one that writes and
        measures several files: the stages of each step. Their costs count, and `cost` is 0. Other
        stages that are reported while such a stage works are those of its step.
    """

    stage: str
    cost: float
    steps: int | None = None
    inner: str = ""
    parts: tuple[tuple[StageCost, ...], ...] = ()

    def whole(self, steps: int | None = None) -> float:
        """Return the cost of the whole stage, with as many steps as it reports."""
        if self.parts:
            return sum(cost.whole() for part in self.parts for cost in part)
        expected = self.steps if self.steps is None or steps is None else steps
        return self.cost if expected is None else self.cost * expected


# Each trial of a search counts this share of what is left of it: of four trials, 87 %.
_TRIAL: Final = 0.4


class WholeProgress:
    """A `Progress` that says what share of the whole work is done.

    Parameters
    ----------
    costs : sequence of StageCost
        The stages in their order. A stage that is reported and not among them moves nothing; one
        that is among them and not reported is over once a later one begins.
    progress : Progress
        Receives every report.
    whole : callable, optional
        Called with the share after every report, 0 to 1. It never falls, also where a stage turns
        out larger than expected: what is left is then spread over what is left to do.
    """

    def __init__(
        self,
        costs: Sequence[StageCost],
        progress: Progress = silent,
        whole: Callable[[float], None] | None = None,
    ) -> None:
        self._costs = {cost.stage: cost for cost in costs}
        self._outer = {cost.inner: cost.stage for cost in costs if cost.inner}
        self._weights = {cost.stage: cost.whole() for cost in costs}
        self._done = dict.fromkeys(self._costs, 0.0)
        self._trials = 0
        self._steps: _Steps | None = None
        self._progress = progress
        self._whole = whole
        # The share and the cost that were behind us when the expected costs last changed.
        self._behind = (0.0, 0.0)
        self.share = 0.0

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Report that `done` of `total` steps of a stage are through."""
        self._progress(stage, done, total)
        self._count(stage, done, total)
        if self._whole is not None:
            self._whole(self.share)

    def _count(self, stage: str, done: int, total: int) -> None:
        part = done / total if total else 1.0
        if self._steps is not None and stage != self._steps.cost.stage:
            stage, part = self._steps.cost.stage, self._steps.inside(stage, done, total)
        elif stage in self._costs and self._costs[stage].parts:
            self._steps = _Steps(self._costs[stage], done) if done < total else None
            part = 1.0 if self._steps is None else self._steps.share()
        elif stage in self._outer:
            stage, part = self._outer[stage], self._searched(part)
        elif stage not in self._costs:
            return
        elif self._costs[stage].inner:
            self._trials = done
            part = 1.0 if done >= total else self._searched(0.0)
        elif self._done[stage] == 0.0:
            self._expect(stage, self._costs[stage].whole(total))
        # Whatever comes before a stage that works is over.
        for earlier in self._costs:
            if earlier == stage:
                break
            self._done[earlier] = 1.0
        self._done[stage] = max(self._done[stage], part)
        share, cost = self._behind
        left = sum(self._weights.values()) - cost
        if left > 0.0:
            self.share = max(self.share, share + (1.0 - share) * (self._cost_done() - cost) / left)
        self.share = min(self.share, 1.0)

    def _searched(self, part: float) -> float:
        """Return how much of a search is over after its trials and a part of one more."""
        return 1.0 - float((1.0 - _TRIAL) ** (self._trials + part))

    def _expect(self, stage: str, cost: float) -> None:
        if cost != self._weights[stage]:
            self._behind = (self.share, self._cost_done())
            self._weights[stage] = cost

    def _cost_done(self) -> float:
        return sum(self._weights[stage] * part for stage, part in self._done.items())


class _Steps:
    """A stage whose steps have stages of their own, while one of its steps works.

    Parameters
    ----------
    cost : StageCost
        With parts.
    done : int
        Steps that are over.
    """

    def __init__(self, cost: StageCost, done: int) -> None:
        self.cost = cost
        self._sizes = [sum(inner.whole() for inner in part) for part in cost.parts]
        self._done = done
        self._step = WholeProgress(cost.parts[done] if done < len(cost.parts) else ())

    def inside(self, stage: str, done: int, total: int) -> float:
        """Take a report of the step that works; return the share of all steps."""
        self._step(stage, done, total)
        return self.share()

    def share(self) -> float:
        """Return the share of all steps that is done."""
        over = sum(self._sizes[: self._done])
        if self._done < len(self._sizes):
            over += self._sizes[self._done] * self._step.share
        return over / sum(self._sizes)
