"""A process that compiles the kernels that it is told, for another one that will call them.

It reads the name of one kernel a line, and writes the name once the kernel's machine code is on
disk.
"""

from __future__ import annotations

import sys

from cogsplat.codec.compiling import kernel_by_name


def main() -> None:
    """Compile until standard input ends."""
    for line in sys.stdin:
        name = line.strip()
        kernel_by_name(name).compile()
        print(name, flush=True)


if __name__ == "__main__":
    main()
