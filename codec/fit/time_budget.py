"""Time budget of a training run: how many steps fit into the remaining time."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

# A step takes time for what is the same in every scene, and for its splats: measured on a captured
# scene of which 15 to 100 % were left.
_FIXED_SHARE: Final = 0.06
# The plan never shrinks below this share, nor grows to more than so many times as much.
_LEAST: Final = 0.05
_MOST: Final = 12.0


class TimeBudget:
    """Stretches or shortens a plan of steps so that it ends when the time is over.

    Parameters
    ----------
    seconds : float or None
        From now on; None leaves the plan as it is.
    clock : callable
        Returns seconds.
    """

    def __init__(self, seconds: float | None, clock: Callable[[], float] = time.monotonic) -> None:
        self.factor = 1.0
        self._clock = clock
        self._end = None if seconds is None else clock() + seconds
        self._spent = 0.0
        self._done = 0.0

    @staticmethod
    def work(steps: float, share: float) -> float:
        """Return what steps cost with a share of the splats, in steps with all of them."""
        return steps * (_FIXED_SHARE + (1.0 - _FIXED_SHARE) * share)

    def hold(self, factor: float) -> None:
        """Keep to a factor that was found before, whatever the clock says from now on."""
        self.factor = factor
        self._end = None

    def plan(self, once: float, stretched: float) -> None:
        """Find `factor`: how many times the steps planned are to be made.

        Parameters
        ----------
        once : float
            Work (`work`) that is worth doing once and not more often; less than once where there is
            no time for it.
        stretched : float
            Work that takes what time is left, above 0.
        """
        if self._end is None or not self._done:
            return
        possible = (self._end - self._clock()) * self._done / self._spent
        factor = possible / (once + stretched)
        if factor > 1.0:
            factor = (possible - once) / stretched
        self.factor = min(max(factor, _LEAST), _MOST)

    def steps(self, planned: int, *, stretched: bool) -> int:
        """Return how many steps to make in place of those planned, at least 1."""
        factor = self.factor if stretched else min(self.factor, 1.0)
        return max(1, round(planned * factor))

    def fitting(self, planned: int, seconds: float, kept_seconds: float) -> int:
        """Return how many parts of work to do in place of those planned, at least 1.

        Parameters
        ----------
        planned : int
            As they are where nothing limits the time.
        seconds : float
            That one of them takes.
        kept_seconds : float
            Time that is to be left behind them.
        """
        if self._end is None:
            return planned
        fitting = int((self._end - self._clock() - kept_seconds) / seconds)
        return max(1, min(max(fitting, round(_LEAST * planned)), round(_MOST * planned)))

    def now(self) -> float:
        """Return the time, seconds from anywhere."""
        return self._clock()

    def timed(self, make: Callable[[], object], work: float) -> None:
        """Do something that is so much work, and note what it took."""
        begin = self._clock()
        make()
        self._spent += self._clock() - begin
        self._done += work
