"""Progress of a command: its stages shown on the terminal, and timed."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType
from typing import Final

import click
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    TaskID,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from cogsplat.codec.progress import TimedProgress

# Logs stay readable: a stage writes no more often than this, seconds.
_LINE_EVERY: Final = 2.0


class Stages(TimedProgress):
    """A `codec.progress.Progress` that prints: bars on a terminal, plain lines elsewhere.

    A context manager, which times the stages as `TimedProgress` says.

    Parameters
    ----------
    shown : bool
        Whether anything is written, always to standard error.
    """

    def __init__(self, *, shown: bool = True) -> None:
        super().__init__()
        self._shown = shown
        self._bars: Progress | None = None
        self._tasks: dict[str, TaskID] = {}
        self._written: dict[str, float] = {}

    def __enter__(self) -> Stages:
        self.restart()
        if self._shown and sys.stderr is not None and sys.stderr.isatty():
            console = Console(stderr=True)
            if not console.is_dumb_terminal:
                self._bars = Progress(
                    TextColumn("  {task.description:<10}"),
                    BarColumn(),
                    TaskProgressColumn(),
                    MofNCompleteColumn(),
                    TimeElapsedColumn(),
                    TextColumn("left"),
                    TimeRemainingColumn(),
                    console=console,
                    transient=True,
                )
                self._bars.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._bars:
            self._bars.stop()

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Report that `done` of `total` steps of a stage are through."""
        super().__call__(stage, done, total)
        if self._bars:
            if stage not in self._tasks:
                self._tasks[stage] = self._bars.add_task(stage, total=total)
            self._bars.update(self._tasks[stage], completed=done, total=total)
        elif self._shown:
            self._write_line(stage, done, total)

    def _write_line(self, stage: str, done: int, total: int) -> None:
        # One step tells nothing while it goes on, and is in the summary when it is over.
        if total <= 1:
            return
        now = time.monotonic()
        due = now - self._written.setdefault(stage, now) >= _LINE_EVERY
        if done == 0 or due:
            self._written[stage] = now
            click.echo(f"{stage} {done}/{total}", err=True)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Report the block as a stage of one step."""
        self(name, 0, 1)
        yield
        self(name, 1, 1)

    @property
    def total_seconds(self) -> float:
        """Time of all stages."""
        return sum(self.seconds.values())

    def line(self) -> str:
        """Say how long it took, stage by stage, those above a twentieth of a second."""
        parts = [f"{name} {spent:.1f}" for name, spent in self.seconds.items() if spent >= 0.05]
        return f"{self.total_seconds:.1f} s" + (f": {', '.join(parts)}" if parts else "")

    def rounded(self) -> dict[str, float]:
        """Return the seconds of each stage, to milliseconds, as JSON output holds them."""
        return {name: round(spent, 3) for name, spent in self.seconds.items()}
