"""Range requests to web servers, over HTTP/1.1 and HTTP/2."""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress
from functools import cache
from http.cookiejar import CookieJar, DefaultCookiePolicy
from types import ModuleType
from typing import TYPE_CHECKING, Final

from cogsplat.codec.errors import CogsplatError, MissingExtraError, StorageError

from .backoff import TransientError
from .network_options import NetworkOptions
from .range_responses import RangeResponse, check_response_head, late, timely
from .urls import HTTP_SCHEMES, bad_url, redacted, split_url

if TYPE_CHECKING:
    import httpx

_REDIRECTS: Final = frozenset({301, 302, 303, 307, 308})
_MAX_REDIRECTS: Final = 5

# Bodies with a Content-Encoding have no byte ranges.
_PLAIN: Final = {"Accept-Encoding": "identity"}
# Extension of httpx's response that holds the header Location.
_LOCATION: Final = "cogsplat-location"

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
    StorageError
        ``bad-url``: the URL is malformed.
    """

    def __init__(
        self, url: str, options: NetworkOptions, client: httpx.AsyncClient | None = None
    ) -> None:
        self._httpx = _httpx()
        self._name = redacted(url)
        # Address without redirects, and the address that redirects led to.
        self._given = self._target = _parsed(url)
        self._options = options
        self._own = client is None
        self._client = client or new_client(options)

    def sibling(self, name: str) -> HttpTransport:
        """Return a transport for the file `name`, relative to this file, with the same client.

        The address keeps its query, which may hold a signature for every file of the folder.
        """
        url = self._given.join(name).copy_with(query=self._given.query or None)
        return HttpTransport(str(url), self._options, self._client)

    @asynccontextmanager
    async def get(
        self, first: int, end: int, *, bypass_caches: bool = False
    ) -> AsyncIterator[RangeResponse]:
        """Request a range; see `Transport.get`."""
        options = self._options
        longest = options.connect_seconds + options.idle_seconds
        try:
            # Headers may arrive slowly, and informational responses without end.
            async with asyncio.timeout(longest):
                response = await self._send(first, end, bypass_caches)
        except TimeoutError as error:
            raise TransientError(
                "network-timeout",
                f"{self._name}: incomplete headers after {longest:g} s, expected a response",
            ) from error
        try:
            headers = {key.lower(): value for key, value in response.headers.items()}
            head = check_response_head(response.status_code, headers, first, end, self._name)
            yield RangeResponse(
                head, timely(self._parts(response), options.idle_seconds, self._name)
            )
        finally:
            await _close(response)

    async def _parts(self, response: httpx.Response) -> AsyncIterator[bytes]:
        """Yield the parts of a body as they arrive."""
        parts = response.aiter_raw()
        while True:
            with self._library_errors():
                part = await anext(parts, None)
            if part is None:
                return
            yield part

    async def _send(self, first: int, end: int, bypass_caches: bool) -> httpx.Response:
        """Request a range; repeat the request once if a signed or redirected URL has expired."""
        response = await self._follow(first, end, bypass_caches)
        expired = response.status_code in (401, 403)
        if expired and self._options.sign is not None:
            await _close(response)
            self._given = self._target = _parsed(self._options.sign())
            return await self._follow(first, end, bypass_caches)
        if response.status_code in (401, 403, 404, 410) and self._target != self._given:
            # The target of a redirect may be a signed URL that has expired.
            await _close(response)
            self._target = self._given
            return await self._follow(first, end, bypass_caches)
        return response

    async def _follow(self, first: int, end: int, bypass_caches: bool) -> httpx.Response:
        """Send a request and follow redirects; later requests go straight to the last target."""
        origin = _origin(self._given)
        url = self._target
        for _ in range(_MAX_REDIRECTS + 1):
            own = self._options.headers if _origin(url) == origin else {}
            wanted = {"Range": f"bytes={first}-{end - 1}"}
            headers = {**own, **_PLAIN, **(_BYPASS_CACHES if bypass_caches else {}), **wanted}
            with self._library_errors():
                request = self._client.build_request("GET", url, headers=headers)
                response = await self._client.send(request, stream=True)
            location = response.extensions.get(_LOCATION)
            if response.status_code not in _REDIRECTS or location is None:
                self._target = url
                return response
            await _close(response)
            url = self._redirect_target(url, location)
        raise StorageError(
            "redirect-loop", f"{self._name}: more than {_MAX_REDIRECTS} redirects, expected a file"
        )

    def _redirect_target(self, url: httpx.URL, location: str) -> httpx.URL:
        """Return the target of a redirect; refuse a step from https to http."""
        try:
            target = _parsed(str(url.join(location)))
        except Exception as error:
            # httpx and the codec of host names raise exceptions of many types.
            raise StorageError(
                "redirect-refused",
                f"{self._name}: redirected to {redacted(location)!r}: {_fault_of(error)}, expected "
                "a well-formed URL",
            ) from error
        safe = target.scheme == "https" or (target.scheme == "http" and url.scheme == "http")
        if not safe:
            raise StorageError(
                "redirect-refused",
                f"{self._name}: redirected from {url.scheme} to {redacted(str(target))}, "
                "expected https",
            )
        return target

    @contextmanager
    def _library_errors(self) -> Iterator[None]:
        """Turn exceptions of httpx and its libraries into `StorageError` or `TransientError`."""
        import httpcore

        library, options = self._httpx, self._options
        try:
            yield
        except (CogsplatError, TransientError):
            raise
        except (library.ConnectTimeout, httpcore.ConnectTimeout) as error:
            raise late(self._name, options.connect_seconds) from error
        except (library.TimeoutException, httpcore.TimeoutException) as error:
            raise late(self._name, options.idle_seconds) from error
        except (library.ConnectError, httpcore.ConnectError) as error:
            message = f"{self._name}: cannot be reached: {error}, expected a server; check the host"
            if "CERTIFICATE_VERIFY_FAILED" in message:
                raise StorageError("host-unreachable", message) from error
            raise TransientError("host-unreachable", message) from error
        except UnicodeError as error:
            # The resolver cannot encode host names with empty or long labels.
            raise StorageError(
                "host-unreachable",
                f"{self._name}: its host name is malformed: {error}, expected a host name",
            ) from error
        except Exception as error:
            # HTTP/2, TLS and sockets raise exceptions of many types.
            raise TransientError(
                "connection-broken",
                f"{self._name}: the connection broke: {_fault_of(error)}, expected a whole "
                "response",
            ) from error

    async def close(self) -> None:
        """Close the connections, unless another transport owns the client."""
        if self._own:
            await _close(self._client)


def new_client(
    options: NetworkOptions, transport: httpx.AsyncBaseTransport | None = None
) -> httpx.AsyncClient:
    """Return an HTTP/2 client that keeps no cookies and follows no redirects.

    Parameters
    ----------
    options : NetworkOptions
        Timeouts, number of connections, and whether private addresses are allowed.
    transport : httpx.AsyncBaseTransport, optional
        Transport to use in place of the network.

    Raises
    ------
    StorageError
        ``network-settings``: proxies or certificates of the environment cannot be used.
    """
    library = _httpx()
    connections = options.in_flight + 2
    try:
        if transport is None and not options.allow_private:
            from .public_transport import PublicTransport

            transport = PublicTransport(_certificates(), connections)
        idle, connect = options.idle_seconds, options.connect_seconds
        made: httpx.AsyncClient = library.AsyncClient(
            http2=True,
            timeout=library.Timeout(idle, connect=connect, pool=None),
            limits=library.Limits(max_connections=connections),
            verify=_certificates(),
            cookies=no_cookies(),
            event_hooks={"response": [_set_location_aside]},
            transport=transport,
        )
    except Exception as error:
        # Proxies and certificates of the environment fail with exceptions of many types.
        raise StorageError(
            "network-settings",
            f"no HTTP client: {_fault_of(error)}, expected valid proxies "
            "(HTTP_PROXY, HTTPS_PROXY, ALL_PROXY) and certificates (SSL_CERT_FILE, SSL_CERT_DIR)",
        ) from error
    return made


def no_cookies() -> CookieJar:
    """Return a cookie jar that keeps nothing: cookies could fill memory and requests."""
    return CookieJar(DefaultCookiePolicy(allowed_domains=[]))


async def _close(opened: httpx.Response | httpx.AsyncClient) -> None:
    """Close a response or client; ignore errors, because a connection that fails is gone."""
    with suppress(Exception):
        await opened.aclose()


async def _set_location_aside(response: httpx.Response) -> None:
    """Move the header Location to an extension: httpx parses it even if it follows no redirect."""
    if "location" in response.headers:
        response.extensions[_LOCATION] = response.headers.pop("location")


def _parsed(url: str) -> httpx.URL:
    """Parse a URL; raise ``bad-url`` for a malformed one."""
    split_url(url)
    try:
        found: httpx.URL = _httpx().URL(url)
        # The host name is decoded here; a malformed one raises an error.
        if found.scheme in HTTP_SCHEMES and found.host:
            return found
    except Exception as error:
        # httpx and the codec of host names raise exceptions of many types.
        raise bad_url(url, _fault_of(error)) from error
    raise bad_url(url, "another scheme than http and https")


def _fault_of(error: Exception) -> str:
    """Return the first line of an exception's message, or the name of its type."""
    return str(error).partition("\n")[0] or type(error).__name__


def _origin(url: httpx.URL) -> tuple[str, str, int | None]:
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
