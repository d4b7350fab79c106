"""Time budget of a training run: how many steps fit into the remaining time."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from typing import Final

from cogsplat.codec.errors import CogsplatWarning

# Share of a step's time that does not depend on the number of splats: mostly renders of the source,
# the ground truth of drawn views. Measured on a captured and a made scene with 10 to 100 % of their
# splats: 0.08 and 0.15.
_FIXED_SHARE: Final = 0.11
# Bounds of the factor on planned steps.
_MIN_FACTOR: Final = 0.05
_MAX_FACTOR: Final = 12.0


class TimeBudget:
    """Deadline of a training run, and the factor on planned steps that meets it.

    Work is counted in training steps with all splats of the scene (`work`).

    Parameters
    ----------
    seconds : float or None
        Time until the deadline; None leaves all plans unchanged.
    clock : callable
        Returns the current time, seconds.
    """

    def __init__(self, seconds: float | None, clock: Callable[[], float] = time.monotonic) -> None:
        self.factor = 1.0
        self._clock = clock
        self._begin = clock()
        self._deadline = None if seconds is None else self._begin + seconds
        self._has_warned = False
        self._measured_seconds = 0.0
        self._measured_work = 0.0

    @property
    def has_deadline(self) -> bool:
        """Whether there is a deadline."""
        return self._deadline is not None

    @property
    def needs_measurement(self) -> bool:
        """Whether there is a deadline, and no work was timed yet."""
        return self._deadline is not None and not self._measured_work

    @staticmethod
    def work(steps: float, share: float) -> float:
        """Return the cost of steps with a share of the splats, in steps with all splats."""
        return steps * (_FIXED_SHARE + (1.0 - _FIXED_SHARE) * share)

    def fix_factor(self, factor: float) -> None:
        """Set the factor on planned steps and remove the deadline; used to resume a run."""
        self.factor = factor
        self._deadline = None

    def fit_to_deadline(
        self, fixed_work: float, scalable_work: float, reserved_seconds: float = 0.0
    ) -> None:
        """Set `factor` so that the remaining work fits the remaining time.

        A factor below 1 shortens all steps. A factor above 1 extends the scalable steps alone.
        Nothing changes if there is no deadline, or no work was timed yet (`run_timed`). A warning
        is issued, once, if even the smallest factor misses the deadline.

        Parameters
        ----------
        fixed_work : float
            Remaining work that is never extended, in steps with all splats.
        scalable_work : float
            Remaining work that is extended to fill the time, above 0, in the same unit.
        reserved_seconds : float
            Time to leave for other work than training steps, seconds.
        """
        if self._deadline is None or not self._measured_work:
            return
        remaining = self._deadline - self._clock() - reserved_seconds
        possible = remaining * self._measured_work / self._measured_seconds
        least = _MIN_FACTOR * (fixed_work + scalable_work)
        if possible < least and not self._has_warned:
            self._has_warned = True
            missing = (least - possible) * self._measured_seconds / self._measured_work
            planned = self._deadline - self._begin
            warnings.warn(
                f"a time limit of {planned:.0f} s, expected about {planned + missing:.0f} s or "
                f"more: {_MIN_FACTOR:.0%} of the usual steps, and what precedes and follows them, "
                "take that long; fewer views or splats would take less",
                CogsplatWarning,
                stacklevel=2,
            )
        factor = possible / (fixed_work + scalable_work)
        if factor > 1.0:
            factor = (possible - fixed_work) / scalable_work
        self.factor = min(max(factor, _MIN_FACTOR), _MAX_FACTOR)

    def scaled_steps(self, planned: int, *, extend: bool) -> int:
        """Multiply a planned number of steps by the factor; return at least 1.

        Parameters
        ----------
        planned : int
            Steps without a deadline.
        extend : bool
            Whether a factor above 1 applies.
        """
        factor = self.factor if extend else min(self.factor, 1.0)
        return max(1, round(planned * factor))

    def affordable_count(
        self,
        planned: int,
        seconds: float,
        reserved_seconds: float,
        *,
        extra: int = 0,
        done: int = 0,
    ) -> int:
        """Return the number of repetitions that end by the deadline; `planned` without a deadline.

        At least 1, `done` and `_MIN_FACTOR` times `planned`, which may miss the deadline, and at
        most `_MAX_FACTOR` times `planned`.

        Parameters
        ----------
        planned : int
            Repetitions without a deadline.
        seconds : float
            Duration of one repetition.
        reserved_seconds : float
            Time to leave for the work that follows.
        extra : int
            Further repetitions to leave time for, but no more than a fifth of the repetitions.
        done : int
            Repetitions already made; they count in the result.
        """
        if self._deadline is None:
            return planned
        affordable = int((self._deadline - self._clock() - reserved_seconds) / seconds) + done
        affordable -= min(extra, affordable // 5)
        most = min(affordable, round(_MAX_FACTOR * planned))
        return max(1, done, most, round(_MIN_FACTOR * planned))

    def count_within(self, share: float, seconds: float, most: int) -> int:
        """Return the number of repetitions that take a share of the time limit.

        At least 1, and at most `most`, which is the number without a deadline.

        Parameters
        ----------
        share : float
            Share of the time from the begin to the deadline.
        seconds : float
            Duration of one repetition.
        most : int
            Maximum number of repetitions.
        """
        if self._deadline is None:
            return most
        return max(1, int(min(most, share * (self._deadline - self._begin) / max(seconds, 1e-9))))

    def has_time(self, reserved_seconds: float) -> bool:
        """Return whether more than `reserved_seconds` remain, or there is no deadline."""
        return self._deadline is None or self._deadline - self._clock() > reserved_seconds

    def now(self) -> float:
        """Return the current time of the clock, seconds."""
        return self._clock()

    def run_timed(self, function: Callable[[], object], work: float) -> None:
        """Call a function that does an amount of work (`work`), and record its duration."""
        begin = self._clock()
        function()
        self._measured_seconds += self._clock() - begin
        self._measured_work += work
