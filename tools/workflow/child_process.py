"""Commands in child processes, which end with the parent process even if it is killed."""

from __future__ import annotations

import _thread
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

import cogsplat

# Time in which an interrupted command removes its temporary files, seconds. Compiled functions may
# run for seconds before Python sees the interrupt.
_GRACE_SECONDS: Final = 5.0

_INTERRUPTED_STATUS: Final = 130


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
                [sys.executable, "-P", "-m", __name__, *words],
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


def _end_with_parent() -> None:
    """Wait for the end of standard input, then interrupt this process."""
    while os.read(0, 1):
        pass
    _thread.interrupt_main()
    time.sleep(_GRACE_SECONDS)
    os._exit(_INTERRUPTED_STATUS)


def main() -> None:
    """Run a ``cogsplat`` command until it is finished or the parent process ends."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    from cogsplat.tools.main import main as run_command

    run_command()


if __name__ == "__main__":
    main()
