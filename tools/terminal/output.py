"""Printed output of commands: JSON, sizes, labelled lines, tables."""

from __future__ import annotations

import io
import json
import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import click
from rich.console import Console
from rich.table import Table
from rich.text import Text

from cogsplat.codec.errors import printable

from .standard_streams import hold_back, is_output_reserved, with_display_names

Json = Mapping[str, object]

WARNINGS: Final = "cogsplat.warnings"
"""Key of a click context under which the warnings of a command wait for its JSON object."""

_LABEL_WIDTH: Final = 11
_TABLE_WIDTH: Final = 200


def print_line(text: str) -> None:
    """Print a line to standard output, or to standard error if a file goes to standard output.

    Control characters, and characters that the encoding lacks, are escaped.
    """
    _print(printable(with_display_names(text)))


def print_error_line(text: str) -> None:
    """Print a line to standard error, escaped as by `print_line`."""
    _print(printable(with_display_names(text)), to_error=True)


def _print(text: str, *, to_error: bool | None = None) -> None:
    """Print a line to standard output or standard error.

    Parameters
    ----------
    text : str
    to_error : bool or None
        Whether to print to standard error; None for standard error only if standard output is
        reserved for a file.
    """
    to_error = is_output_reserved() if to_error is None else to_error
    stream = sys.stderr if to_error else sys.stdout
    encoding = getattr(stream, "encoding", None) or "utf-8"
    click.echo(text.encode(encoding, "backslashreplace").decode(encoding), err=to_error)


def print_json(value: Json) -> None:
    """Print one JSON object, with the warnings of the command under ``warnings``.

    A command that writes to an object store prints it after the upload.
    """
    context = click.get_current_context(silent=True)
    texts = context.meta.get(WARNINGS) if context else None
    whole = {**value, "warnings": texts} if texts else value
    text = json.dumps(whole, indent=2, allow_nan=False)
    if not hold_back(text):
        click.echo(text)


def print_facts(*rows: tuple[str, str]) -> None:
    """Print lines of a label and a text; lines with an empty text are left out."""
    for label, text in rows:
        if text:
            print_line(f"  {label:<{_LABEL_WIDTH}} {text}")


def print_table(columns: Sequence[str], rows: Sequence[Sequence[str]], *, left: int = 1) -> None:
    """Print a table.

    Parameters
    ----------
    columns : sequence of str
        Headings.
    rows : sequence of sequence of str
        Texts of the cells.
    left : int
        Number of leading columns aligned left; the others are aligned right.
    """
    grid = Table(box=None, pad_edge=False, padding=(0, 1, 0, 1), header_style="dim")
    for index, column in enumerate(columns):
        grid.add_column(column, justify="left" if index < left else "right", no_wrap=True)
    for row in rows:
        grid.add_row(*(Text(printable(cell)) for cell in row))
    terminal = sys.stdout is not None and sys.stdout.isatty()
    # Into a string, because `_print` alone handles a closed pipe.
    page = io.StringIO()
    # Wider than any table, so that a narrow terminal wraps lines and loses no digit.
    Console(file=page, force_terminal=terminal, width=_TABLE_WIDTH, highlight=False).print(grid)
    for line in page.getvalue().splitlines():
        # Cells are escaped already; the colours of the headings must stay.
        _print(f" {line.rstrip()}")


def size_text(size_bytes: int) -> str:
    """Return a byte count as text, such as 812 B, 64.0 KiB or 1.31 MiB."""
    if size_bytes < 1 << 10:
        return f"{size_bytes} B"
    for unit, scale in (("KiB", 1 << 10), ("MiB", 1 << 20)):
        if size_bytes < scale << 10:
            return f"{size_bytes / scale:.{1 if unit == 'KiB' else 2}f} {unit}"
    return f"{size_bytes / (1 << 30):.2f} GiB"


def count_text(count: int, noun: str) -> str:
    """Return a count with its noun, such as ``1 chunk`` or ``12,000 splats``."""
    return f"{count:,} {noun}" + ("" if count == 1 else "s")


def display_title(path: Path, *, in_folder: bool = False) -> str:
    """Return the title of a file in pages and charts: its name, or the name of its stream.

    Parameters
    ----------
    path : Path
        A file, or the temporary file of a stream.
    in_folder : bool
        Whether the name of the folder precedes the name of the file.
    """
    shown = display_name(path)
    if shown != os.fspath(path):
        return shown
    return f"{path.absolute().parent.name}/{path.name}" if in_folder else path.name


def display_name(path: Path) -> str:
    """Return a path as the user gave it: the path itself, a URL, or the name of a stream."""
    return with_display_names(os.fspath(path))
