"""What a server answers to the requests of readers and browsers: raw answers, nothing judged."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from types import TracebackType
from typing import TYPE_CHECKING, Final
from urllib.parse import urljoin

from cogsplat.codec.errors import StorageError, printable

if TYPE_CHECKING:
    import httpx

FIRST_BYTES: Final = 65536
"""What readers ask for first (SPEC 8.8)."""

ORIGIN: Final = "https://viewer.example"
"""The origin that requests name, as a page of another site would; the name is reserved."""

_COMPRESSIONS: Final = "gzip, deflate, br, zstd"
_LAST_BYTES: Final = 16
_CONNECT_SECONDS: Final = 10.0
_IDLE_SECONDS: Final = 15.0
_MOST_REDIRECTS: Final = 5


@dataclass(frozen=True)
class Answer:
    """One answer of a server.

    Parameters
    ----------
    url : str
        Where it came from, redirects followed.
    status : int
    version : str
        ``HTTP/1.1`` or ``HTTP/2``.
    headers : mapping of str to str
        Names in lower case.
    body : bytes
        What was read of the body, as it was sent; at most as much as was asked for.
    first_byte_s : float
        Seconds from the request to the headers; of the first request with the connection.
    redirects : tuple of str
        Addresses that led here.
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
        """The content encoding, empty where there is none."""
        found = self.headers.get("content-encoding", "").strip().lower()
        return "" if found == "identity" else found

    @property
    def etag(self) -> str:
        """The ETag as it was sent, empty where there is none."""
        return self.headers.get("etag", "").strip()

    @property
    def media_type(self) -> str:
        """The media type without parameters, empty where there is none."""
        return self.headers.get("content-type", "").partition(";")[0].strip().lower()


@dataclass(frozen=True)
class Probed:
    """The answers to all requests that one address was probed with.

    Parameters
    ----------
    url : str
        As it was asked for.
    first : Answer
        To the first 64 KiB, as browsers ask for them: without compression.
    compressed : Answer
        To the same from a client that takes compressed answers.
    whole : Answer
        To a request without a range from a client that takes compressed answers; no body is read.
    last : Answer or None
        To the last bytes, where `first` was a range and said how long the file is.
    beyond : Answer or None
        To a range behind the end.
    preflight : Answer
        To what a browser asks before a request with headers that it does not know.
    """

    url: str
    first: Answer
    compressed: Answer
    whole: Answer
    last: Answer | None
    beyond: Answer | None
    preflight: Answer
    asked_last: tuple[int, int] = field(default=(0, 0))


class Prober:
    """Sends single requests and keeps what came back; a context manager.

    Parameters
    ----------
    client : httpx.Client, optional
        In place of one that speaks HTTP/2 and HTTP/1.1.
    """

    def __init__(self, client: httpx.Client | None = None) -> None:
        import httpx

        self._client = client or httpx.Client(
            http2=True,
            follow_redirects=True,
            max_redirects=_MOST_REDIRECTS,
            timeout=httpx.Timeout(_IDLE_SECONDS, connect=_CONNECT_SECONDS),
        )

    def __enter__(self) -> Prober:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._client.close()

    def ask(
        self, url: str, headers: Mapping[str, str], *, most: int, method: str = "GET"
    ) -> Answer:
        """Send a request and read at most so many bytes of the answer.

        Raises
        ------
        StorageError
            ``host-unreachable``, ``network-timeout``, ``connection-broken`` or ``redirect-loop``.
        """
        import httpx

        sent = {"User-Agent": "cogsplat-verify", **headers}
        start = time.perf_counter()
        try:
            with self._client.stream(method, url, headers=sent) as response:
                seconds = time.perf_counter() - start
                parts: list[bytes] = []
                missing = most
                if missing:
                    # Raw: what a server compressed stays compressed.
                    for part in response.iter_raw():
                        parts.append(part[:missing])
                        missing -= len(parts[-1])
                        if not missing:
                            break
                return Answer(
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
        except httpx.TooManyRedirects as error:
            raise StorageError(
                "redirect-loop", f"{url}: more than {_MOST_REDIRECTS} redirects, expected an answer"
            ) from error
        except httpx.ConnectError as error:
            raise StorageError("host-unreachable", f"{url}: {error}") from error
        except httpx.TimeoutException as error:
            raise StorageError(
                "network-timeout", f"{url}: no byte for {_IDLE_SECONDS:g} s, expected an answer"
            ) from error
        except (httpx.HTTPError, httpx.InvalidURL, httpx.StreamError) as error:
            raise StorageError("connection-broken", f"{url}: {error}") from error

    def probe(self, url: str) -> Probed:
        """Send all requests that `Probed` lists.

        Raises
        ------
        StorageError
            See `ask`.
        """
        origin = {"Origin": ORIGIN}
        start = {"Range": f"bytes=0-{FIRST_BYTES - 1}"}
        plain = {"Accept-Encoding": "identity"}
        packed = {"Accept-Encoding": _COMPRESSIONS}
        first = self.ask(url, origin | start | plain, most=FIRST_BYTES)
        compressed = self.ask(url, origin | start | packed, most=0)
        whole = self.ask(url, origin | packed, most=0)
        total = total_of(first)
        last = beyond = None
        asked = (0, 0)
        if first.status == 206 and total:
            asked = (max(0, total - _LAST_BYTES), total - 1)
            span = {"Range": f"bytes={asked[0]}-{asked[1]}"}
            last = self.ask(url, origin | span | plain, most=_LAST_BYTES)
            behind = {"Range": f"bytes={total}-{total + 15}"}
            beyond = self.ask(url, origin | behind | plain, most=0)
        preflight = self.ask(
            url,
            origin
            | {
                "Access-Control-Request-Method": "GET",
                "Access-Control-Request-Headers": "range",
            },
            most=0,
            method="OPTIONS",
        )
        return Probed(url, first, compressed, whole, last, beyond, preflight, asked)

    def whole_object(self, base: str, name: str, most: int) -> Answer:
        """Ask for an object of a folder as browsers do: whole, compressed answers taken."""
        headers = {"Origin": ORIGIN, "Accept-Encoding": _COMPRESSIONS}
        return self.ask(urljoin(base, name), headers, most=most)


def content_range(answer: Answer) -> tuple[int, int, int] | None:
    """Return first and last byte and the length of the file of a ``Content-Range``, if it is one.

    Examples
    --------
    >>> content_range(Answer("", 206, "", {"content-range": "bytes 0-9/200"}, b"", 0.0))
    (0, 9, 200)
    """
    unit, _, rest = answer.headers.get("content-range", "").strip().partition(" ")
    span, _, total = rest.partition("/")
    first, _, last = span.partition("-")
    numbers = (first.strip(), last.strip(), total.strip())
    if unit.lower() != "bytes" or not all(n.isascii() and n.isdigit() for n in numbers):
        return None
    found = tuple(int(n[:20]) for n in numbers)
    return found[0], found[1], found[2]


def total_of(answer: Answer) -> int | None:
    """Return the length of the file that an answer states, None where it states none."""
    found = content_range(answer)
    return found[2] if found else None
