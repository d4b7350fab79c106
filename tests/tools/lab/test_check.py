"""The checks in one command: which there are, and what a failing one does."""

import sys
from pathlib import Path

import pytest

from cogsplat.tools.lab import check


def python(code: str) -> list[str]:
    return [sys.executable, "-c", code]


def test_pytest_comes_last_and_takes_the_arguments() -> None:
    steps = check.steps(["tests/codec", "-k", "morton"])
    names = [name for name, _, _ in steps]
    assert names == ["ruff check", "ruff format", "mypy --strict", "lint-imports", "pytest"]
    assert steps[-1][1][-3:] == ["tests/codec", "-k", "morton"]
    assert all(command[0] == sys.executable for _, command, _ in steps)


def test_a_failure_stops_no_other_check(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    checks = [
        ("first", python("print('one')"), "."),
        ("second", python("raise SystemExit(3)"), "."),
        ("third", python("open('here', 'w').close()"), "below"),
    ]
    (tmp_path / "below").mkdir()
    assert check.run(checks, tmp_path) == ["second"]
    assert (tmp_path / "below" / "here").is_file()
    told = capfd.readouterr().out
    assert "one" in told
    assert "FAILED (exit status 3)" in told
    # In the log of each check and in the list at the end.
    assert told.count("FAILED") == 2


def test_what_fails_is_named_and_is_the_exit_status(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["check", "-k", "nothing"])
    monkeypatch.setattr(check, "assemble", lambda root: root)
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


@pytest.mark.parametrize("links", [True, False])
def test_the_package_is_put_together_with_links_and_without(
    links: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("cogsplat", "codec", "formats", "tools"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "__init__.py").write_text(name)
    if not links:

        def refuse(*arguments: object, **options: object) -> None:
            raise OSError("no right to make links")

        monkeypatch.setattr(Path, "symlink_to", refuse)
    for _ in range(2):
        package = check.assemble(tmp_path) / "cogsplat"
        assert (package / "__init__.py").read_text() == "cogsplat"
        assert (package / "codec" / "__init__.py").read_text() == "codec"
        assert (package / "codec").is_symlink() == links
