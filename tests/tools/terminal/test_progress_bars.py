"""Stages: lines in logs, bars on terminals, seconds that add up."""

import io
import sys

import pytest

from cogsplat.codec.progress import StageCost
from cogsplat.tools.terminal import progress_bars
from cogsplat.tools.terminal.progress_bars import Stages


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Return a list whose one number is the time."""
    now = [100.0]
    monkeypatch.setattr(progress_bars.time, "monotonic", lambda: now[0])
    return now


def test_lines_are_few_and_single_steps_have_none(
    clock: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    with Stages() as stages:
        with stages.stage("read"):
            clock[0] += 60.0
        stages("score", 0, 50)
        for step in range(50):
            clock[0] += 0.5
            stages("score", step + 1, 50)
    out, err = capsys.readouterr()
    lines = err.splitlines()
    assert out == ""
    assert lines[:2] == ["score 0/50", "score 4/50"]
    assert len(lines) == 1 + 12


def test_no_line_is_repeated(clock: list[float], capsys: pytest.CaptureFixture[str]) -> None:
    with Stages() as stages:
        for _ in range(3):
            stages("score", 0, 5)
        for _ in range(3):
            clock[0] += 10.0
            stages("score", 2, 5)
    assert capsys.readouterr().err.splitlines() == ["score 0/5", "score 2/5"]


def test_compiling_says_once_that_it_happens_once(capsys: pytest.CaptureFixture[str]) -> None:
    with Stages() as stages:
        stages("compile", 0, 9)
        stages("compile", 9, 9)
    note, *steps = capsys.readouterr().err.splitlines()
    assert "once on this machine" in note
    assert steps == ["compile 0/9"]


def test_nothing_is_written_when_not_shown(
    clock: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    with Stages(shown=False) as stages:
        for step in range(5):
            clock[0] += 10.0
            stages("score", step, 5)
    assert capsys.readouterr() == ("", "")


def test_seconds_add_up_to_the_whole(clock: list[float]) -> None:
    with Stages(shown=False) as stages:
        with stages.stage("read"):
            clock[0] += 1.0
        clock[0] += 2.0
        stages("score", 0, 2)
        clock[0] += 3.0
        stages("score", 2, 2)
        clock[0] += 0.01
        stages("write", 1, 1)
    assert stages.rounded_seconds() == {"read": 1.0, "score": 5.0, "write": 0.01}
    assert stages.total_seconds == pytest.approx(6.01)
    assert stages.summary() == "6.0 s: read 1.0, score 5.0"
    assert stages.totals == {"read": 1, "score": 2, "write": 1}


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_bars_on_a_terminal_leave_nothing_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "80")

    def interrupted() -> None:
        with Stages() as stages:
            stages("score", 0, 3)
            stages("score", 2, 3)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    shown = terminal.getvalue()
    assert "score" in shown
    assert "2/3" in shown
    assert "67%" in shown
    assert "left" in shown
    hidden, back = "\x1b[?25l", "\x1b[?25h"
    assert shown.count(hidden) == shown.count(back)
    assert shown.rindex(back) > shown.rindex(hidden)


def test_one_bar_speaks_of_the_whole_work_once_it_is_planned(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "100")
    with Stages() as stages:
        with stages.stage("read"):
            pass
        stages.plan([StageCost("score", 3.0), StageCost("gain", 1.0)])
        stages("score", 2, 3)
        stages("gain", 1, 2)
    shown = terminal.getvalue()
    assert "read" in shown
    last = next(line for line in reversed(shown.splitlines()) if "%" in line)
    for part in ("gain", "88%", "left", "1/2"):
        assert part in last
    assert "read" not in last
    assert "score" not in last


def test_lines_of_planned_work_end_with_its_share(
    clock: list[float], capsys: pytest.CaptureFixture[str]
) -> None:
    with Stages() as stages:
        stages.plan([StageCost("score", 1.0), StageCost("gain", 1.0)])
        stages("score", 0, 4)
        clock[0] += 9.0
        stages("score", 2, 4)
    assert capsys.readouterr().err.splitlines() == ["score 0/4, 0% of all", "score 2/4, 25% of all"]


def test_dumb_terminals_get_lines(monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("TERM", "dumb")
    with Stages() as stages:
        stages("score", 0, 3)
    assert terminal.getvalue() == "score 0/3\n"


def test_closed_standard_error_is_no_fault(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", None)
    with Stages() as stages:
        stages("score", 0, 3)
    assert stages.totals == {"score": 3}
