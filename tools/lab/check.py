"""All checks of the project in one command.

Run ``python -m cogsplat.tools.lab.check [pytest arguments]``.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

_ROOT = Path(__file__).resolve().parents[2]
# Folders of the package that stand at the top of a checkout.
_PARTS = ("codec", "formats", "tools")
_TREE = "build/tree"

# Exit status where the checks cannot run at all, as pytest's own for misuse.
_MISUSE = 4


def assemble(root: Path) -> Path:
    """Put the package together in ``build/tree``, as a wheel has it, for tools that read files.

    Type checkers and import-linter find `cogsplat.codec` as a folder in `cogsplat`; in a checkout
    it stands beside it. Folders are linked, or copied where links cannot be made.

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
    shutil.rmtree(tree, ignore_errors=True)
    package.mkdir(parents=True)
    for path in (root / "cogsplat").iterdir():
        if path.is_file():
            shutil.copy(path, package)
    for name in _PARTS:
        with suppress(OSError, NotImplementedError):
            (package / name).symlink_to(root / name, target_is_directory=True)
        if not (package / name).is_dir():
            leave = shutil.ignore_patterns("__pycache__", "node_modules")
            shutil.copytree(root / name, package / name, ignore=leave)
    return tree


def steps(pytest_arguments: list[str]) -> list[tuple[str, list[str], str]]:
    """Return name, command line and folder of every check; pytest comes last, with its summary."""
    module = [sys.executable, "-m"]
    # A process for each core, and the slowest tests named; arguments that follow may say otherwise.
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
    """Run checks one after the other in `root`, their output as it comes.

    Parameters
    ----------
    checks : list of (str, list of str, str)
        Name, command line, and working directory below `root`.
    root : Path
        The checkout.

    Returns
    -------
    list of str
        Names of those that failed; a failure stops none of the others.
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
    """Run all checks on the checkout that this file is part of; arguments go to pytest."""
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
