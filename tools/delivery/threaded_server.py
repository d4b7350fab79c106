"""Base of web servers for this machine only, with one thread for each connection."""

from __future__ import annotations

import os
import socket
import socketserver
import sys
import time
from contextlib import suppress
from http.client import LineTooLong
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from io import BufferedIOBase
from typing import Any, Final, cast

from cogsplat.formats.storage.atomic import storage_errors

from .connection_limit import (
    IDLE_SECONDS,
    MAX_HEAD_BYTES,
    OpenConnections,
    connection_limit,
    prepare_listener,
)

HOST: Final = "127.0.0.1"
"""Loopback address to listen on, so that no other machine can connect."""

_BACKLOG: Final = 1024
# Time between two attempts to accept a connection while there is no room.
_PAUSE_SECONDS: Final = 0.05


class ThreadedServer(ThreadingHTTPServer):
    """Web server for this machine only, whose connections are limited in number and idle time.

    Parameters
    ----------
    port : int
        TCP port; 0 chooses a free one.
    handler : type
        Handler of one connection's requests.

    Raises
    ------
    StorageError
        ``io`` or ``permission``: listening on the port failed.
    """

    # On Windows the option would let another process listen on the same port.
    allow_reuse_address = os.name == "posix"
    request_queue_size = _BACKLOG

    def __init__(self, port: int, handler: type[ThreadedHandler]) -> None:
        self.connections = OpenConnections(connection_limit())
        with storage_errors(f"{HOST}:{port}"):
            super().__init__((HOST, port), handler)

    def server_bind(self) -> None:
        """Bind without the reverse DNS lookup of `HTTPServer`, which can be slow."""
        prepare_listener(self.socket)
        socketserver.TCPServer.server_bind(self)
        self.server_name, self.server_port = HOST, int(self.server_address[1])

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self.server_port}/"

    def get_request(self) -> tuple[socket.socket, Any]:
        """Accept a connection; raise `OSError`, as `accept` may, while there is no room."""
        if not self.connections.has_room():
            time.sleep(_PAUSE_SECONDS)
            raise BlockingIOError(f"{self.connections.limit} connections are open")
        return super().get_request()

    def process_request(self, request: Any, client_address: Any) -> None:
        """Count a connection and start its thread."""

        def close() -> None:
            # The thread's next read or write ends; the peer may have closed the connection already.
            with suppress(OSError):
                request.shutdown(socket.SHUT_RDWR)

        self.connections.add(request, close)
        super().process_request(request, client_address)

    def shutdown_request(self, request: Any) -> None:
        """Close a connection."""
        self.connections.remove(request)
        super().shutdown_request(request)

    def service_actions(self) -> None:
        """Close idle connections; called regularly."""
        self.connections.close_idle()

    def handle_error(self, request: object, client_address: object) -> None:
        """Report errors, except connections that the browser closed during a response."""
        if not isinstance(sys.exception(), ConnectionError | TimeoutError):
            super().handle_error(request, client_address)  # type: ignore[arg-type]


class _HeadReader:
    """Reader of a connection that limits the head of a request.

    http.server accepts heads of 6.5 MB.

    Parameters
    ----------
    file : BufferedIOBase
        Reader of the socket.

    Attributes
    ----------
    left : int
        Bytes that the head may still have.
    """

    def __init__(self, file: BufferedIOBase) -> None:
        self._file = file
        self.left = 0

    def readline(self, size: int) -> bytes:
        """Return a line, of `size` bytes at most."""
        line = self._file.readline(min(size, self.left + 1))
        self.left -= len(line)
        if self.left < 0:
            raise LineTooLong("head of a request")
        return line

    def close(self) -> None:
        """Close the reader."""
        self._file.close()


class ThreadedHandler(BaseHTTPRequestHandler):
    """Handler of one connection's requests, which reports the peer's progress."""

    protocol_version = "HTTP/1.1"
    timeout = IDLE_SECONDS
    server: ThreadedServer

    def setup(self) -> None:
        """Prepare the connection."""
        super().setup()
        self._head = _HeadReader(self.rfile)
        self.rfile = cast(BufferedIOBase, self._head)

    def handle_one_request(self) -> None:
        """Handle one request; close the connection if its first line alone is too long."""
        self._head.left = MAX_HEAD_BYTES
        try:
            super().handle_one_request()
        except LineTooLong:
            self.close_connection = True

    def parse_request(self) -> bool:
        """Parse a request; http.server answers with status 431 if its head is too long."""
        self.progress()
        return super().parse_request()

    def progress(self) -> None:
        """Record that the peer completed a request or read a block."""
        self.server.connections[self.connection].progress()

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        """Suppress the request log, which would fill the user's terminal."""
