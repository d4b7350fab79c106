"""Interface to PlayCanvas' converter, splat-transform, installed by npm."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Final

import click

_PROGRAM: Final = "@playcanvas/splat-transform/bin/cli.mjs"


def is_installed(modules: Path) -> bool:
    """Whether a ``node_modules`` folder contains the converter."""
    return (modules / _PROGRAM).is_file()


def command(modules: Path, *arguments: str) -> list[str]:
    """Return the command line of a quiet conversion that overwrites its output.

    Parameters
    ----------
    modules : Path
        Path of the ``node_modules`` folder.
    *arguments : str
        Options, input scenes, and the output file.
    """
    return ["node", str(modules / _PROGRAM), "-q", "-w", *arguments]


def convert(modules: Path, source: Path, target: Path, *options: str) -> Path:
    """Convert a scene to `target` and return `target`.

    Raises
    ------
    click.ClickException
        The command failed; the message ends with its output.
    """
    run(command(modules, *options, str(source), str(target)))
    return target


def run(line: list[str]) -> None:
    """Run a command line; its output is only shown if it fails.

    Raises
    ------
    click.ClickException
        The command failed; the message ends with its output.
    """
    done = subprocess.run(
        line, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False
    )
    if done.returncode:
        raise click.ClickException(f"{' '.join(line)}:\n{done.stdout}{done.stderr}")
