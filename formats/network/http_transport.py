"""Range requests to web servers, over HTTP/1.1 and HTTP/2."""

from __future__ import annotations

import ssl
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import cache
from types import ModuleType
from typing import TYPE_CHECKING, Any, Final

from cogsplat.codec.errors import MissingExtraError, StorageError

from .answers import Answer, stated_by
from .faults import PassingFault
from .options import NetworkOptions
from .urls import shown

if TYPE_CHECKING:
    import httpx

_REDIRECTS: Final = frozenset({301, 302, 303, 307, 308})
_MOST_REDIRECTS: Final = 5

# Bodies are compressed already; what is compressed again has no ranges.
_PLAIN: Final = {"Accept-Encoding": "identity"}
_FRESH: Final = {"Cache-Control": "no-cache", "Pragma": "no-cache"}


class HttpTransport:
    """Asks a web server for ranges of one file; see `answers.Transport`.

    Parameters
    ----------
    url : str
    options : NetworkOptions
    client : httpx.AsyncClient, optional
        What requests are made with, in place of one of its own.

    Raises
    ------
    MissingExtraError
        ``needs-http``: httpx is not installed.
    """

    def __init__(
        self, url: str, options: NetworkOptions, client: httpx.AsyncClient | None = None
    ) -> None:
        self._httpx = _httpx()
        self._given = url
        self._target = url
        self._options = options
        self._own = client is None
        self._client = client or self._new_client()
        self._name = shown(url)

    def beside(self, name: str) -> HttpTransport:
        """Return a transport of a file that is named relative to this one, over the same client.

        The query of the address is kept, which may hold a signature for all files beside it.
        """
        given = self._httpx.URL(self._given)
        url = given.join(name).copy_with(query=given.query or None)
        return HttpTransport(str(url), self._options, self._client)

    def _new_client(self) -> httpx.AsyncClient:
        library, options = self._httpx, self._options
        timeout = library.Timeout(options.idle_seconds, connect=options.connect_seconds, pool=None)
        limits = library.Limits(max_connections=options.in_flight + 2)
        made: httpx.AsyncClient = library.AsyncClient(
            http2=True, timeout=timeout, limits=limits, verify=_certificates()
        )
        return made

    @asynccontextmanager
    async def get(self, first: int, end: int, *, fresh: bool = False) -> AsyncIterator[Answer]:
        """Ask for a range; see `answers.Transport.get`."""
        library = self._httpx
        try:
            response = await self._send(first, end, fresh)
            try:
                headers = {key.lower(): value for key, value in response.headers.items()}
                stated = stated_by(response.status_code, headers, first, end, self._name)
                yield Answer(stated, response.aiter_raw())
            finally:
                await response.aclose()
        except library.TimeoutException as error:
            seconds = self._options.idle_seconds
            if isinstance(error, library.ConnectTimeout):
                seconds = self._options.connect_seconds
            raise PassingFault(
                "network-timeout", f"{self._name}: nothing came for {seconds:g} s"
            ) from error
        except library.ConnectError as error:
            message = f"{self._name}: cannot be reached: {error}"
            if "CERTIFICATE_VERIFY_FAILED" in message:
                raise StorageError("host-unreachable", message) from error
            raise PassingFault("host-unreachable", message) from error
        except library.TransportError as error:
            told = str(error) or type(error).__name__
            raise PassingFault(
                "connection-broken", f"{self._name}: the connection broke: {told}"
            ) from error

    async def _send(self, first: int, end: int, fresh: bool) -> httpx.Response:
        """Make the request, once more where access has expired or a redirect leads nowhere."""
        response = await self._follow(first, end, fresh)
        expired = response.status_code in (401, 403)
        if expired and self._options.sign is not None:
            await response.aclose()
            self._given = self._target = self._options.sign()
            return await self._follow(first, end, fresh)
        if response.status_code in (401, 403, 404, 410) and self._target != self._given:
            # Where a redirect leads may be for a short time only.
            await response.aclose()
            self._target = self._given
            return await self._follow(first, end, fresh)
        return response

    async def _follow(self, first: int, end: int, fresh: bool) -> httpx.Response:
        """Make the request and follow redirects, of which the end is kept for the next request."""
        library = self._httpx
        origin = _origin(library.URL(self._given))
        url = library.URL(self._target)
        for _ in range(_MOST_REDIRECTS + 1):
            own = self._options.headers if _origin(url) == origin else {}
            wanted = {"Range": f"bytes={first}-{end - 1}"}
            headers = {**own, **_PLAIN, **(_FRESH if fresh else {}), **wanted}
            request = self._client.build_request("GET", url, headers=headers)
            try:
                response = await self._client.send(request, stream=True)
            except (library.InvalidURL, library.RemoteProtocolError) as error:
                # httpx reads the place that a redirect names whether or not it follows it.
                named = isinstance(error, library.InvalidURL) or "location header" in str(error)
                if not named:
                    raise
                raise StorageError(
                    "redirect-refused", f"{self._name}: redirected to no address: {error}"
                ) from error
            if response.status_code not in _REDIRECTS or "location" not in response.headers:
                self._target = str(url)
                return response
            await response.aclose()
            url = self._next(url, response.headers["location"])
        raise StorageError(
            "redirect-loop", f"{self._name}: more than {_MOST_REDIRECTS} redirects, expected a file"
        )

    def _next(self, url: Any, location: str) -> Any:
        """Return where a redirect leads."""
        try:
            target = url.join(location)
        except self._httpx.InvalidURL as error:
            raise StorageError(
                "redirect-refused", f"{self._name}: redirected to {location!r}: {error}"
            ) from error
        safe = target.scheme == "https" or (target.scheme == "http" and url.scheme == "http")
        if not safe or not target.host:
            raise StorageError(
                "redirect-refused",
                f"{self._name}: redirected from {url.scheme} to {shown(str(target))}, "
                "expected https",
            )
        return target

    async def close(self) -> None:
        """Close the connections, where the client is its own."""
        if self._own:
            await self._client.aclose()


def _origin(url: Any) -> tuple[str, str, int | None]:
    return url.scheme, url.host, url.port


@cache
def _certificates() -> ssl.SSLContext:
    """Return the authorities that are trusted; reading them takes longer than a request."""
    made: ssl.SSLContext = _httpx().create_ssl_context()
    return made


def _httpx() -> ModuleType:
    try:
        import h2  # noqa: F401 - what httpx speaks HTTP/2 with
        import httpx
    except ImportError as error:
        raise MissingExtraError(
            "needs-http",
            "files are read from web servers with httpx and h2 (pip install 'cogsplat[http]')",
        ) from error
    return httpx
