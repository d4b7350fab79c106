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

# Least time between two lines of one stage in a log, s.
_LINE_EVERY: Final = 2.0

# What a stage that looks hung tells about itself when it begins.
_NOTES: Final = {
    "compile": "compile: kernels are compiled once on this machine, which takes about a minute, "
    "longer beside other work",
}

# Description of the task that stands for the whole work.
_WHOLE: Final = ""


def _columns(steps: ProgressColumn) -> tuple[ProgressColumn, ...]:
    """Return the columns of a bar; `steps` is the last one."""
    return (
        TextColumn("  {task.description:<15}"),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
        TextColumn("left"),
        steps,
    )


class Stages(TimedProgress):
    """A `codec.progress.Progress` that prints: bars on a terminal, plain lines elsewhere.

    A context manager that times the stages (`TimedProgress`). Each stage has its own bar. After
    `plan`, one bar shows the current stage, the share of the whole work and the remaining time.

    Parameters
    ----------
    shown : bool
        Whether progress is printed, to standard error.
    """

    def __init__(self, *, shown: bool = True) -> None:
        super().__init__()
        self._shown = shown
        self._bars: Progress | None = None
        self._tasks: dict[str, TaskID] = {}
        self._whole: OverallProgress | None = None
        self._written: dict[str, float] = {}
        self._last_line = ""

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
        """Show one bar for the remaining work, given the expected costs of its stages."""
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
        """Report that `done` of `total` steps of a stage are finished."""
        begins = stage not in self.seconds
        super().__call__(stage, done, total)
        if begins and self._shown and stage in _NOTES:
            self._write_note(_NOTES[stage])
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
        """Print a line about a stage, at most one in `_LINE_EVERY` seconds."""
        # A stage of one step has no progress to print; its time is in the summary.
        if total <= 1:
            return
        now = time.monotonic()
        due = now - self._written.setdefault(stage, now) >= _LINE_EVERY
        if done == 0 or due:
            self._written[stage] = now
            share = f", {self._whole.share:.0%} of all" if self._whole else ""
            line = f"{stage} {done}/{total}{share}"
            if line != self._last_line:
                click.echo(line, err=True)
            self._last_line = line

    def _write_note(self, note: str) -> None:
        """Print a note above the bars, or as a line."""
        if self._bars:
            self._bars.console.print(note, highlight=False)
        else:
            click.echo(note, err=True)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Report the code block as a stage of one step."""
        self(name, 0, 1)
        yield
        self(name, 1, 1)

    @property
    def share(self) -> float | None:
        """Share of the whole work that is finished, 0 to 1; None before `plan`."""
        return None if self._whole is None else self._whole.share

    @property
    def total_seconds(self) -> float:
        """Seconds of all stages together."""
        return sum(self.seconds.values())

    def summary(self) -> str:
        """Return the total seconds as text, and the seconds of each stage above 0.05 s."""
        parts = [f"{name} {spent:.1f}" for name, spent in self.seconds.items() if spent >= 0.05]
        return f"{self.total_seconds:.1f} s" + (f": {', '.join(parts)}" if parts else "")

    def rounded_seconds(self) -> dict[str, float]:
        """Return the seconds of each stage, rounded to milliseconds, for JSON output."""
        return _rounded(self.seconds)

    def rounded_cpu_seconds(self) -> dict[str, float]:
        """Return the processor seconds of each stage, rounded to milliseconds."""
        return _rounded(self.cpu_seconds)


def _rounded(seconds: Mapping[str, float]) -> dict[str, float]:
    """Return seconds rounded to milliseconds."""
    return {name: round(spent, 3) for name, spent in seconds.items()}
