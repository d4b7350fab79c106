"""PlayCanvas' converter, splat-transform, as npm installs it: how it is called."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Final

import click

_PROGRAM: Final = "@playcanvas/splat-transform/bin/cli.mjs"


def is_installed(modules: Path) -> bool:
    """Return whether the converter lies in a ``node_modules`` folder."""
    return (modules / _PROGRAM).is_file()


def command(modules: Path, *arguments: str) -> list[str]:
    """Return the command line that converts and says nothing; it replaces what was there.

    Parameters
    ----------
    modules : Path
        The ``node_modules`` folder.
    *arguments : str
        Options, scenes to read, and the file to write.
    """
    return ["node", str(modules / _PROGRAM), "-q", "-w", *arguments]


def converted(modules: Path, source: Path, target: Path, *options: str) -> Path:
    """Convert a scene to `target`, and return `target`.

    Raises
    ------
    click.ClickException
        It failed; the message ends with what it said.
    """
    run(command(modules, *options, str(source), str(target)))
    return target


def run(line: list[str]) -> None:
    """Run a command line whose output matters only where it fails.

    Raises
    ------
    click.ClickException
        It failed; the message ends with what it said.
    """
    done = subprocess.run(
        line, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise click.ClickException(f"{' '.join(line)}:\n{done.stdout}{done.stderr}")
