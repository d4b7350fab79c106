"""All checks of the project in one command.

Run ``python -m cogsplat.tools.lab.check [pytest arguments]``.
"""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[2]

# Exit status where the checks cannot run at all, as pytest's own for misuse.
_MISUSE = 4


def steps(pytest_arguments: list[str]) -> list[tuple[str, list[str]]]:
    """Return name and command line of every check; pytest comes last, to end with its summary."""
    module = [sys.executable, "-m"]
    # A process for each core, and the slowest tests named; arguments that follow may say otherwise.
    pytest = ["pytest", "-n", "logical", "--dist", "worksteal", "--durations", "15"]
    lint_imports = "from importlinter.cli import lint_imports_command; lint_imports_command()"
    return [
        ("ruff check", [*module, "ruff", "check", "."]),
        ("ruff format", [*module, "ruff", "format", "--check", "."]),
        ("mypy --strict", [*module, "mypy"]),
        ("lint-imports", [sys.executable, "-c", lint_imports]),
        ("pytest", [*module, *pytest, *pytest_arguments]),
    ]


def run(checks: list[tuple[str, list[str]]], root: Path) -> list[str]:
    """Run checks one after the other in `root`, their output as it comes.

    Parameters
    ----------
    checks : list of (str, list of str)
        Name and command line.
    root : Path
        Working directory.

    Returns
    -------
    list of str
        Names of those that failed; a failure stops none of the others.
    """
    failed, times = [], []
    for name, command in checks:
        print(f"== {name}", flush=True)
        start = time.monotonic()
        status = subprocess.run(command, cwd=root, stdin=subprocess.DEVNULL, check=False).returncode
        seconds = time.monotonic() - start
        verdict = "ok" if status == 0 else f"FAILED (exit status {status})"
        times.append(f"{name:<14} {seconds:7.1f} s  {verdict}")
        print(f"== {times[-1]}", flush=True)
        if status:
            failed.append(name)
    print("\n".join(["", *times]), flush=True)
    return failed


def main() -> int:
    """Run all checks on the checkout that this file is part of; arguments go to pytest."""
    if not (_ROOT / "pyproject.toml").is_file():
        print(
            f"no pyproject.toml in {_ROOT}: the checks run from a checkout installed with "
            "`pip install -e '.[dev]'`",
            file=sys.stderr,
        )
        return _MISUSE
    failed = run(steps(sys.argv[1:]), _ROOT)
    print(f"failed: {', '.join(failed)}" if failed else "all checks passed", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
