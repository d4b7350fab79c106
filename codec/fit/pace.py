"""Pace: how many steps of training fit into the time that is left."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final

# A step takes time for what is the same in every scene, and for its splats: measured on a captured
# scene of which 25 to 70 % were left.
_FIXED_SHARE: Final = 0.08
# Steps are never fewer than this share of the plan, nor more than so many times as many.
_LEAST: Final = 0.05
_MOST: Final = 4.0


class Pace:
    """Stretches or shortens a plan of steps so that it ends when the time is over.

    Parameters
    ----------
    seconds : float or None
        From now on; None leaves the plan as it is.
    clock : callable
        Returns seconds.
    """

    def __init__(self, seconds: float | None, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock = clock
        self._end = None if seconds is None else clock() + seconds
        self._spent = 0.0
        self._done = 0.0

    @staticmethod
    def work(steps: float, share: float) -> float:
        """Return what steps cost with a share of the splats, in steps with all of them."""
        return steps * (_FIXED_SHARE + (1.0 - _FIXED_SHARE) * share)

    def steps(self, planned: int, share: float, after: float) -> int:
        """Return how many steps to make in place of those planned.

        Parameters
        ----------
        planned : int
            At least 1.
        share : float
            Of the splats that are left, 0 to 1.
        after : float
            Work that is planned behind them (`work`).
        """
        if self._end is None or not self._done:
            return planned
        left = self._end - self._clock()
        needed = (self.work(planned, share) + after) * self._spent / self._done
        return max(1, round(planned * min(max(left / needed, _LEAST), _MOST)))

    def timed(self, make: Callable[[], None], steps: int, share: float) -> None:
        """Make some steps, and note what they took."""
        begin = self._clock()
        make()
        self._spent += self._clock() - begin
        self._done += self.work(steps, share)
