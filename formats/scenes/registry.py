"""Foreign scene formats: one table, searched by a file's first bytes, then by its extension.

To add a format, write one file ``formats/scenes/<name>.py`` with a sniffer, a reader and, if
needed, a writer; then add one row to `FORMATS`.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cogsplat.codec.errors import FormatError, UnsupportedError
from cogsplat.codec.geometry.rotations import normalise_extremes
from cogsplat.codec.splats import Splats
from cogsplat.codec.workspace import IN_MEMORY, Zeros
from cogsplat.formats.cogs.folder_map import MANIFEST_NAME, MANIFEST_SUFFIX
from cogsplat.formats.scenes.gltf.file import gltf_files
from cogsplat.formats.scenes.gltf.gltf_scene import is_gltf, read_gltf, write_gltf
from cogsplat.formats.scenes.ply.header import is_ply
from cogsplat.formats.scenes.ply.ply_scene import read_ply, write_ply
from cogsplat.formats.scenes.sog.sog_scene import is_sog, read_sog, sog_files, write_sog
from cogsplat.formats.scenes.spz.container import is_spz
from cogsplat.formats.scenes.spz.spz_scene import read_spz, write_spz
from cogsplat.formats.storage.atomic import StrPath, exists, is_file, open_for_read, storage_errors
from cogsplat.formats.storage.limits import Limits
from cogsplat.formats.storage.magic import COGS_MAGIC, MANIFEST_MAGIC, describe

from .compressed_ply import is_compressed_ply, read_compressed_ply, write_compressed_ply
from .ksplat import read_ksplat
from .splat import no_magic, read_splat, write_splat
from .torch_checkpoint import is_torch_checkpoint, read_torch_checkpoint

HEAD_BYTES: Final = 65536
"""First bytes of a file that a sniffer receives; fewer if the file is shorter."""


@dataclass(frozen=True)
class Format:
    """A foreign scene format: its names, and the functions that read and write it.

    Parameters
    ----------
    name : str
        Name in messages and on the command line.
    extensions : tuple of str
        Lower-case extensions with their dots, e.g. ``".compressed.ply"``. If several match a path,
        the longest decides.
    sniff : callable
        Test whether the first `HEAD_BYTES` of a file are of this format. A format without magic
        bytes always answers no, so its extension decides.
    read : callable
        Reader: ``read(path, *, limits=None)`` returns `Splats`.
    write : callable or None
        Writer: ``write(splats, path, *, force=False)`` writes the whole file or none. None if the
        format is read-only.
    files : callable or None
        List the files of a scene, for a format that may use several.
    names : tuple of str
        Lower-case file names that identify the format, like an extension.
    reads_into_arrays : bool
        Whether `read` also has the keyword ``zeros``: a function that allocates the arrays.
    write_options : frozenset of str
        Further keywords of `write`.
    """

    name: str
    extensions: tuple[str, ...]
    sniff: Callable[[bytes], bool]
    read: Callable[..., Splats]
    write: Callable[..., None] | None
    files: Callable[[StrPath], list[Path]] | None = None
    names: tuple[str, ...] = ()
    reads_into_arrays: bool = False
    write_options: frozenset[str] = frozenset()


# The first format whose sniffer answers yes reads the file, so special cases precede general ones.
FORMATS: tuple[Format, ...] = (
    Format(
        "compressed ply",
        (".compressed.ply",),
        is_compressed_ply,
        read_compressed_ply,
        write_compressed_ply,
    ),
    Format(
        "ply",
        (".ply",),
        is_ply,
        read_ply,
        write_ply,
        reads_into_arrays=True,
        write_options=frozenset({"absolute"}),
    ),
    Format("gltf", (".glb", ".gltf"), is_gltf, read_gltf, write_gltf, gltf_files),
    Format(
        "torch checkpoint",
        (".pt", ".pth", ".ckpt"),
        is_torch_checkpoint,
        read_torch_checkpoint,
        None,
    ),
    Format("sog", (".sog",), is_sog, read_sog, write_sog, sog_files, ("meta.json",)),
    Format(
        "spz",
        (".spz",),
        is_spz,
        read_spz,
        write_spz,
        write_options=frozenset({"precision", "version"}),
    ),
    Format("splat", (".splat",), no_magic, read_splat, write_splat),
    Format("ksplat", (".ksplat",), no_magic, read_ksplat, None),
)

WRITABLE: tuple[str, ...] = tuple(format_.name for format_ in FORMATS if format_.write)
"""Names of the formats that can be written."""


def is_cogs(path: StrPath) -> bool:
    """Tell whether a path is a COGS file, a COGS folder or the folder's manifest.

    A damaged COGS file is recognised by its extension; its own reader reports the damage.

    Raises
    ------
    StorageError
        See `open_for_read`.
    """
    if is_file(Path(path) / MANIFEST_NAME):
        return True
    head = _head(path)
    if head.startswith((COGS_MAGIC, MANIFEST_MAGIC)):
        return True
    named = os.fspath(path).lower().endswith((".cogs", MANIFEST_SUFFIX))
    return named and not any(format_.sniff(head) for format_ in FORMATS)


def read_scene(
    path: StrPath, *, limits: Limits | None = None, zeros: Zeros = IN_MEMORY.zeros
) -> Splats:
    """Read a scene of any foreign format; normalise extreme quaternions (`normalise_extremes`).

    Parameters
    ----------
    path : path
        The scene's file.
    limits : Limits, optional
        Limits on splats and decoded bytes.
    zeros : callable
        Allocator of the arrays, e.g. `Workspace.zeros`. Formats without `Format.reads_into_arrays`
        allocate in memory instead.

    Raises
    ------
    LimitError
        The scene exceeds `limits`.
    FormatError
        ``unknown-format``: the first bytes and the extension are unknown; ``cogs-file``: the file
        is a COGS container. Other codes come from the format's reader.
    StorageError
        See `open_for_read`.
    """
    format_ = format_of(path)
    if format_.reads_into_arrays:
        return normalise_extremes(format_.read(path, limits=limits, zeros=zeros))
    return normalise_extremes(format_.read(path, limits=limits))


def scene_bytes(path: StrPath) -> int:
    """Return the size of a foreign scene in bytes: all its files together.

    A missing file counts as zero bytes; the reader reports it if it is needed.

    Raises
    ------
    CogsplatError
        See `read_scene`.
    """
    total = 0
    for part in scene_files(path):
        with storage_errors(part):
            total += part.stat().st_size if exists(part) else 0
    return total


def scene_files(path: StrPath) -> list[Path]:
    """Return the paths of all files of a foreign scene, including missing ones.

    Raises
    ------
    CogsplatError
        See `read_scene`.
    """
    files = format_of(path).files
    return files(path) if files else [Path(path)]


def format_of(path: StrPath) -> Format:
    """Return the foreign format of a file, from its first bytes, or else from its extension.

    Raises
    ------
    FormatError
        ``unknown-format``, ``cogs-file``.
    StorageError
        See `open_for_read`.
    """
    head = _head(path)
    if head.startswith((COGS_MAGIC, MANIFEST_MAGIC)):
        raise FormatError(
            "cogs-file", f"{os.fspath(path)}: is a COGS file, expected a foreign scene"
        )
    sniffed = next((format_ for format_ in FORMATS if format_.sniff(head)), None)
    format_ = sniffed or _by_extension(path)
    if format_ is None:
        raise FormatError(
            "unknown-format",
            f"{os.fspath(path)}: is {describe(head)}, expected {_describe_formats(FORMATS)}",
        )
    return format_


def write_scene(
    splats: Splats,
    path: StrPath,
    *,
    force: bool = False,
    format_name: str | None = None,
    absolute: bool = False,
    spz_precision: str | None = None,
    spz_version: int | None = None,
) -> None:
    """Write a scene in a foreign format.

    Parameters
    ----------
    splats : Splats
        The scene.
    path : path
        The output.
    force : bool
        Whether an existing file may be replaced.
    format_name : str, optional
        One of `WRITABLE`; by default the path's extension decides.
    absolute : bool
        Whether centres are written in world coordinates (PLY only; see `write_ply`).
    spz_precision : str, optional
        Step size of centres (SPZ only; see `write_spz`).
    spz_version : int, optional
        Version of the file (SPZ only; see `write_spz`).

    Raises
    ------
    ValueError
        The format has no such option, e.g. `absolute` with SPZ.
    FormatError, UnsupportedError
        See `format_to_write`.
    StorageError
        See `atomic_write`, e.g. ``exists``.
    """
    format_ = format_to_write(path, format_name)
    write = format_.write
    assert write is not None
    options = {
        "absolute": absolute or None,
        "precision": spz_precision,
        "version": spz_version,
    }
    chosen = {name: value for name, value in options.items() if value is not None}
    unknown = chosen.keys() - format_.write_options
    if unknown:
        known = ", ".join(sorted(format_.write_options)) or "none"
        raise ValueError(
            f"{format_.name} with the option {', '.join(sorted(unknown))}, expected {known}"
        )
    write(splats, path, force=force, **chosen)


def format_to_write(path: StrPath, format_name: str | None = None) -> Format:
    """Return the writable format called `format_name`, or else the one of the path's extension.

    Raises
    ------
    FormatError
        ``unknown-format``: no format has this name or extension.
    UnsupportedError
        ``read-only-format``: it can be read but not written.
    """
    writable = tuple(format_ for format_ in FORMATS if format_.write)
    format_ = _by_extension(path)
    if format_name is not None:
        format_ = next((known for known in FORMATS if known.name == format_name), None)
    if format_ is None:
        what = "has this extension" if format_name is None else f"is called {format_name!r}"
        raise FormatError(
            "unknown-format",
            f"{os.fspath(path)}: no format {what}, expected {_describe_formats(writable)}",
        )
    if format_.write is None:
        raise UnsupportedError(
            "read-only-format",
            f"{os.fspath(path)}: {format_.name} cannot be written, expected "
            f"{_describe_formats(writable)}",
        )
    return format_


def _head(path: StrPath) -> bytes:
    """Return the first `HEAD_BYTES` of a file."""
    with storage_errors(path), open_for_read(path) as file:
        return file.read(HEAD_BYTES)


def _by_extension(path: StrPath) -> Format | None:
    """Return the format with the longest extension or file name that matches a path."""
    name = Path(path).name.lower()
    matches = [(len(e), f) for f in FORMATS for e in f.extensions if name.endswith(e)]
    matches += [(len(name), f) for f in FORMATS if name in f.names]
    return max(matches, key=lambda match: match[0])[1] if matches else None


def _describe_formats(formats: tuple[Format, ...]) -> str:
    """Return the names and extensions of formats, for a message."""
    return " or ".join(f"{f.name} ({', '.join(f.extensions + f.names)})" for f in formats)
