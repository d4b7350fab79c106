"""Convert a COGS file into a folder and back: `cogsplat.unpack` and `cogsplat.pack`."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from cogsplat.codec.progress import Progress, silent
from cogsplat.formats.network.network_options import NetworkOptions
from cogsplat.formats.storage.atomic import StrPath, check_output, is_file, is_folder
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
    """Write a COGS file as a folder: a manifest, and objects named by their hash (SPEC 3.4).

    Parameters
    ----------
    path : path, URL, bytes, binary file object or Source
        COGS file to read, as in `cogsplat.open`.
    folder : path
        Output folder, created if missing. Existing objects are kept and shared.
    name : str
        File name of the manifest, ending in ``.cogsm``. Several manifests in one folder are
        versions that share objects.
    partial : bool
        Whether to accept a file that is still being received, and write its present segments.
    force : bool
        Whether to replace an existing manifest.
    limits : Limits, optional
        Memory and size limits.
    network : NetworkOptions, optional
        Options for a URL.
    progress : Progress
        Callback, called with ``("unpack", segments done, segments)``.

    Returns
    -------
    Unpacked
        Manifest, and counts of written and shared objects.

    Raises
    ------
    CogsplatError
        The file cannot be read or breaks SPEC, or the folder cannot be written.
    ValueError
        `name` is not a valid manifest name.

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
    """Write a folder as one COGS file, identical to the file that was unpacked.

    Parameters
    ----------
    folder : path, URL or Source
        Folder or manifest to read, as in `cogsplat.open`.
    path : path
        Output file; it appears once it is complete.
    partial : bool
        Whether to accept a folder with missing segments; the file ends before the first of them.
    force : bool
        Whether to replace an existing file.
    limits : Limits, optional
        Memory and size limits.
    network : NetworkOptions, optional
        Options for a URL.
    progress : Progress
        Callback, called with ``("pack", segments done, segments)``.

    Returns
    -------
    int
        Length of the written file, bytes.

    Raises
    ------
    OutputIsInputError
        ``output-is-input``: `path` is a file of the folder.
    CogsplatError
        The folder cannot be read, a segment has another hash, or the file cannot be written.

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
    """Yield the paths of a local folder and its files, which an output must not overwrite."""
    if not isinstance(folder, str | os.PathLike):
        return
    place = Path(folder)
    objects = place if is_folder(place) else place.parent / SEGMENT_FOLDER
    yield place
    yield from (inner for inner in objects.rglob("*") if is_file(inner))
