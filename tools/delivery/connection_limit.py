"""Limits on a server's connections: their number, and the time that a peer may be silent."""

from __future__ import annotations

import socket
import sys
import threading
import time
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from heapq import nlargest
from operator import itemgetter
from typing import Final

MAX_CONNECTIONS: Final = 640
"""Connections of a server at most; each can need some 100 KB, measured with unread downloads."""

IDLE_SECONDS: Final = 60.0
"""Time after which a connection is closed whose peer completes no request and reads no block."""

MAX_HEAD_BYTES: Final = 1 << 14
"""Largest head of a request, bytes."""

CROWDED_IDLE_SECONDS: Final = 5.0
"""The same time while new connections wait for room: 64 KiB in it are 100 kbit/s."""

# Descriptors left for files: each answer opens its file for the read of one block only.
_RESERVED_DESCRIPTORS: Final = 64
# Bytes that the kernel may hold of a connection's requests, which are small, and of its responses:
# by default 4 MB of each response that is not read. Linux doubles both.
_RECEIVE_BUFFER: Final = 1 << 14
_SEND_BUFFER: Final = 1 << 18
# Time between two checks of all connections.
_CHECK_SECONDS: Final = 1.0
# Connections closed at a time for new ones: a server tries 20 times a second.
_CLOSED_AT_ONCE: Final = 32


class Connection:
    """An open connection, with the time since its peer last completed a request or read a block.

    Parameters
    ----------
    close : callable
        Closes the connection; called at most once, maybe from another thread.
    """

    def __init__(self, close: Callable[[], None]) -> None:
        self._close = close
        self._closing = False
        self._working = 0
        self._since = time.monotonic()

    def progress(self) -> None:
        """Record that the peer completed a request or read a block."""
        self._since = time.monotonic()

    @contextmanager
    def working(self) -> Iterator[None]:
        """Stop the idle time for the duration of a block, in which the server itself works."""
        self._working += 1
        try:
            yield
        finally:
            self._working -= 1
            self.progress()

    @contextmanager
    def sending(self) -> Iterator[None]:
        """Resume the idle time within `working`, for the duration of a block that sends bytes."""
        self.progress()
        self._working -= 1
        try:
            yield
        finally:
            self._working += 1
            self.progress()

    def idle_seconds(self) -> float:
        """Return the time for which the server has waited for the peer."""
        return 0.0 if self._working else time.monotonic() - self._since

    def close(self) -> None:
        """Close the connection, unless that was done before."""
        if not self._closing:
            self._closing = True
            self._close()


class OpenConnections:
    """The open connections of a server, limited in number.

    While there is no room for another connection, a server leaves new ones in the backlog of its
    socket, and closes those that were idle for `CROWDED_IDLE_SECONDS`, longest first. Otherwise a
    peer may be idle for `IDLE_SECONDS`.

    Parameters
    ----------
    limit : int
        Connections at most.
    """

    def __init__(self, limit: int) -> None:
        self.limit = limit
        self._connections: dict[Hashable, Connection] = {}
        self._lock = threading.Lock()
        self._checked = 0.0

    def add(self, key: Hashable, close: Callable[[], None]) -> Connection:
        """Record a new connection under a key, such as its socket."""
        connection = Connection(close)
        with self._lock:
            self._connections[key] = connection
        return connection

    def remove(self, key: Hashable) -> None:
        """Remove a connection; its ``close`` is not called from then on."""
        with self._lock:
            self._connections.pop(key, None)

    def __getitem__(self, key: Hashable) -> Connection:
        return self._connections[key]

    def __len__(self) -> int:
        return len(self._connections)

    def close_idle(self) -> None:
        """Close the connections whose peers were idle for `IDLE_SECONDS`; call it regularly."""
        now = time.monotonic()
        if now - self._checked < _CHECK_SECONDS:
            return
        self._checked = now
        with self._lock:
            for connection in self._connections.values():
                if connection.idle_seconds() > IDLE_SECONDS:
                    connection.close()

    def has_room(self) -> bool:
        """Return whether another connection can be accepted; if not, close long idle ones."""
        with self._lock:
            room = len(self._connections) < self.limit
        if not room:
            self.close_longest_idle()
        return room

    def close_longest_idle(self) -> None:
        """Close some connections that were idle for `CROWDED_IDLE_SECONDS`, longest first."""
        with self._lock:
            idle = ((each.idle_seconds(), each) for each in self._connections.values())
            crowding = (pair for pair in idle if pair[0] > CROWDED_IDLE_SECONDS)
            for _, connection in nlargest(_CLOSED_AT_ONCE, crowding, key=itemgetter(0)):
                connection.close()


def prepare_listener(listener: socket.socket) -> None:
    """Limit the kernel's buffers of the connections that a listening socket accepts.

    Their short packets are sent at once. Otherwise the end of a response waits some 40 ms for the
    peer's acknowledgement of its beginning (Nagle's algorithm). asyncio sets this option only for
    sockets of known protocol, which those of `socket.create_server` are not.
    """
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER)
    listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


def connection_limit(most: int = MAX_CONNECTIONS) -> int:
    """Return the number of connections that the limit of open files allows, at most `most`.

    Examples
    --------
    >>> from cogsplat.tools.delivery.connection_limit import connection_limit
    >>> connection_limit(10)
    10
    """
    if sys.platform == "win32":
        return most
    import resource

    descriptors, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if descriptors == resource.RLIM_INFINITY:
        return most
    return max(1, min(most, descriptors - _RESERVED_DESCRIPTORS))
