"""Open a COGS file wherever it is: on disk, in memory, on a network."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar
from urllib.parse import urlsplit, urlunsplit

from cogsplat.codec.errors import FormatError, StorageError
from cogsplat.formats.network.network_options import NetworkOptions
from cogsplat.formats.network.open_url import open_url
from cogsplat.formats.network.urls import is_url
from cogsplat.formats.storage.limits import Limits
from cogsplat.formats.storage.source import Readable, Source

from .folder_map import MANIFEST_NAME, is_manifest
from .layout import FIRST_READ, PREAMBLE_BYTES
from .network_folder import NetworkFolder
from .reader import CogsFile, open_cogs
from .sources import cogs_source

Result = TypeVar("Result")


def source_of_place(
    place: Readable,
    network: NetworkOptions | None = None,
    *,
    fresh: bool = False,
    whole: bool = False,
) -> Source:
    """Return what reads ranges of a file, by its path or its URL, or of what `cogs_source` takes.

    Parameters
    ----------
    place : Readable
        A text with a scheme that `formats.network.urls` knows is a URL, of a file, of a manifest,
        or of a folder where it ends in a slash; every other is a path.
    network : NetworkOptions, optional
    fresh : bool
        Go around caches of the network.
    whole : bool
        Whether all of it will be read: then all is asked for at once, where it is one file on a
        network and no segment of it can be on disk.

    Raises
    ------
    StorageError
        It cannot be opened.
    MissingExtraError
        The extra is not installed that the URL takes.
    TypeError
        It is nothing that can be read.
    """
    if isinstance(place, str) and is_url(place):
        return _network_source(place, network, fresh=fresh, whole=whole)
    return cogs_source(place)


def _network_source(
    url: str, network: NetworkOptions | None, *, fresh: bool, whole: bool
) -> Source:
    address = manifest_address(url)
    source = open_url(address, network, fresh=fresh)
    try:
        head = source.read(0, min(PREAMBLE_BYTES, source.size))
        if not is_manifest(head):
            if whole and source.cache is None:
                source.fetch_all()
            return source
        size = source.size
        head = source.read(0, min(FIRST_READ, size))
    except BaseException:
        source.close()
        raise
    # Objects are asked for by another event loop, and so over another connection.
    source.close()
    return NetworkFolder(address, head, network, fresh=fresh, manifest_bytes=size)


def manifest_address(url: str) -> str:
    """Return the address of a folder's manifest where a URL ends in a slash; else the URL.

    Examples
    --------
    >>> manifest_address("https://example.org/scene/?v=2")
    'https://example.org/scene/manifest.cogsm?v=2'
    """
    parts = urlsplit(url)
    if not parts.path.endswith("/"):
        return url
    return urlunsplit(parts._replace(path=parts.path + MANIFEST_NAME))


def open_place(
    place: Readable,
    *,
    partial: bool = False,
    size_bytes: int | None = None,
    limits: Limits | None = None,
    network: NetworkOptions | None = None,
) -> CogsFile:
    """Open a COGS file by its path or URL; see `source_of_place` and `reader.open_cogs`.

    Over a network, a file whose index is wrong, or that changes meanwhile, is fetched once more,
    around caches, which may have mixed two versions of it (SPEC 8.8).

    Raises
    ------
    CogsplatError
        As `source_of_place` and `reader.open_cogs`; ``source-changed`` where it changed twice.
    ValueError
        A negative size.
    """
    return with_place(
        lambda file: file,
        place,
        partial=partial,
        size_bytes=size_bytes,
        limits=limits,
        network=network,
        close=False,
    )


def with_place(
    work: Callable[[CogsFile], Result],
    place: Readable,
    *,
    partial: bool = False,
    size_bytes: int | None = None,
    limits: Limits | None = None,
    network: NetworkOptions | None = None,
    close: bool = True,
    whole: bool = False,
) -> Result:
    """Open a COGS file, do something with it and close it; begin anew, once, where it changed.

    Parameters
    ----------
    work : callable
        Of the open file.
    close : bool
        Whether the file is closed where the work succeeds.
    whole : bool
        As in `source_of_place`.

    Other parameters are those of `open_place`, which says what is raised.
    """

    def once(*, fresh: bool) -> Result:
        source = source_of_place(place, network, fresh=fresh, whole=whole)
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
        return once(fresh=False)
    except (FormatError, StorageError) as error:
        changed = isinstance(error, FormatError) or error.code == "source-changed"
        if not (is_url(place) and changed):
            raise
    return once(fresh=True)
