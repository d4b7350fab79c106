"""Open a COGS file on disk, in memory or on a network."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar
from urllib.parse import urlunsplit

from cogsplat.codec.errors import FormatError, StorageError
from cogsplat.formats.network.network_options import NetworkOptions
from cogsplat.formats.network.open_url import open_url
from cogsplat.formats.network.urls import is_url, redacted, split_url
from cogsplat.formats.storage.limits import Limits
from cogsplat.formats.storage.source import FileSource, Readable, Source, as_source

from .folder_map import MANIFEST_NAME, MAX_MANIFEST_BYTES, FolderMap, is_manifest
from .folder_source import FolderSource, names_folder
from .layout import FIRST_READ, PREAMBLE_BYTES, unpack_preamble
from .network_folder import NetworkFolder
from .reader import CogsFile, open_cogs

Result = TypeVar("Result")


def open_source(
    location: Readable,
    network: NetworkOptions | None = None,
    *,
    bypass_caches: bool = False,
    whole: bool = False,
) -> Source:
    """Return a source for a COGS file, or for a folder as the file that it stands for.

    Parameters
    ----------
    location : str, path, bytes, binary file object or Source
        Path or URL of a file, a folder or a manifest; the URL of a folder ends in a slash. Bytes
        and file objects hold a file.
    network : NetworkOptions, optional
        Timeouts, retries, request sizes and cache for a URL.
    bypass_caches : bool
        Whether to bypass HTTP caches.
    whole : bool
        Whether the whole file will be read. A file at a URL is then requested at once, unless a
        disk cache may hold some of its segments.

    Raises
    ------
    StorageError
        The file cannot be opened.
    FormatError, TruncatedError, UnsupportedError
        The manifest of a folder breaks SPEC 3.4, or its root SPEC 4 and 5.
    MissingExtraError
        The extra for the URL's scheme is not installed.
    TypeError
        `location` has another type.

    Examples
    --------
    >>> open_source(b"scene").size
    5
    """
    if isinstance(location, str) and is_url(location):
        return _open_network_source(location, network, bypass_caches=bypass_caches, whole=whole)
    if isinstance(location, str | os.PathLike):
        path = Path(location)
        return FolderSource(path) if names_folder(path) else FileSource(path)
    return as_source(location)


def _open_network_source(
    url: str, network: NetworkOptions | None, *, bypass_caches: bool, whole: bool
) -> Source:
    """Return a source for a URL: of a file, or of a folder if a manifest is found there."""
    address = manifest_address(url)
    source = open_url(
        address,
        network,
        bypass_caches=bypass_caches,
        length_of=lambda head: _length_of_file(head, redacted(address)),
    )
    try:
        head = source.read(0, min(PREAMBLE_BYTES, source.size))
        if not is_manifest(head):
            if whole and source.cache is None:
                source.fetch_all()
            return source
        size = source.size
        head = source.read(0, min(MAX_MANIFEST_BYTES, size))
    except BaseException:
        source.close()
        raise
    # NetworkFolder has its own event loop, and so its own connections.
    source.close()
    return NetworkFolder(address, head, network, bypass_caches=bypass_caches, manifest_bytes=size)


def _length_of_file(head: bytes, where: str) -> int | None:
    """Return the length of a file or manifest from its first bytes; None if they are too few.

    Raises
    ------
    CogsplatError
        ``not-cogs`` and the other codes of SPEC 3.1, and of SPEC 3.4 for a manifest.
    """
    if not is_manifest(head):
        return unpack_preamble(head, where).file_length
    # The length of a manifest follows from its root; no manifest is longer than the first read.
    return FolderMap(head, where).manifest_bytes if len(head) == FIRST_READ else None


def manifest_address(url: str) -> str:
    """Return the URL of the manifest for a folder's URL, which ends in a slash; else the URL.

    Examples
    --------
    >>> manifest_address("https://example.org/scene/?v=2")
    'https://example.org/scene/manifest.cogsm?v=2'
    """
    parts = split_url(url)
    if not parts.path.endswith("/"):
        return url
    return urlunsplit(parts._replace(path=parts.path + MANIFEST_NAME))


def open_scene(
    location: Readable,
    *,
    partial: bool = False,
    size_bytes: int | None = None,
    limits: Limits | None = None,
    network: NetworkOptions | None = None,
) -> CogsFile:
    """Open a COGS file at a path or URL.

    A file at a URL with a broken index, or one that changes meanwhile, is fetched again without
    HTTP caches, which may have mixed two versions of the file (SPEC 8.8).

    Parameters
    ----------
    location, network
        As in `open_source`.
    partial, size_bytes, limits
        As in `reader.open_cogs`.

    Raises
    ------
    CogsplatError
        The errors of `open_source` and `reader.open_cogs`; ``source-changed``: the file changed
        twice.
    ValueError
        `size_bytes` is negative.
    """
    return with_open_scene(
        lambda file: file,
        location,
        partial=partial,
        size_bytes=size_bytes,
        limits=limits,
        network=network,
        close=False,
    )


def with_open_scene(
    work: Callable[[CogsFile], Result],
    location: Readable,
    *,
    partial: bool = False,
    size_bytes: int | None = None,
    limits: Limits | None = None,
    network: NetworkOptions | None = None,
    close: bool = True,
    whole: bool = False,
) -> Result:
    """Call a function with an open COGS file, and again with a fresh copy if the file changed.

    Parameters
    ----------
    work : callable
        Function of the open `CogsFile`, whose result is returned.
    location, network, whole
        As in `open_source`.
    partial, size_bytes, limits
        As in `reader.open_cogs`.
    close : bool
        Whether to close the file after `work` returns.

    Raises
    ------
    CogsplatError
        The errors of `open_scene` and of `work`.
    """

    def attempt(*, bypass_caches: bool) -> Result:
        source = open_source(location, network, bypass_caches=bypass_caches, whole=whole)
        try:
            file = open_cogs(source, partial=partial, size_bytes=size_bytes, limits=limits)
            result = work(file)
        except BaseException:
            source.close()
            raise
        if close:
            file.close()
        return result

    try:
        return attempt(bypass_caches=False)
    except (FormatError, StorageError) as error:
        changed = isinstance(error, FormatError) or error.code == "source-changed"
        if not (is_url(location) and changed):
            raise
    return attempt(bypass_caches=True)
