"""Open files on web servers and object stores by their URLs."""

from __future__ import annotations

from .http_transport import HttpTransport
from .network_options import NetworkOptions
from .object_transport import ObjectTransport
from .range_fetcher import LengthOf
from .range_responses import SiblingTransport
from .range_source import RangeSource
from .urls import HTTP_SCHEMES, redacted, scheme_of


def open_url(
    url: str,
    options: NetworkOptions | None = None,
    *,
    bypass_caches: bool = False,
    length_of: LengthOf | None = None,
) -> RangeSource:
    """Open a file on a network and request its first 64 KiB.

    Parameters
    ----------
    url : str
        URL of a web server (``http://``, ``https://``) or an object store (``s3://``, ``gs://``,
        ``az://``).
    options : NetworkOptions, optional
        Timeouts, retries and request sizes.
    bypass_caches : bool
        Whether to bypass HTTP caches.
    length_of : callable, optional
        Length of the file from its first 64 bytes; see `RangeFetcher`.

    Returns
    -------
    RangeSource
        Source of the file, a context manager. `RangeSource.close` cancels its requests.

    Raises
    ------
    StorageError
        The errors of `RangeSource`; ``bad-url``: the URL is malformed.
    MissingExtraError
        ``needs-http``, ``needs-cloud``: the packages of the extra are not installed.
    ValueError
        The URL has another scheme.

    Examples
    --------
    >>> from cogsplat.formats.network.open_url import open_url
    >>> with open_url("https://example.org/scene.cogs") as source:
    ...     source.size > 64
    True
    """
    options = options or NetworkOptions()
    return RangeSource(
        transport_of(url, options),
        redacted(url),
        options,
        bypass_caches=bypass_caches,
        length_of=length_of,
    )


def transport_of(url: str, options: NetworkOptions) -> SiblingTransport:
    """Return the transport for a URL: HTTP, or an object store. Raises as `open_url`."""
    scheme = scheme_of(url)
    if scheme in HTTP_SCHEMES:
        return HttpTransport(url, options)
    if scheme:
        return ObjectTransport(url, options)
    raise ValueError(f"{redacted(url)!r}, expected a URL with http, https, s3, gs or az")
