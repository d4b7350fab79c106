"""Names of output files: their formats, and refusal of a name of another format."""

from __future__ import annotations

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

# Extensions of other kinds of files. A name with no known extension is accepted for any format.
_DOCUMENTS: Final = (
    *(".jpg", ".jpeg", ".webp", ".gif", ".bmp", ".tif", ".tiff", ".exr", ".svg", ".pdf", ".mp4"),
    *(".json", ".csv", ".txt", ".md", ".npz", ".zip", ".gz", ".rad", ".usd", ".usda", ".usdz"),
)
_KNOWN: Final = (
    *COGS,
    *PNG,
    *NPY,
    *HTML,
    *_DOCUMENTS,
    *(extension for format_ in FORMATS for extension in format_.extensions),
)


def format_option(names: Sequence[str], without: str) -> Callable[[Command], Command]:
    """Return the option ``--format``; `without` ends its help, on what happens without it."""
    return click.option(
        "--format",
        "format_name",
        type=click.Choice(tuple(names)),
        help=f"Format of the output. {without}",
    )


def scene_format(path: Path, format_name: str | None) -> Format:
    """Return the foreign format to write, by `format_name` or else by the extension.

    Raises
    ------
    click.UsageError
        The name or extension is unknown, or the format is only read.
    """
    try:
        return format_to_write(path, format_name)
    except (FormatError, UnsupportedError) as error:
        raise click.UsageError(error.message) from error


def written_bytes(path: Path, format_: Format) -> int:
    """Return the size in bytes of a scene that was written, with the files it refers to.

    Raises
    ------
    StorageError
        A file cannot be examined.
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
        Extensions of the format, in lower case with their dots.
    insisted : bool
        Whether the user named the format as well, which accepts any name.

    Raises
    ------
    click.UsageError
        The extension belongs to another format.
    """
    name = path.name.lower()
    if insisted or name.endswith(tuple(extensions)):
        return
    found = [extension for extension in _KNOWN if name.endswith(extension)]
    if found:
        raise click.UsageError(
            f"{path}: the name ends in {max(found, key=len)}, expected a name that ends in "
            f"{' or '.join(extensions)}"
        )
