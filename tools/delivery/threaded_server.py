"""Base of web servers for this machine only, with one thread for each connection."""

from __future__ import annotations

import os
import socket
import socketserver
import sys
import time
from contextlib import suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, Final

from cogsplat.formats.storage.atomic import storage_errors

from .connection_limit import IDLE_SECONDS, OpenConnections, connection_limit, limit_buffers

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
        limit_buffers(self.socket)
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


class ThreadedHandler(BaseHTTPRequestHandler):
    """Handler of one connection's requests, which reports the peer's progress."""

    protocol_version = "HTTP/1.1"
    timeout = IDLE_SECONDS
    server: ThreadedServer

    def parse_request(self) -> bool:
        """Parse a request."""
        self.progress()
        return super().parse_request()

    def progress(self) -> None:
        """Record that the peer completed a request or read a block."""
        self.server.connections[self.connection].progress()

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        """Suppress the request log, which would fill the user's terminal."""
