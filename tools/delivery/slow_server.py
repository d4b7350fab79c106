"""Web server with a simulated slow link, to measure progressive loading."""

from __future__ import annotations

import threading
import time
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from http import HTTPStatus
from pathlib import PurePosixPath
from typing import Final

from .byte_range import RangeNotSatisfiableError, parse_range
from .threaded_server import ThreadedHandler, ThreadedServer

_TYPES: Final = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".mjs": "text/javascript; charset=utf-8",
    ".json": "application/json",
    ".wasm": "application/wasm",
}
# Transfer time of a block: short relative to measured times, long relative to a thread switch.
_BLOCK_SECONDS: Final = 0.006
_LARGEST_BLOCK: Final = 1 << 18


@dataclass
class Link:
    """A simulated link, shared by all connections of a server.

    Parameters
    ----------
    bits_per_second : float or None
        Bandwidth; None for no limit.
    latency_seconds : float
        Time from a request to the first byte of its response.
    """

    bits_per_second: float | None = None
    latency_seconds: float = 0.0
    _free_at: float = field(default=0.0, init=False, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, init=False, repr=False)

    def wait(self, size_bytes: int, ready: float | None = None) -> float:
        """Wait until bytes have passed the link, behind earlier bytes of all connections.

        Parameters
        ----------
        size_bytes : int
            Number of bytes.
        ready : float, optional
            Time (`time.monotonic`) from which the bytes can be sent; now by default. Within a
            response, pass the time that the previous block returned, so that a thread that wakes
            late does not slow down the link.

        Returns
        -------
        float
            Time (`time.monotonic`) at which the bytes had passed.
        """
        now = time.monotonic()
        if self.bits_per_second is None:
            return now
        with self._lock:
            start = max(self._free_at, now if ready is None else ready)
            passed = self._free_at = start + 8 * size_bytes / self.bits_per_second
        time.sleep(max(passed - now, 0.0))
        return passed

    @property
    def block_bytes(self) -> int:
        """Size of a block to send at once, bytes."""
        if self.bits_per_second is None:
            return _LARGEST_BLOCK
        return max(1, min(_LARGEST_BLOCK, int(self.bits_per_second * _BLOCK_SECONDS / 8)))


@dataclass(frozen=True)
class Reply:
    """The response to a request.

    Parameters
    ----------
    status : HTTPStatus
        Status code.
    headers : mapping of str to str
        Headers; without Content-Length the connection cannot be reused.
    body : iterable of bytes
        Consecutive parts of the body. An `OSError` of the iterable closes the connection.
    """

    status: HTTPStatus
    headers: Mapping[str, str]
    body: Iterable[bytes]


@dataclass
class Traffic:
    """Log of the bytes that a server has sent, one row per block.

    Attributes
    ----------
    rows : list of (float, str, int)
        Time (`time.monotonic`), name of the file, and size of the block in bytes.
    """

    rows: list[tuple[float, str, int]] = field(default_factory=list)

    def size_bytes(self, name: str, until: float = float("inf")) -> int:
        """Return the number of bytes of a file that were sent up to a time."""
        return sum(size for at, sent, size in self.rows if sent == name and at <= until)


class SlowServer(ThreadedServer):
    """Web server for files in memory over a simulated link, for this machine only.

    Parameters
    ----------
    files : mapping of str to bytes
        Contents by path, without the leading slash. ``/`` serves ``index.html``.
    link : Link or None
        Simulated link; None for no limits.
    cached : collection of str
        Files that browsers may cache; all others are fetched each time.

    Examples
    --------
    >>> from cogsplat.tools.delivery.slow_server import Link, SlowServer, running
    >>> files = {"index.html": b"<p>Hello</p>"}
    >>> with running(SlowServer(files, Link(5e6, latency_seconds=0.04))) as server:
    ...     print(server.url)
    http://127.0.0.1:.../
    """

    def __init__(
        self, files: Mapping[str, bytes], link: Link | None = None, cached: Collection[str] = ()
    ) -> None:
        self.files = dict(files)
        self.cached = frozenset(cached)
        self.link = link or Link()
        self.traffic = Traffic()
        super().__init__(0, _Handler)

    def reply(self, name: str, range_header: str | None) -> Reply:
        """Return the response to a request.

        Parameters
        ----------
        name : str
            Path of the file.
        range_header : str or None
            The request's ``Range`` header.
        """
        content = self.files.get(name)
        if content is None:
            return text_reply(HTTPStatus.NOT_FOUND)
        try:
            part = parse_range(range_header, len(content))
        except RangeNotSatisfiableError:
            refusal = text_reply(HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE)
            return Reply(
                refusal.status,
                {**refusal.headers, "Content-Range": f"bytes */{len(content)}"},
                refusal.body,
            )
        first, end = part or (0, len(content))
        headers = {
            "Content-Type": _TYPES.get(PurePosixPath(name).suffix, "application/octet-stream"),
            "Content-Length": str(end - first),
            "Accept-Ranges": "bytes",
            "Cache-Control": "max-age=3600" if name in self.cached else "no-store",
        }
        if part is not None:
            headers["Content-Range"] = f"bytes {first}-{end - 1}/{len(content)}"
        status = HTTPStatus.OK if part is None else HTTPStatus.PARTIAL_CONTENT
        return Reply(status, headers, [content[first:end]])


def text_reply(status: HTTPStatus) -> Reply:
    """Return a response with a status and its name as text."""
    text = f"{status.value} {status.phrase}\n".encode()
    headers = {"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(text))}
    return Reply(status, headers, [text])


@contextmanager
def running(server: SlowServer) -> Iterator[SlowServer]:
    """Run a server in a thread for the duration of a with block."""
    thread = threading.Thread(target=server.serve_forever, args=[0.01])
    with server:
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()


class _Handler(ThreadedHandler):
    """Handler of one connection's requests."""

    # Send each block at once: Nagle's algorithm would delay small ones.
    disable_nagle_algorithm = True
    server: SlowServer

    def do_GET(self) -> None:  # noqa: N802
        """Respond with a file or a range of it, at the speed of the link."""
        name = self.path.partition("?")[0].removeprefix("/") or "index.html"
        server = self.server
        reply = server.reply(name, self.headers.get("Range"))
        time.sleep(server.link.latency_seconds)
        self.send_response(reply.status)
        for key, value in reply.headers.items():
            self.send_header(key, value)
        self.end_headers()
        try:
            for part in reply.body:
                self._send(name, part)
        except OSError:
            # The body broke off, or the browser closed the connection.
            self.close_connection = True

    def _send(self, name: str, part: bytes) -> None:
        """Send a part of a body block by block, and log the traffic."""
        server, size = self.server, self.server.link.block_bytes
        passed: float | None = None
        for first in range(0, len(part), size):
            block = part[first : first + size]
            passed = server.link.wait(len(block), passed)
            self.wfile.write(block)
            self.progress()
            server.traffic.rows.append((time.monotonic(), name, len(block)))
