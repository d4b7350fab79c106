"""Open a COGS file wherever it is: on disk, in memory, on a network."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from cogsplat.codec.errors import FormatError, StorageError
from cogsplat.formats.network.opening import open_url
from cogsplat.formats.network.options import NetworkOptions
from cogsplat.formats.network.urls import is_url
from cogsplat.formats.storage.limits import Limits
from cogsplat.formats.storage.source import Readable, Source

from .reader import CogsFile, open_cogs
from .sources import cogs_source

Result = TypeVar("Result")


def source_of_place(
    place: Readable, network: NetworkOptions | None = None, *, fresh: bool = False
) -> Source:
    """Return what reads ranges of a file, by its path or its URL, or of what `cogs_source` takes.

    Parameters
    ----------
    place : Readable
        A text with a scheme that `formats.network.urls` knows is a URL; every other is a path.
    network : NetworkOptions, optional
    fresh : bool
        Go around caches of the network.

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
        return open_url(place, network, fresh=fresh)
    return cogs_source(place)


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
) -> Result:
    """Open a COGS file, do something with it and close it; begin anew, once, where it changed.

    Parameters
    ----------
    work : callable
        Of the open file.
    close : bool
        Whether the file is closed where the work succeeds.

    Other parameters are those of `open_place`, which says what is raised.
    """

    def once(*, fresh: bool) -> Result:
        source = source_of_place(place, network, fresh=fresh)
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
