"""A table of the bytes that each kind of stream takes in a COGS file."""

from __future__ import annotations

from cogsplat.formats.cogs.reader import CogsFile
from cogsplat.tools.evaluation.byte_inventory import StoredSize
from cogsplat.tools.terminal.output import print_line, print_table


def print_byte_table(sizes: list[StoredSize], file: CogsFile) -> None:
    """Print the bytes of each kind of stream, and their sum.

    Parameters
    ----------
    sizes : list of StoredSize
        Stored bytes of each kind of stream.
    file : CogsFile
        The file that holds them.
    """
    rows = [
        (
            size.segment,
            size.label,
            f"{size.stored_bytes:,}",
            f"{size.stored_bytes / file.file_length:.1%}",
            f"{8 * size.stored_bytes / max(file.root.splats, 1):.2f}",
        )
        for size in sizes
    ]
    total = sum(size.stored_bytes for size in sizes)
    each = f"{8 * total / max(file.root.splats, 1):.2f}"
    rows.append(("", "total", f"{total:,}", f"{total / file.file_length:.1%}", each))
    print_line("")
    print_table(("segment", "stream", "bytes", "share", "bits/splat"), rows, left=2)
