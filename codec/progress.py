"""How long work reports: one callback, which may also stop it."""

from __future__ import annotations

import time
from collections.abc import Callable

Progress = Callable[[str, int, int], None]
"""``progress(stage, done, total)``; raising `Cancelled` from it stops the work."""


def silent(stage: str, done: int, total: int) -> None:
    """Report nothing."""


class TimedProgress:
    """A `Progress` that adds up the seconds of every stage and passes each report on.

    The time between two reports belongs to the stage that reports second, so that the seconds of
    all stages add up to the time of the whole work.

    Parameters
    ----------
    progress : Progress
        Receives every report.

    Attributes
    ----------
    seconds : dict of str to float
        By stage, in the order in which the stages began.
    totals : dict of str to int
        Steps that each stage announced.
    """

    def __init__(self, progress: Progress = silent) -> None:
        self.seconds: dict[str, float] = {}
        self.totals: dict[str, int] = {}
        self._progress = progress
        self._last = time.monotonic()

    def restart(self) -> None:
        """Leave out the time since the last report: the next stage begins now."""
        self._last = time.monotonic()

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Add the time since the last report to a stage and pass the report on."""
        now = time.monotonic()
        self.seconds[stage] = self.seconds.get(stage, 0.0) + now - self._last
        self.totals[stage] = total
        self._last = now
        self._progress(stage, done, total)
