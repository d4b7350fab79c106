"""One command that runs lint, type checks, import rules and tests.

Run ``python -m cogsplat.tools.lab.check [pytest arguments]``.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[2]
# Folders of the package that are at the top of a checkout.
_PARTS = ("codec", "formats", "tools")
_TREE = "build/tree"

# Exit status if the checks cannot run, the same as pytest's for misuse.
_MISUSE = 4


def assemble(root: Path) -> Path:
    """Assemble the package in ``build/tree`` as in a wheel, for tools that read source files.

    Type checkers and import-linter find `cogsplat.codec` as a folder in `cogsplat`; in a checkout
    the folder `codec` is next to `cogsplat`. Folders are linked, or copied if links fail.

    Parameters
    ----------
    root : Path
        The checkout.

    Returns
    -------
    Path
        The folder that holds the package `cogsplat`.
    """
    tree = root / "build" / "tree"
    package = tree / "cogsplat"
    if tree.exists():
        shutil.rmtree(tree)
    package.mkdir(parents=True)
    for path in (root / "cogsplat").iterdir():
        if path.is_file():
            shutil.copy(path, package)
    for name in _PARTS:
        try:
            (package / name).symlink_to(root / name, target_is_directory=True)
        except (OSError, NotImplementedError):
            # Links take a right on Windows. The copy raises whatever else is wrong with the disk.
            leave = shutil.ignore_patterns("__pycache__", "node_modules")
            shutil.copytree(root / name, package / name, ignore=leave)
    return tree


def steps(pytest_arguments: list[str]) -> list[tuple[str, list[str], str]]:
    """Return name, command line and folder of every check; pytest comes last, with its summary."""
    module = [sys.executable, "-m"]
    # One process per core, and a list of the slowest tests; later arguments override these.
    pytest = ["pytest", "-n", "logical", "--dist", "worksteal", "--durations", "15"]
    settings = str(_ROOT / "pyproject.toml")
    lint_imports = "from importlinter.cli import lint_imports_command; lint_imports_command()"
    return [
        ("ruff check", [*module, "ruff", "check", "."], "."),
        ("ruff format", [*module, "ruff", "format", "--check", "."], "."),
        ("mypy --strict", [*module, "mypy", "--config-file", settings], _TREE),
        ("lint-imports", [sys.executable, "-c", lint_imports, "--config", settings], _TREE),
        ("pytest", [*module, *pytest, *pytest_arguments], "."),
    ]


def run(checks: list[tuple[str, list[str], str]], root: Path) -> list[str]:
    """Run checks in order, with their output unbuffered.

    Parameters
    ----------
    checks : list of (str, list of str, str)
        Name, command line, and working directory below `root`.
    root : Path
        The checkout.

    Returns
    -------
    list of str
        Names of the failed checks; the checks after a failure still run.
    """
    failed, times = [], []
    for name, command, folder in checks:
        print(f"== {name}", flush=True)
        start = time.monotonic()
        status = subprocess.run(
            command, cwd=root / folder, stdin=subprocess.DEVNULL, check=False
        ).returncode
        seconds = time.monotonic() - start
        verdict = "ok" if status == 0 else f"FAILED (exit status {status})"
        times.append(f"{name:<14} {seconds:7.1f} s  {verdict}")
        print(f"== {times[-1]}", flush=True)
        if status:
            failed.append(name)
    print("\n".join(["", *times]), flush=True)
    return failed


def main() -> int:
    """Run all checks on the checkout of this file, with the command's arguments for pytest."""
    if not (_ROOT / "pyproject.toml").is_file():
        print(
            f"no pyproject.toml in {_ROOT}: the checks run from a checkout installed with "
            "`pip install -e '.[dev]'`",
            file=sys.stderr,
        )
        return _MISUSE
    assemble(_ROOT)
    failed = run(steps(sys.argv[1:]), _ROOT)
    print(f"failed: {', '.join(failed)}" if failed else "all checks passed", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
