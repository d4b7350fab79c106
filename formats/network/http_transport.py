"""Range requests to web servers, over HTTP/1.1 and HTTP/2."""

from __future__ import annotations

import ssl
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import cache
from types import ModuleType
from typing import TYPE_CHECKING, Any, Final

from cogsplat.codec.errors import MissingExtraError, StorageError

from .backoff import TransientError
from .network_options import NetworkOptions
from .range_responses import RangeResponse, check_response_head
from .urls import redacted

if TYPE_CHECKING:
    import httpx

_REDIRECTS: Final = frozenset({301, 302, 303, 307, 308})
_MAX_REDIRECTS: Final = 5

# Bodies with a Content-Encoding have no byte ranges.
_PLAIN: Final = {"Accept-Encoding": "identity"}
_BYPASS_CACHES: Final = {"Cache-Control": "no-cache", "Pragma": "no-cache"}


class HttpTransport:
    """Transport for a file of a web server; see `Transport`.

    Parameters
    ----------
    url : str
        ``http://`` or ``https://`` address.
    options : NetworkOptions
        Headers, timeouts and number of connections.
    client : httpx.AsyncClient, optional
        Client to share with another transport; a new one by default.

    Raises
    ------
    MissingExtraError
        ``needs-http``: httpx is not installed.
    """

    def __init__(
        self, url: str, options: NetworkOptions, client: httpx.AsyncClient | None = None
    ) -> None:
        self._httpx = _httpx()
        # Address without redirects, and the address that redirects led to.
        self._given = url
        self._target = url
        self._options = options
        self._own = client is None
        self._client = client or self._new_client()
        self._name = redacted(url)

    def sibling(self, name: str) -> HttpTransport:
        """Return a transport for the file `name`, relative to this file, with the same client.

        The address keeps its query, which may hold a signature for every file of the folder.
        """
        given = self._httpx.URL(self._given)
        url = given.join(name).copy_with(query=given.query or None)
        return HttpTransport(str(url), self._options, self._client)

    def _new_client(self) -> httpx.AsyncClient:
        """Return an HTTP/2 client with the timeouts and connections of the options."""
        library, options = self._httpx, self._options
        timeout = library.Timeout(options.idle_seconds, connect=options.connect_seconds, pool=None)
        limits = library.Limits(max_connections=options.in_flight + 2)
        made: httpx.AsyncClient = library.AsyncClient(
            http2=True, timeout=timeout, limits=limits, verify=_certificates()
        )
        return made

    @asynccontextmanager
    async def get(
        self, first: int, end: int, *, bypass_caches: bool = False
    ) -> AsyncIterator[RangeResponse]:
        """Request a range; see `Transport.get`."""
        library = self._httpx
        try:
            response = await self._send(first, end, bypass_caches)
            try:
                headers = {key.lower(): value for key, value in response.headers.items()}
                head = check_response_head(response.status_code, headers, first, end, self._name)
                yield RangeResponse(head, response.aiter_raw())
            finally:
                await response.aclose()
        except library.TimeoutException as error:
            seconds = self._options.idle_seconds
            if isinstance(error, library.ConnectTimeout):
                seconds = self._options.connect_seconds
            raise TransientError(
                "network-timeout", f"{self._name}: no byte for {seconds:g} s, expected a response"
            ) from error
        except library.ConnectError as error:
            message = f"{self._name}: cannot be reached: {error}, expected a server; check the host"
            if "CERTIFICATE_VERIFY_FAILED" in message:
                raise StorageError("host-unreachable", message) from error
            raise TransientError("host-unreachable", message) from error
        except library.TransportError as error:
            fault = str(error) or type(error).__name__
            raise TransientError(
                "connection-broken",
                f"{self._name}: the connection broke: {fault}, expected a whole response",
            ) from error

    async def _send(self, first: int, end: int, bypass_caches: bool) -> httpx.Response:
        """Request a range; repeat the request once if a signed or redirected URL has expired."""
        response = await self._follow(first, end, bypass_caches)
        expired = response.status_code in (401, 403)
        if expired and self._options.sign is not None:
            await response.aclose()
            self._given = self._target = self._options.sign()
            return await self._follow(first, end, bypass_caches)
        if response.status_code in (401, 403, 404, 410) and self._target != self._given:
            # The target of a redirect may be a signed URL that has expired.
            await response.aclose()
            self._target = self._given
            return await self._follow(first, end, bypass_caches)
        return response

    async def _follow(self, first: int, end: int, bypass_caches: bool) -> httpx.Response:
        """Send a request and follow redirects; later requests go straight to the last target."""
        library = self._httpx
        origin = _origin(library.URL(self._given))
        url = library.URL(self._target)
        for _ in range(_MAX_REDIRECTS + 1):
            own = self._options.headers if _origin(url) == origin else {}
            wanted = {"Range": f"bytes={first}-{end - 1}"}
            headers = {**own, **_PLAIN, **(_BYPASS_CACHES if bypass_caches else {}), **wanted}
            request = self._client.build_request("GET", url, headers=headers)
            try:
                response = await self._client.send(request, stream=True)
            except (library.InvalidURL, library.RemoteProtocolError) as error:
                # httpx parses the Location header even though it does not follow redirects here.
                named = isinstance(error, library.InvalidURL) or "location header" in str(error)
                if not named:
                    raise
                raise StorageError(
                    "redirect-refused",
                    f"{self._name}: redirected to a malformed URL: {error}, expected a URL",
                ) from error
            if response.status_code not in _REDIRECTS or "location" not in response.headers:
                self._target = str(url)
                return response
            await response.aclose()
            url = self._redirect_target(url, response.headers["location"])
        raise StorageError(
            "redirect-loop", f"{self._name}: more than {_MAX_REDIRECTS} redirects, expected a file"
        )

    def _redirect_target(self, url: Any, location: str) -> Any:
        """Return the target of a redirect; refuse a step from https to http."""
        try:
            target = url.join(location)
        except self._httpx.InvalidURL as error:
            raise StorageError(
                "redirect-refused",
                f"{self._name}: redirected to {location!r}: {error}, expected a URL",
            ) from error
        safe = target.scheme == "https" or (target.scheme == "http" and url.scheme == "http")
        if not safe or not target.host:
            raise StorageError(
                "redirect-refused",
                f"{self._name}: redirected from {url.scheme} to {redacted(str(target))}, "
                "expected https",
            )
        return target

    async def close(self) -> None:
        """Close the connections, unless another transport owns the client."""
        if self._own:
            await self._client.aclose()


def _origin(url: Any) -> tuple[str, str, int | None]:
    """Return scheme, host and port of a URL."""
    return url.scheme, url.host, url.port


@cache
def _certificates() -> ssl.SSLContext:
    """Return the trusted certificate authorities; loaded once, because loading is slow."""
    made: ssl.SSLContext = _httpx().create_ssl_context()
    return made


def _httpx() -> ModuleType:
    """Return the module httpx, or raise ``needs-http``."""
    try:
        import h2  # noqa: F401 - what httpx speaks HTTP/2 with
        import httpx
    except ImportError as error:
        raise MissingExtraError(
            "needs-http",
            "httpx and h2 are not installed, expected both for reading from web servers "
            "(pip install 'cogsplat[http]')",
        ) from error
    return httpx
