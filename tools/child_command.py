"""Run a ``cogsplat`` command that ends with its parent process (`workflow.child_process`)."""

from __future__ import annotations

import _thread
import os
import threading
import time
from typing import Final

from cogsplat.tools.main import main as run_command

# Time in which an interrupted command removes its temporary files, seconds. Compiled functions may
# run for seconds before Python sees the interrupt.
_GRACE_SECONDS: Final = 5.0

_INTERRUPTED_STATUS: Final = 130


def _end_with_parent() -> None:
    """Wait for the end of standard input, then interrupt this process."""
    while os.read(0, 1):
        pass
    _thread.interrupt_main()
    time.sleep(_GRACE_SECONDS)
    os._exit(_INTERRUPTED_STATUS)


def main() -> None:
    """Run the command until it is finished or the parent process ends."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    run_command()


if __name__ == "__main__":
    main()
