"""A web server whose link is as slow as asked for, to see and measure how scenes arrive."""

from __future__ import annotations

import os
import socketserver
import sys
import threading
import time
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import PurePosixPath
from typing import Final

from .byte_range import RangeNotSatisfiableError, parse_range
from .local_server import HOST

_TYPES: Final = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".mjs": "text/javascript; charset=utf-8",
    ".json": "application/json",
    ".wasm": "application/wasm",
}
_IDLE_SECONDS: Final = 60
# A block takes this long on the link: short beside what is measured, long beside a thread's turn.
_BLOCK_SECONDS: Final = 0.006
_LARGEST_BLOCK: Final = 1 << 18


@dataclass
class Link:
    """A link that all connections of a server share.

    Parameters
    ----------
    bits_per_second : float or None
        None for as fast as the machine is.
    latency_seconds : float
        From a request to the first byte of its answer.
    """

    bits_per_second: float | None = None
    latency_seconds: float = 0.0
    _free_at: float = field(default=0.0, init=False, repr=False)
    _lock: threading.Lock = field(default_factory=threading.Lock, init=False, repr=False)

    def wait(self, size_bytes: int, ready: float | None = None) -> float:
        """Wait until bytes have passed; those that came before, of any connection, go first.

        Parameters
        ----------
        size_bytes : int
        ready : float, optional
            When they could be sent, by `time.monotonic`; now by default. Behind other bytes of one
            answer, when those had passed: a thread that woke late does not slow the link down.

        Returns
        -------
        float
            When they had passed.
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
        """Bytes to send at a time."""
        if self.bits_per_second is None:
            return _LARGEST_BLOCK
        return max(1, min(_LARGEST_BLOCK, int(self.bits_per_second * _BLOCK_SECONDS / 8)))


@dataclass(frozen=True)
class Reply:
    """What a request is answered with.

    Parameters
    ----------
    status : HTTPStatus
    headers : mapping of str to str
        Content-Length among them, where the connection is to be used again.
    body : iterable of bytes
        Sent as it comes. An `OSError` that it raises closes the connection at once.
    """

    status: HTTPStatus
    headers: Mapping[str, str]
    body: Iterable[bytes]


@dataclass
class Traffic:
    """What a server has sent: one row a block, in the order in which it was sent.

    Attributes
    ----------
    rows : list of (float, str, int)
        Seconds of `time.monotonic`, name of the file, bytes of its body.
    """

    rows: list[tuple[float, str, int]] = field(default_factory=list)

    def size_bytes(self, name: str, until: float = float("inf")) -> int:
        """Return how many bytes of a file were sent up to a time."""
        return sum(size for at, sent, size in self.rows if sent == name and at <= until)


class SlowServer(ThreadingHTTPServer):
    """Serves files to this machine over a link of limited bandwidth and some latency.

    Parameters
    ----------
    files : mapping of str to bytes
        Contents by path, without the leading slash. ``/`` is ``index.html``.
    link : Link or None
        None for none that slows anything.
    kept : collection of str
        Files that browsers may keep; all others are fetched anew each time.

    Examples
    --------
    >>> from cogsplat.tools.delivery.slow_server import Link, SlowServer, running
    >>> files = {"index.html": b"<p>Hello</p>"}
    >>> with running(SlowServer(files, Link(5e6, latency_seconds=0.04))) as server:
    ...     print(server.url)
    http://127.0.0.1:.../
    """

    allow_reuse_address = os.name == "posix"

    def __init__(
        self, files: Mapping[str, bytes], link: Link | None = None, kept: Collection[str] = ()
    ) -> None:
        self.files = dict(files)
        self.kept = frozenset(kept)
        self.link = link or Link()
        self.traffic = Traffic()
        super().__init__((HOST, 0), _Handler)

    def server_bind(self) -> None:
        """Bind, without asking for the machine's name as `HTTPServer` does, which can take long."""
        socketserver.TCPServer.server_bind(self)
        self.server_name, self.server_port = HOST, int(self.server_address[1])

    @property
    def url(self) -> str:
        """Address of ``index.html``."""
        return f"http://{HOST}:{self.server_port}/"

    def handle_error(self, request: object, client_address: object) -> None:
        """Report a fault; a browser that goes away in the middle of an answer is none."""
        if not isinstance(sys.exception(), ConnectionError | TimeoutError):
            super().handle_error(request, client_address)  # type: ignore[arg-type]

    def reply(self, name: str, wanted: str | None) -> Reply:
        """Say what a request is answered with.

        Parameters
        ----------
        name : str
            Path of the file.
        wanted : str or None
            The request's ``Range``.
        """
        content = self.files.get(name)
        if content is None:
            return text_reply(HTTPStatus.NOT_FOUND)
        try:
            part = parse_range(wanted, len(content))
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
            "Cache-Control": "max-age=3600" if name in self.kept else "no-store",
        }
        if part is not None:
            headers["Content-Range"] = f"bytes {first}-{end - 1}/{len(content)}"
        status = HTTPStatus.OK if part is None else HTTPStatus.PARTIAL_CONTENT
        return Reply(status, headers, [content[first:end]])


def text_reply(status: HTTPStatus) -> Reply:
    """Answer with a status and its name as the text."""
    text = f"{status.value} {status.phrase}\n".encode()
    headers = {"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(text))}
    return Reply(status, headers, [text])


@contextmanager
def running(server: SlowServer) -> Iterator[SlowServer]:
    """Answer requests in a thread as long as the block lasts."""
    thread = threading.Thread(target=server.serve_forever, args=[0.01])
    with server:
        thread.start()
        try:
            yield server
        finally:
            server.shutdown()
            thread.join()


class _Handler(BaseHTTPRequestHandler):
    """Answers the requests of one connection."""

    protocol_version = "HTTP/1.1"
    timeout = _IDLE_SECONDS
    # Blocks leave when they are due, not when a buffer is full.
    disable_nagle_algorithm = True
    server: SlowServer

    def do_GET(self) -> None:
        """Answer with a file or a range of it, at the speed of the link."""
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
            # A body that breaks off, or a browser that went away.
            self.close_connection = True

    def _send(self, name: str, part: bytes) -> None:
        server, size = self.server, self.server.link.block_bytes
        passed: float | None = None
        for first in range(0, len(part), size):
            block = part[first : first + size]
            passed = server.link.wait(len(block), passed)
            self.wfile.write(block)
            server.traffic.rows.append((time.monotonic(), name, len(block)))

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        """Write nothing: the terminal is the user's."""
