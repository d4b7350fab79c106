"""Progress of a command: its stages shown on the terminal, and timed."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from types import TracebackType
from typing import Final

import click
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TaskID,
    TaskProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

from cogsplat.codec.progress import OverallProgress, StageCost, TimedProgress

# Logs stay readable: a stage writes no more often than this, seconds.
_LINE_EVERY: Final = 2.0

# The one task that stands for the whole work.
_WHOLE: Final = ""


def _columns(steps: ProgressColumn) -> tuple[ProgressColumn, ...]:
    return (
        TextColumn("  {task.description:<15}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        steps,
    )


class Stages(TimedProgress):
    """A `codec.progress.Progress` that prints: bars on a terminal, plain lines elsewhere.

    A context manager, which times the stages as `TimedProgress` says. Each stage has a bar of its
    own until `plan` says what all of them cost; then one bar, which names the stage, shows the
    percentage of the whole work and the time that is left of it.

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
        self._whole: OverallProgress | None = None
        self._written: dict[str, float] = {}

    def __enter__(self) -> Stages:
        self.restart()
        if self._shown and sys.stderr is not None and sys.stderr.isatty():
            console = Console(stderr=True)
            if not console.is_dumb_terminal:
                self._bars = Progress(
                    *_columns(MofNCompleteColumn()), console=console, transient=True
                )
                self._bars.start()
        return self

    def plan(self, costs: Sequence[StageCost]) -> None:
        """Show one bar for all that is left to do, with what its stages are expected to cost."""
        self._whole = OverallProgress(costs)
        if self._bars:
            for task in self._tasks.values():
                self._bars.remove_task(task)
            self._tasks = {_WHOLE: self._bars.add_task("", total=1.0)}
            self._bars.columns = _columns(TextColumn("{task.fields[steps]}"))
            self._bars.update(self._tasks[_WHOLE], steps="")

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
        if self._whole:
            self._whole(stage, done, total)
        if self._bars and self._whole:
            steps = f"{done}/{total}" if total > 1 else ""
            self._bars.update(
                self._tasks[_WHOLE], completed=self._whole.share, description=stage, steps=steps
            )
        elif self._bars:
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
            share = f", {self._whole.share:.0%} of all" if self._whole else ""
            click.echo(f"{stage} {done}/{total}{share}", err=True)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Report the block as a stage of one step."""
        self(name, 0, 1)
        yield
        self(name, 1, 1)

    @property
    def share(self) -> float | None:
        """Share of the whole work that is done; None until `plan` has said what that is."""
        return None if self._whole is None else self._whole.share

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
        return _rounded(self.seconds)

    def cpu_rounded(self) -> dict[str, float]:
        """Return the processor seconds of each stage in the same way."""
        return _rounded(self.cpu_seconds)


def _rounded(seconds: Mapping[str, float]) -> dict[str, float]:
    return {name: round(spent, 3) for name, spent in seconds.items()}
