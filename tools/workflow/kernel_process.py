"""Program that compiles kernels for another process (`compile_ahead`).

It reads one kernel name a line and prints the name when the kernel's machine code is on disk.
"""

from __future__ import annotations

import sys

from cogsplat.codec.compiling import kernel_by_name


def main() -> None:
    """Compile the named kernels until standard input ends."""
    for line in sys.stdin:
        name = line.strip()
        kernel_by_name(name).compile()
        print(name, flush=True)


if __name__ == "__main__":
    main()
