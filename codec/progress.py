"""Progress reports of long work: one callback, which can also cancel the work."""

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
    """Progress callback that measures the time of every stage and forwards each report.

    The time between two reports counts for the stage of the second report, so that the times of
    all stages add up to the total.

    Parameters
    ----------
    progress : Progress
        Callback that every report is forwarded to.

    Attributes
    ----------
    seconds : dict of str to float
        Wall-clock time by stage, in the order in which the stages began.
    cpu_seconds : dict of str to float
        Processor time of all threads of this process by stage, in the same order. Divided by the
        wall-clock time it gives the number of busy cores.
    totals : dict of str to int
        Number of steps that each stage announced.
    """

    def __init__(self, progress: Progress = silent) -> None:
        self.seconds: dict[str, float] = {}
        self.cpu_seconds: dict[str, float] = {}
        self.totals: dict[str, int] = {}
        self._progress = progress
        self.restart()

    def restart(self) -> None:
        """Discard the time since the last report: the next stage begins now."""
        self._last = time.monotonic(), time.process_time()

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Add the time since the last report to a stage and forward the report."""
        now, now_cpu = time.monotonic(), time.process_time()
        last, last_cpu = self._last
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - last
        self.cpu_seconds[stage] = self.cpu_seconds.get(stage, 0.0) + now_cpu - last_cpu
        self.totals[stage] = total
        self._last = now, now_cpu
        self._progress(stage, done, total)


@dataclass(frozen=True)
class StageCost:
    """Expected cost of a stage, in any unit shared by all stages of the work.

    Parameters
    ----------
    stage : str
        Name under which the stage reports progress.
    cost : float
        Cost per step, or of the whole stage if `steps` is None.
    steps : int or None
        Expected number of steps; replaced by the reported number once the stage has begun.
    inner : str
        For a search with an unknown number of trials: the stage that each trial repeats. Empty for
        other stages.
    parts : tuple of tuple of StageCost
        For a stage whose steps have stages of their own, such as writing and measuring several
        files: the stages of each step. Their costs are added up, and `cost` is 0. Other stages
        reported while this stage runs belong to its current step.
    """

    stage: str
    cost: float
    steps: int | None = None
    inner: str = ""
    parts: tuple[tuple[StageCost, ...], ...] = ()

    def total(self, steps: int | None = None) -> float:
        """Return the cost of the whole stage, with `steps` in place of the expected number."""
        if self.parts:
            return sum(cost.total() for part in self.parts for cost in part)
        expected = self.steps if self.steps is None or steps is None else steps
        return self.cost if expected is None else self.cost * expected


# Share of a search's remaining progress that each trial adds: after four trials 87 % is done.
_TRIAL: Final = 0.4


class OverallProgress:
    """Progress callback that computes the completed share of the whole work.

    Parameters
    ----------
    costs : sequence of StageCost
        Stages in their order. Reports of other stages do not change the share. A stage that never
        reports counts as complete once a later stage begins. `plan` replaces them.
    progress : Progress
        Callback that every report is forwarded to.
    overall : callable, optional
        Callback that receives the share after every report, 0 to 1. The share never falls: if a
        stage has more steps than expected, the remaining share is spread over the remaining cost.
    """

    def __init__(
        self,
        costs: Sequence[StageCost] = (),
        progress: Progress = silent,
        overall: Callable[[float], None] | None = None,
    ) -> None:
        self._progress = progress
        self._overall = overall
        self.plan(costs)

    def plan(self, costs: Sequence[StageCost]) -> None:
        """Set the expected stages and restart at a share of 0.

        Parameters
        ----------
        costs : sequence of StageCost
            Stages in their order.
        """
        self._costs = {cost.stage: cost for cost in costs}
        self._outer = {cost.inner: cost.stage for cost in costs if cost.inner}
        self._weights = {cost.stage: cost.total() for cost in costs}
        self._done = dict.fromkeys(self._costs, 0.0)
        self._trials = 0
        self._steps: _NestedSteps | None = None
        # Share and cost completed when the expected costs last changed.
        self._completed = (0.0, 0.0)
        self.share = 0.0

    def finish(self) -> None:
        """Report a share of 1."""
        self.share = 1.0
        if self._overall is not None:
            self._overall(self.share)

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Report that `done` of `total` steps of a stage are complete."""
        self._progress(stage, done, total)
        self._update(stage, done, total)
        if self._overall is not None:
            self._overall(self.share)

    def _update(self, stage: str, done: int, total: int) -> None:
        """Update the share from one report."""
        part = done / total if total else 1.0
        if self._steps is not None and stage != self._steps.cost.stage:
            stage, part = self._steps.cost.stage, self._steps.update(stage, done, total)
        elif stage in self._costs and self._costs[stage].parts:
            self._steps = _NestedSteps(self._costs[stage], done) if done < total else None
            part = 1.0 if self._steps is None else self._steps.share()
        elif stage in self._outer:
            stage, part = self._outer[stage], self._search_share(part)
        elif stage not in self._costs:
            return
        elif self._costs[stage].inner:
            self._trials = done
            part = 1.0 if done >= total else self._search_share(0.0)
        elif self._done[stage] == 0.0:
            self._set_cost(stage, self._costs[stage].total(total))
        # All stages before the current one are complete.
        for earlier in self._costs:
            if earlier == stage:
                break
            self._done[earlier] = 1.0
        self._done[stage] = max(self._done[stage], part)
        share, cost = self._completed
        left = sum(self._weights.values()) - cost
        if left > 0.0:
            self.share = max(self.share, share + (1.0 - share) * (self._cost_done() - cost) / left)
        self.share = min(self.share, 1.0)

    def _search_share(self, part: float) -> float:
        """Return the completed share of a search after its trials and a part of one more."""
        return 1.0 - float((1.0 - _TRIAL) ** (self._trials + part))

    def _set_cost(self, stage: str, cost: float) -> None:
        """Replace the expected cost of a stage that begins."""
        if cost != self._weights[stage]:
            self._completed = (self.share, self._cost_done())
            self._weights[stage] = cost

    def _cost_done(self) -> float:
        """Return the cost of all completed stages and parts of stages."""
        return sum(self._weights[stage] * part for stage, part in self._done.items())


class _NestedSteps:
    """Progress of a stage whose steps have stages of their own.

    Parameters
    ----------
    cost : StageCost
        Cost of the stage, with `StageCost.parts`.
    done : int
        Number of completed steps.
    """

    def __init__(self, cost: StageCost, done: int) -> None:
        self.cost = cost
        self._sizes = [sum(inner.total() for inner in part) for part in cost.parts]
        self._done = done
        self._step = OverallProgress(cost.parts[done] if done < len(cost.parts) else ())

    def update(self, stage: str, done: int, total: int) -> float:
        """Record a report of the current step and return the completed share of all steps."""
        self._step(stage, done, total)
        return self.share()

    def share(self) -> float:
        """Return the completed share of all steps."""
        over = sum(self._sizes[: self._done])
        if self._done < len(self._sizes):
            over += self._sizes[self._done] * self._step.share
        return over / sum(self._sizes)
