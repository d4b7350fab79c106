"""Names of outputs: one that says another format than what is written is refused."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final, TypeVar

import click

from cogsplat.codec.errors import FormatError, UnsupportedError
from cogsplat.formats.scenes.registry import FORMATS, Format, format_to_write
from cogsplat.formats.storage.atomic import storage_errors

Command = TypeVar("Command", bound=Callable[..., object])

COGS: Final = (".cogs",)
PNG: Final = (".png",)
NPY: Final = (".npy",)
HTML: Final = (".html", ".htm")

# Extensions that mean something else to other programs; a name with none of them says nothing.
_DOCUMENTS: Final = (
    *(".jpg", ".jpeg", ".webp", ".gif", ".bmp", ".tif", ".tiff", ".exr", ".svg", ".pdf", ".mp4"),
    *(".json", ".csv", ".txt", ".md", ".npz", ".zip", ".gz", ".rad", ".usd", ".usda", ".usdz"),
)
_MEANINGFUL: Final = (
    *COGS,
    *PNG,
    *NPY,
    *HTML,
    *_DOCUMENTS,
    *(extension for format_ in FORMATS for extension in format_.extensions),
)


def format_option(names: Sequence[str], what: str) -> Callable[[Command], Command]:
    """Add ``--format``; `what` says what the name of the output decides without it."""
    return click.option(
        "--format",
        "format_name",
        type=click.Choice(tuple(names)),
        help=f"Write this format whatever the output is called. {what}",
    )


def scene_format(path: Path, format_name: str | None) -> Format:
    """Return the foreign format to write, by the name given or else by the output's extension.

    Raises
    ------
    click.UsageError
        There is none of that name or extension, or it is not written.
    """
    try:
        return format_to_write(path, format_name)
    except (FormatError, UnsupportedError) as error:
        raise click.UsageError(error.message) from error


def written_bytes(path: Path, format_: Format) -> int:
    """Return the bytes of a foreign scene just written, files beside `path` included.

    Raises
    ------
    StorageError
        They cannot be looked at.
    """
    total = 0
    for part in format_.files(path) if format_.files else [path]:
        with storage_errors(part):
            total += part.stat().st_size
    return total


def check_name(path: Path, extensions: Sequence[str], *, insisted: bool = False) -> None:
    """Refuse an output whose extension names another format than the one to be written.

    Parameters
    ----------
    path : Path
        The output.
    extensions : sequence of str
        Of the format, in lower case with their dots.
    insisted : bool
        Whether the user named the format, too.

    Raises
    ------
    click.UsageError
        It does; a name that says nothing is taken.
    """
    name = path.name.lower()
    if insisted or name.endswith(tuple(extensions)):
        return
    said = [extension for extension in _MEANINGFUL if name.endswith(extension)]
    if said:
        raise click.UsageError(
            f"{path}: its name says {max(said, key=len)}, expected a name that ends in "
            f"{' or '.join(extensions)}"
        )


def check_distinct(*paths: Path | None) -> None:
    """Refuse outputs of one command that are one file, links followed.

    Raises
    ------
    click.UsageError
        Two are; None stands for an output that is not asked for.
    """
    seen: dict[str, Path] = {}
    for path in paths:
        if path is None:
            continue
        other = seen.setdefault(os.path.realpath(path), path)
        if other is not path:
            raise click.UsageError(f"{path}: is {other}, another output, expected two files")
