"""Files on a network by their addresses."""

from __future__ import annotations

from .answers import NeighbouringTransport
from .http_transport import HttpTransport
from .object_transport import ObjectTransport
from .options import NetworkOptions
from .range_source import RangeSource
from .urls import HTTP_SCHEMES, scheme_of, shown


def open_url(
    url: str, options: NetworkOptions | None = None, *, fresh: bool = False
) -> RangeSource:
    """Open a file on a network; its first 64 KiB are asked for.

    Parameters
    ----------
    url : str
        ``http://``, ``https://``, or of an object store: ``s3://``, ``gs://``, ``az://``.
    options : NetworkOptions, optional
    fresh : bool
        Go around caches.

    Returns
    -------
    RangeSource
        A context manager; `RangeSource.close` ends its requests.

    Raises
    ------
    StorageError
        As `RangeSource` says.
    MissingExtraError
        ``needs-http``, ``needs-cloud``: the packages of the extra are not installed.
    ValueError
        It is no such address.

    Examples
    --------
    >>> from cogsplat.formats.network.open_url import open_url
    >>> with open_url("https://example.org/scene.cogs") as source:
    ...     source.size > 64
    True
    """
    options = options or NetworkOptions()
    return RangeSource(transport_of(url, options), shown(url), options, fresh=fresh)


def transport_of(url: str, options: NetworkOptions) -> NeighbouringTransport:
    """Return what asks for ranges of a file by its address; raises as `open_url`."""
    scheme = scheme_of(url)
    if scheme in HTTP_SCHEMES:
        return HttpTransport(url, options)
    if scheme:
        return ObjectTransport(url, options)
    raise ValueError(f"{shown(url)!r}, expected the address of a file")
