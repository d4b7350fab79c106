"""The table of foreign scene formats, found by their first bytes, then by their extension.

To add a format, write one file ``formats/scenes/<name>.py`` with a sniffer, a reader and, where
it can be written, a writer, and add one row to `FORMATS`.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from cogsplat.codec.errors import FormatError, UnsupportedError
from cogsplat.codec.splats import Splats
from cogsplat.codec.workspace import IN_MEMORY, Zeros
from cogsplat.formats.cogs.folder_map import MANIFEST_NAME, MANIFEST_SUFFIX
from cogsplat.formats.scenes.gltf.file import gltf_files
from cogsplat.formats.scenes.gltf.scene import is_gltf, read_gltf, write_gltf
from cogsplat.formats.scenes.ply.header import is_ply
from cogsplat.formats.scenes.ply.scene import read_ply, write_ply
from cogsplat.formats.scenes.sog.scene import is_sog, read_sog, sog_files, write_sog
from cogsplat.formats.scenes.spz.container import is_spz
from cogsplat.formats.scenes.spz.scene import DEFAULT_VERSION, read_spz, write_spz
from cogsplat.formats.scenes.spz.values import PRECISIONS
from cogsplat.formats.storage.atomic import StrPath, open_for_read, storage_errors
from cogsplat.formats.storage.limits import Limits
from cogsplat.formats.storage.magic import COGS_MAGIC, MANIFEST_MAGIC, describe

from .compressed_ply import is_compressed_ply, read_compressed_ply, write_compressed_ply
from .ksplat import read_ksplat
from .splat import no_magic, read_splat, write_splat
from .torch_checkpoint import is_torch_checkpoint, read_torch_checkpoint

HEAD_BYTES = 65536
"""Bytes that a sniffer is given, fewer where the file is shorter."""


class Reader(Protocol):
    """What reads a scene of unknown origin."""

    def __call__(self, path: StrPath, *, limits: Limits | None = None) -> Splats:
        """Return the scene in `path`, or raise where it costs more than `limits` allow."""


class Writer(Protocol):
    """A function that writes a scene, whole or not at all."""

    def __call__(self, splats: Splats, path: StrPath, *, force: bool = False) -> None:
        """Write `splats` to `path`, replacing an existing file only with `force`."""


@dataclass(frozen=True)
class Format:
    """A foreign format.

    Parameters
    ----------
    name : str
        As messages and the command line call it.
    extensions : tuple of str
        In lower case with their dots, ``".compressed.ply"`` among them; where several fit a path,
        the longest wins.
    sniff : callable
        Tells from the first `HEAD_BYTES` whether a file is of this format. A format without a
        magic always says no and is found by its extension.
    read : callable
        Gives the scene in a file.
    write : callable or None
        Writes one, where this format can be written.
    files : callable or None
        Gives the files that a scene lies in, where they may be several.
    names : tuple of str
        Whole names of files, in lower case, that say this format as an extension does.
    """

    name: str
    extensions: tuple[str, ...]
    sniff: Callable[[bytes], bool]
    read: Reader
    write: Writer | None
    files: Callable[[StrPath], list[Path]] | None = None
    names: tuple[str, ...] = ()


# The first one whose sniffer says yes reads the file: the narrower of two goes first.
FORMATS: tuple[Format, ...] = (
    Format(
        "compressed ply",
        (".compressed.ply",),
        is_compressed_ply,
        read_compressed_ply,
        write_compressed_ply,
    ),
    Format("ply", (".ply",), is_ply, read_ply, write_ply),
    Format("gltf", (".glb", ".gltf"), is_gltf, read_gltf, write_gltf, gltf_files),
    Format(
        "torch checkpoint",
        (".pt", ".pth", ".ckpt"),
        is_torch_checkpoint,
        read_torch_checkpoint,
        None,
    ),
    Format("sog", (".sog",), is_sog, read_sog, write_sog, sog_files, ("meta.json",)),
    Format("spz", (".spz",), is_spz, read_spz, write_spz),
    Format("splat", (".splat",), no_magic, read_splat, write_splat),
    Format("ksplat", (".ksplat",), no_magic, read_ksplat, None),
)

WRITABLE: tuple[str, ...] = tuple(format_.name for format_ in FORMATS if format_.write)
"""Names of the formats that can be written."""


def is_cogs(path: StrPath) -> bool:
    """Tell whether a path is a COGS file, a COGS folder or its manifest, which are not read here.

    A damaged one counts by its extension, so that the container's reader can say what is wrong.

    Raises
    ------
    StorageError
        As `open_for_read`.
    """
    if (Path(path) / MANIFEST_NAME).is_file():
        return True
    head = _head(path)
    if head.startswith((COGS_MAGIC, MANIFEST_MAGIC)):
        return True
    named = os.fspath(path).lower().endswith((".cogs", MANIFEST_SUFFIX))
    return named and not any(format_.sniff(head) for format_ in FORMATS)


def read_scene(
    path: StrPath, *, limits: Limits | None = None, zeros: Zeros = IN_MEMORY.zeros
) -> Splats:
    """Read a scene of any foreign format.

    Parameters
    ----------
    path : path
    limits : Limits, optional
        What the file may cost.
    zeros : callable
        Makes the arrays of a PLY, as `Workspace.zeros` does; those of other formats are in memory.

    Raises
    ------
    LimitError
        It costs more.
    FormatError
        ``unknown-format``: neither first bytes nor extension are known; ``cogs-file``: it is a
        COGS container. Otherwise as the format's reader.
    StorageError
        As `open_for_read`.
    """
    format_ = format_of(path)
    if format_.read is read_ply:
        return read_ply(path, limits=limits, zeros=zeros)
    return format_.read(path, limits=limits)


def scene_bytes(path: StrPath) -> int:
    """Return the bytes of a foreign scene, those of files that it names beside it included.

    A file that is named and not there counts nothing: the reader says whether it is needed.

    Raises
    ------
    CogsplatError
        As `read_scene`.
    """
    total = 0
    for part in scene_files(path):
        with storage_errors(part):
            total += part.stat().st_size if part.exists() else 0
    return total


def scene_files(path: StrPath) -> list[Path]:
    """Return the file of a foreign scene and those that it names beside it, there or not.

    Raises
    ------
    CogsplatError
        As `read_scene`.
    """
    files = format_of(path).files
    return files(path) if files else [Path(path)]


def format_of(path: StrPath) -> Format:
    """Return the foreign format of a file, by its first bytes, then by its extension.

    Raises
    ------
    FormatError
        ``unknown-format``, ``cogs-file``.
    StorageError
        As `open_for_read`.
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
            f"{os.fspath(path)}: is {describe(head)}, expected {_known(FORMATS)}",
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
    path : path
    splats : Splats
    force : bool
        Whether an existing file may be replaced.
    format_name : str, optional
        One of `WRITABLE`; by default the format that the extension names.
    absolute : bool
        As `write_ply`, which alone knows it.
    spz_precision : str, optional
        As the precision of `write_spz`, which alone knows it.
    spz_version : int, optional
        As the version of `write_spz`.

    Raises
    ------
    ValueError
        `absolute` and another format than PLY, `spz_precision` or `spz_version` and another than
        SPZ.
    FormatError, UnsupportedError
        As `format_to_write`.
    StorageError
        As `atomic_write`, ``exists`` among them.
    """
    format_ = format_to_write(path, format_name)
    if absolute:
        if format_.write is not write_ply:
            raise ValueError(f"absolute centres in {format_.name}, expected ply")
        write_ply(splats, path, force=force, absolute=True)
        return
    if spz_precision is not None or spz_version is not None:
        if format_.write is not write_spz:
            raise ValueError(f"a precision or version of SPZ in {format_.name}, expected spz")
        precision = PRECISIONS[0] if spz_precision is None else spz_precision
        version = DEFAULT_VERSION if spz_version is None else spz_version
        write_spz(splats, path, force=force, precision=precision, version=version)
        return
    write = format_.write
    assert write is not None
    write(splats, path, force=force)


def format_to_write(path: StrPath, format_name: str | None = None) -> Format:
    """Return the foreign format of this name or else extension, one that can be written.

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
            f"{os.fspath(path)}: no format {what}, expected {_known(writable)}",
        )
    if format_.write is None:
        raise UnsupportedError(
            "read-only-format",
            f"{os.fspath(path)}: {format_.name} is not written, expected {_known(writable)}",
        )
    return format_


def _head(path: StrPath) -> bytes:
    with storage_errors(path), open_for_read(path) as file:
        return file.read(HEAD_BYTES)


def _by_extension(path: StrPath) -> Format | None:
    name = Path(path).name.lower()
    matches = [(len(e), f) for f in FORMATS for e in f.extensions if name.endswith(e)]
    matches += [(len(name), f) for f in FORMATS if name in f.names]
    return max(matches, key=lambda match: match[0])[1] if matches else None


def _known(formats: tuple[Format, ...]) -> str:
    return " or ".join(f"{f.name} ({', '.join(f.extensions + f.names)})" for f in formats)
