"""A file into a folder and back, from wherever it is: `cogsplat.unpack` and `cogsplat.pack`."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from cogsplat.codec.progress import Progress, silent
from cogsplat.formats.network.network_options import NetworkOptions
from cogsplat.formats.storage.atomic import StrPath, check_output
from cogsplat.formats.storage.limits import Limits
from cogsplat.formats.storage.source import Readable

from .folder_map import MANIFEST_NAME
from .folder_places import SEGMENT_FOLDER
from .folder_writer import Unpacked, pack_cogs, unpack_cogs
from .open_file import with_open_scene


def unpack(
    path: Readable,
    folder: StrPath,
    *,
    name: str = MANIFEST_NAME,
    partial: bool = False,
    force: bool = False,
    limits: Limits | None = None,
    network: NetworkOptions | None = None,
    progress: Progress = silent,
) -> Unpacked:
    """Write a COGS file as a folder: a manifest, and objects named by their content (SPEC 3.4).

    Parameters
    ----------
    path : path, URL, bytes, binary file object or Source
        As in `cogsplat.open`, as are `limits` and `network`.
    partial : bool
        Accept a file that is still being received: the segments that are there are written.
    folder : path
        Made where it is not there. Objects that it has already are kept.
    name : str
        Of the manifest, a file name that ends in ``.cogsm``; several in one folder are versions
        that share segments.
    force : bool
        Replace an existing manifest.
    progress : Progress
        Called with ``("unpack", segments done, segments)``.

    Returns
    -------
    Unpacked
        What was written, and what was there.

    Raises
    ------
    CogsplatError
        The file cannot be read or breaks SPEC, or the folder cannot be written.
    ValueError
        A name that no manifest may have.

    Examples
    --------
    >>> import cogsplat
    >>> done = cogsplat.unpack("scene.cogs", "scene")
    >>> done.manifest.name, done.shared
    ('manifest.cogsm', 0)
    """
    return with_open_scene(
        lambda file: unpack_cogs(file, Path(folder), name=name, force=force, progress=progress),
        path,
        partial=partial,
        limits=limits,
        network=network,
    )


def pack(
    folder: Readable,
    path: StrPath,
    *,
    partial: bool = False,
    force: bool = False,
    limits: Limits | None = None,
    network: NetworkOptions | None = None,
    progress: Progress = silent,
) -> int:
    """Write a folder as one COGS file, byte for byte the one that it was unpacked from.

    Parameters
    ----------
    folder : path, URL or Source
        As in `cogsplat.open`, as are `limits` and `network`; one of several manifests by its own
        path.
    partial : bool
        Accept a folder that lacks segments: the file ends before the first that is missing.
    path : path
        The file to write; it appears once it is complete.
    force : bool
        Replace an existing file.
    progress : Progress
        Called with ``("pack", segments done, segments)``.

    Returns
    -------
    int
        Bytes written.

    Raises
    ------
    OutputIsInputError
        ``output-is-input``: `path` is a file of the folder.
    CogsplatError
        The folder cannot be read, a segment is not what its hash says, or the file cannot be
        written.

    Examples
    --------
    >>> import cogsplat
    >>> from pathlib import Path
    >>> done = cogsplat.unpack("scene.cogs", "scene")
    >>> size = cogsplat.pack("scene", "again.cogs")
    >>> Path("again.cogs").read_bytes() == Path("scene.cogs").read_bytes()
    True
    """
    check_output(path, force=force, inputs=folder_files(folder))
    return with_open_scene(
        lambda file: pack_cogs(file, Path(path), force=force, progress=progress),
        folder,
        partial=partial,
        limits=limits,
        network=network,
    )


def folder_files(folder: Readable) -> Iterator[Path]:
    """Yield the files of a folder on disk, or a manifest and its objects: no output may be one."""
    if not isinstance(folder, str | os.PathLike):
        return
    place = Path(folder)
    objects = place if place.is_dir() else place.parent / SEGMENT_FOLDER
    yield place
    yield from (inner for inner in objects.rglob("*") if inner.is_file())
