"""Probe requests: the requests of readers and browsers, and a host's raw responses."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import TracebackType
from typing import Final
from urllib.parse import urljoin

from cogsplat.codec.errors import StorageError, printable
from cogsplat.formats.network.http_transport import no_cookies

FIRST_BYTES: Final = 65536
"""Length of a reader's first request, bytes (SPEC 8.8)."""

ORIGIN: Final = "https://viewer.example"
"""Origin header of all requests, like that of a page on another site; a reserved name."""

_COMPRESSIONS: Final = "gzip, deflate, br, zstd"
_LAST_BYTES: Final = 16
_CONNECT_SECONDS: Final = 10.0
_IDLE_SECONDS: Final = 15.0
_LONGEST_SECONDS: Final = 60.0
_MAX_REDIRECTS: Final = 5


@dataclass(frozen=True)
class Response:
    """One HTTP response.

    Parameters
    ----------
    url : str
        Address after redirects.
    status : int
        Status code.
    version : str
        ``HTTP/1.1`` or ``HTTP/2``.
    headers : mapping of str to str
        Headers by lower-case name.
    body : bytes
        First bytes of the body as sent, up to the requested number.
    first_byte_s : float
        Seconds from the request to the headers; includes connecting on the first request.
    redirects : tuple of str
        Addresses before redirects.
    """

    url: str
    status: int
    version: str
    headers: Mapping[str, str]
    body: bytes
    first_byte_s: float
    redirects: tuple[str, ...] = ()

    @property
    def encoding(self) -> str:
        """The content encoding, empty if there is none."""
        found = self.headers.get("content-encoding", "").strip().lower()
        return "" if found == "identity" else found

    @property
    def etag(self) -> str:
        """The ETag as sent, empty if there is none."""
        return self.headers.get("etag", "").strip()

    @property
    def media_type(self) -> str:
        """The media type without parameters, empty if there is none."""
        return self.headers.get("content-type", "").partition(";")[0].strip().lower()


@dataclass(frozen=True)
class ProbeResult:
    """Responses to all probe requests for one address.

    Parameters
    ----------
    url : str
        Requested address.
    first : Response
        Response to a request for the first 64 KiB that accepts no compression, like the range
        requests of browsers.
    compressed : Response
        Response to the same range from a client that accepts compression.
    whole : Response
        Response to a request without a range that accepts compression; its body is not read.
    last : Response or None
        Response to a request for the last bytes; None if `first` has no range or total length.
    beyond : Response or None
        Response to a request for a range behind the end of the file; None if `last` is None.
    preflight : Response
        Response to a CORS preflight request for the header Range.
    last_range : tuple of int
        First and last byte of the request of `last`.
    """

    url: str
    first: Response
    compressed: Response
    whole: Response
    last: Response | None
    beyond: Response | None
    preflight: Response
    last_range: tuple[int, int] = field(default=(0, 0))


class Prober:
    """HTTP client for probe requests, over HTTP/2 and HTTP/1.1; a context manager."""

    def __init__(self) -> None:
        import httpx

        self._runner = asyncio.Runner()
        self._client = httpx.AsyncClient(
            http2=True,
            follow_redirects=True,
            max_redirects=_MAX_REDIRECTS,
            timeout=httpx.Timeout(_IDLE_SECONDS, connect=_CONNECT_SECONDS),
            cookies=no_cookies(),
        )

    def __enter__(self) -> Prober:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self._runner.run(self._client.aclose())
        finally:
            self._runner.close()

    def request(
        self, url: str, headers: Mapping[str, str], *, max_bytes: int, method: str = "GET"
    ) -> Response:
        """Send a request and read the start of its response.

        Parameters
        ----------
        url : str
            Address.
        headers : mapping of str to str
            Headers of the request, in addition to User-Agent.
        max_bytes : int
            Limit on the bytes read of the body.
        method : str
            HTTP method.

        Raises
        ------
        StorageError
            ``host-unreachable``, ``network-timeout``, ``connection-broken`` or ``redirect-loop``.
        """
        import httpx

        async def attempt() -> Response:
            # Headers may arrive slowly, and bodies without end.
            async with asyncio.timeout(_LONGEST_SECONDS):
                return await self._request(url, headers, max_bytes, method)

        try:
            return self._runner.run(attempt())
        except httpx.TooManyRedirects as error:
            raise StorageError(
                "redirect-loop",
                f"{url}: more than {_MAX_REDIRECTS} redirects, expected a response",
            ) from error
        except httpx.ConnectError as error:
            raise StorageError("host-unreachable", f"{url}: {error}") from error
        except httpx.TimeoutException as error:
            raise StorageError(
                "network-timeout", f"{url}: no byte for {_IDLE_SECONDS:g} s, expected a response"
            ) from error
        except TimeoutError as error:
            raise StorageError(
                "network-timeout",
                f"{url}: incomplete after {_LONGEST_SECONDS:g} s, expected a response",
            ) from error
        except Exception as error:
            # httpx, HTTP/2, TLS and codecs of host names raise exceptions of many types.
            fault = str(error) or type(error).__name__
            raise StorageError("connection-broken", f"{url}: {fault}") from error

    async def _request(
        self, url: str, headers: Mapping[str, str], max_bytes: int, method: str
    ) -> Response:
        """Send a request and read the start of its response; raises what httpx raises."""
        sent = {"User-Agent": "cogsplat-verify", **headers}
        start = time.perf_counter()
        async with self._client.stream(method, url, headers=sent) as response:
            seconds = time.perf_counter() - start
            parts: list[bytes] = []
            remaining = max_bytes
            if remaining:
                # Raw bytes, without decompression.
                async for part in response.aiter_raw():
                    parts.append(part[:remaining])
                    remaining -= len(parts[-1])
                    if not remaining:
                        break
            return Response(
                url=str(response.url),
                status=response.status_code,
                version=response.http_version,
                headers={
                    name.lower(): printable(value) for name, value in response.headers.items()
                },
                body=b"".join(parts),
                first_byte_s=seconds,
                redirects=tuple(str(hop.url) for hop in response.history),
            )

    def probe(self, url: str) -> ProbeResult:
        """Send all probe requests for an address; see `ProbeResult`.

        Raises
        ------
        StorageError
            See `request`.
        """
        origin = {"Origin": ORIGIN}
        start = {"Range": f"bytes=0-{FIRST_BYTES - 1}"}
        plain = {"Accept-Encoding": "identity"}
        compression = {"Accept-Encoding": _COMPRESSIONS}
        first = self.request(url, origin | start | plain, max_bytes=FIRST_BYTES)
        compressed = self.request(url, origin | start | compression, max_bytes=0)
        whole = self.request(url, origin | compression, max_bytes=0)
        total = total_of(first)
        last = beyond = None
        last_range = (0, 0)
        if first.status == 206 and total:
            last_range = (max(0, total - _LAST_BYTES), total - 1)
            span = {"Range": f"bytes={last_range[0]}-{last_range[1]}"}
            last = self.request(url, origin | span | plain, max_bytes=_LAST_BYTES)
            behind = {"Range": f"bytes={total}-{total + 15}"}
            beyond = self.request(url, origin | behind | plain, max_bytes=0)
        preflight = self.request(
            url,
            origin
            | {
                "Access-Control-Request-Method": "GET",
                "Access-Control-Request-Headers": "range",
            },
            max_bytes=0,
            method="OPTIONS",
        )
        return ProbeResult(url, first, compressed, whole, last, beyond, preflight, last_range)

    def fetch_object(self, base: str, name: str, max_bytes: int) -> Response:
        """Fetch a whole object of a folder like a browser, which accepts compression.

        Parameters
        ----------
        base : str
            Address of the folder's manifest.
        name : str
            Address of the object, relative to `base`.
        max_bytes : int
            Limit on the bytes read of the body.
        """
        headers = {"Origin": ORIGIN, "Accept-Encoding": _COMPRESSIONS}
        return self.request(urljoin(base, name), headers, max_bytes=max_bytes)


def content_range(response: Response) -> tuple[int, int, int] | None:
    """Parse a response's Content-Range: first byte, last byte, length of the file.

    Returns
    -------
    tuple of int or None
        None if the header is missing or malformed.

    Examples
    --------
    >>> content_range(Response("", 206, "", {"content-range": "bytes 0-9/200"}, b"", 0.0))
    (0, 9, 200)
    """
    unit, _, rest = response.headers.get("content-range", "").strip().partition(" ")
    span, _, total = rest.partition("/")
    first, _, last = span.partition("-")
    numbers = (first.strip(), last.strip(), total.strip())
    if unit.lower() != "bytes" or not all(n.isascii() and n.isdigit() for n in numbers):
        return None
    found = tuple(int(n[:20]) for n in numbers)
    return found[0], found[1], found[2]


def total_of(response: Response) -> int | None:
    """Return the length of the file from a response's Content-Range; None without the header."""
    found = content_range(response)
    return found[2] if found else None
