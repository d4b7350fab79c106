"""The checks in one command: which there are, and what a failing one does."""

import sys
from pathlib import Path

import pytest

from cogsplat.tools.lab import check


def python(code: str) -> list[str]:
    return [sys.executable, "-c", code]


def test_pytest_comes_last_and_takes_the_arguments() -> None:
    steps = check.steps(["tests/codec", "-k", "morton"])
    names = [name for name, _ in steps]
    assert names == ["ruff check", "ruff format", "mypy --strict", "lint-imports", "pytest"]
    assert steps[-1][1][-3:] == ["tests/codec", "-k", "morton"]
    assert all(command[0] == sys.executable for _, command in steps)


def test_a_failure_stops_no_other_check(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    checks = [
        ("first", python("print('one')")),
        ("second", python("raise SystemExit(3)")),
        ("third", python("open('here', 'w').close()")),
    ]
    assert check.run(checks, tmp_path) == ["second"]
    assert (tmp_path / "here").is_file()
    told = capfd.readouterr().out
    assert "one" in told
    assert "FAILED (exit status 3)" in told
    # In the log of each check and in the list at the end.
    assert told.count("FAILED") == 2


def test_what_fails_is_named_and_is_the_exit_status(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["check", "-k", "nothing"])
    monkeypatch.setattr(check, "run", lambda checks, root: ["mypy --strict", "pytest"])
    assert check.main() == 1
    assert "failed: mypy --strict, pytest" in capsys.readouterr().out
    monkeypatch.setattr(check, "run", lambda checks, root: [])
    assert check.main() == 0
    assert "all checks passed" in capsys.readouterr().out


def test_outside_a_checkout_nothing_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(check, "_ROOT", tmp_path)
    assert check.main() == 4
    assert "no pyproject.toml" in capsys.readouterr().err
