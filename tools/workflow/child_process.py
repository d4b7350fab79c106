"""Commands in child processes, which end with the parent process even if it is killed."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import cogsplat

# Runs a command until it is finished or its standard input ends. A name, because commands import
# this room.
_CHILD_MODULE: Final = "cogsplat.tools.child_command"


@contextmanager
def child_process(words: Sequence[str], folder: Path) -> Iterator[subprocess.Popen[str]]:
    """Start a ``cogsplat`` command, which is interrupted if this process ends before the block.

    Standard input of the command is a pipe without data. The operating system closes the pipe when
    this process ends, even if it is killed.

    Parameters
    ----------
    words : sequence of str
        Command and its arguments.
    folder : Path
        Working folder.

    Yields
    ------
    Popen
        The process, with pipes for output and error output.
    """
    root = Path(cogsplat.__file__).parents[1]
    paths = [str(root), *filter(None, [os.environ.get("PYTHONPATH")])]
    read_end, write_end = os.pipe()
    try:
        try:
            process = subprocess.Popen(
                [sys.executable, "-P", "-m", _CHILD_MODULE, *words],
                cwd=folder,
                env={**os.environ, "PYTHONPATH": os.pathsep.join(paths)},
                stdin=read_end,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                text=True,
            )
        finally:
            os.close(read_end)
        yield process
    finally:
        os.close(write_end)
