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

from .standard_streams import hold_back, is_output_taken, with_streams_named

Json = Mapping[str, object]

WARNINGS: Final = "cogsplat.warnings"
"""Where a click context keeps the warnings of a command, for its JSON object."""

_LABEL_WIDTH: Final = 10
_TABLE_WIDTH: Final = 200


def say(text: str) -> None:
    """Print a line to standard output, or to standard error where the former is for a file.

    Control characters, and characters that the encoding lacks, are escaped.
    """
    _print(printable(with_streams_named(text)))


def note(text: str) -> None:
    """Print a line to standard error, as `say` does."""
    _print(printable(with_streams_named(text)), to_error=True)


def _print(text: str, *, to_error: bool | None = None) -> None:
    to_error = is_output_taken() if to_error is None else to_error
    stream = sys.stderr if to_error else sys.stdout
    encoding = getattr(stream, "encoding", None) or "utf-8"
    click.echo(text.encode(encoding, "backslashreplace").decode(encoding), err=to_error)


def say_json(value: Json) -> None:
    """Print one JSON object, with the command's warnings where there are any.

    Where the command writes into an object store, it is printed once that has taken everything.
    """
    context = click.get_current_context(silent=True)
    told = context.meta.get(WARNINGS) if context else None
    whole = {**value, "warnings": told} if told else value
    text = json.dumps(whole, indent=2, allow_nan=False)
    if not hold_back(text):
        click.echo(text)


def facts(*rows: tuple[str, str]) -> None:
    """Print labelled lines; those with an empty value are left out."""
    for label, text in rows:
        if text:
            say(f"  {label:<{_LABEL_WIDTH}} {text}")


def table(columns: Sequence[str], rows: Sequence[Sequence[str]], *, left: int = 1) -> None:
    """Print rows in columns, numbers flush right.

    Parameters
    ----------
    columns : sequence of str
        Headings.
    rows : sequence of sequence of str
        Cells.
    left : int
        So many columns, counted from the first, are flush left.
    """
    grid = Table(box=None, pad_edge=False, padding=(0, 1, 0, 1), header_style="dim")
    for index, column in enumerate(columns):
        grid.add_column(column, justify="left" if index < left else "right", no_wrap=True)
    for row in rows:
        grid.add_row(*(Text(printable(cell)) for cell in row))
    terminal = sys.stdout is not None and sys.stdout.isatty()
    # Into a string, so that all output goes through one place and meets a closed pipe there.
    page = io.StringIO()
    # Wider than any table here: a narrow terminal wraps lines, which loses no digit.
    Console(file=page, force_terminal=terminal, width=_TABLE_WIDTH, highlight=False).print(grid)
    for line in page.getvalue().splitlines():
        # The escapes in it are our own.
        _print(f" {line.rstrip()}")


def size_text(size_bytes: int) -> str:
    """Return a byte count as text: 812 B, 64.0 KiB, 1.31 MiB."""
    if size_bytes < 1 << 10:
        return f"{size_bytes} B"
    for unit, scale in (("KiB", 1 << 10), ("MiB", 1 << 20)):
        if size_bytes < scale << 10:
            return f"{size_bytes / scale:.{1 if unit == 'KiB' else 2}f} {unit}"
    return f"{size_bytes / (1 << 30):.2f} GiB"


def counted(count: int, noun: str) -> str:
    """Return a number with its noun: ``1 chunk``, ``12,000 splats``."""
    return f"{count:,} {noun}" + ("" if count == 1 else "s")


def title_of(path: Path, *, in_folder: bool = False) -> str:
    """Return what pages and charts call a file: its name, or that of the stream it stands for.

    Parameters
    ----------
    path : Path
    in_folder : bool
        Whether the name of its folder comes before its own.
    """
    named = name_of(path)
    if named != os.fspath(path):
        return named
    return f"{path.absolute().parent.name}/{path.name}" if in_folder else path.name


def name_of(path: Path) -> str:
    """Return a path as the user gave it, or the name of the stream that it stands for."""
    return with_streams_named(os.fspath(path))
