"""Web server for files: HTTP/1.1, or HTTP/2 with a certificate, by hypercorn.

hypercorn parses and answers; connections are accepted here, because its own accept loop has no
limit of their number, and keeps a connection until its keep-alive time ends when the peer has
closed it.
"""

from __future__ import annotations

import asyncio
import errno
import os
import signal
import socket
import ssl
import threading
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from http import HTTPStatus
from pathlib import Path
from typing import Any, Final, cast

from cogsplat.codec.errors import MissingExtraError
from cogsplat.formats.storage.atomic import storage_errors
from cogsplat.tools.terminal.output import print_error_line

from .connection_limit import (
    MAX_CONNECTIONS,
    MAX_HEAD_BYTES,
    Connection,
    OpenConnections,
    connection_limit,
    prepare_listener,
)
from .file_app import READ_HEADERS, SEND_FILE, FileApp, Message, Receive, Send, refuse
from .threaded_server import HOST

_BACKLOG: Final = 1024
# A connection with TLS takes 450 KB, of which 256 KiB are asyncio's buffer.
_MAX_TLS_CONNECTIONS: Final = 150
# Requests in flight at most; with HTTP/2 a connection can have `_MAX_STREAMS` of them.
_MAX_REQUESTS: Final = MAX_CONNECTIONS
# Time between two attempts to accept a connection while there is no room, and between two checks.
_PAUSE_SECONDS: Final = 0.05
_CHECK_SECONDS: Final = 1.0
_TLS_SECONDS: Final = 10.0
# Requests that a client may have in flight on one HTTP/2 connection.
_MAX_STREAMS: Final = 32
_BODIES: Final = ("http.response.body", "websocket.http.response.body")
_DISCONNECTS: Final = ("http.disconnect", "websocket.disconnect")
# Errors of `os.sendfile` for a full socket, and for file systems that do not support it.
_NOT_SENT: Final = (errno.EAGAIN, errno.EINVAL, errno.ENOSYS, errno.ENOTSUP)
_STOP_SIGNALS: Final = ("SIGINT", "SIGTERM", "SIGHUP")

App = Callable[[Message, Receive, Send], Awaitable[None]]


@dataclass(frozen=True)
class Certificate:
    """PEM files of a TLS certificate and its key; browsers require TLS for HTTP/2."""

    certificate: Path
    key: Path


class FileServer:
    """Web server that passes the requests of a port to an application.

    Parameters
    ----------
    app : FileApp
        Application.
    port : int
        TCP port; 0 chooses a free one.
    host : str
        Address to listen on; by default only this machine can connect.
    certificate : Certificate, optional
        Certificate for ``https://`` and HTTP/2.

    Raises
    ------
    MissingExtraError
        ``needs-serve``: hypercorn is not installed.
    StorageError
        ``io`` or ``permission``: listening on the port failed.

    Examples
    --------
    >>> from pathlib import Path
    >>> from cogsplat.tools.delivery.file_app import FileApp
    >>> from cogsplat.tools.delivery.file_server import FileServer, running
    >>> from cogsplat.tools.delivery.shaped_link import LinkQuality, ShapedLink
    >>> app = FileApp(Path("scene.cogs"), ShapedLink(LinkQuality()))
    >>> with running(FileServer(app)) as server:
    ...     print(server.url)
    http://127.0.0.1:.../
    """

    def __init__(
        self,
        app: FileApp,
        port: int = 0,
        host: str = HOST,
        certificate: Certificate | None = None,
    ) -> None:
        self._app = app
        self._hypercorn = _Hypercorn(certificate)
        self._stopping = threading.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stop = asyncio.Event()
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        with storage_errors(f"{host}:{port}"):
            self._socket = socket.create_server((host, port), family=family, backlog=_BACKLOG)
        self._socket.setblocking(False)
        prepare_listener(self._socket)
        most = MAX_CONNECTIONS if certificate is None else _MAX_TLS_CONNECTIONS
        self.connections = OpenConnections(connection_limit(most))
        self.requests = 0
        self._reported: set[str] = set()
        self.port = int(self._socket.getsockname()[1])
        scheme = "http" if certificate is None else "https"
        shown = f"[{host}]" if ":" in host else host
        self.url = f"{scheme}://{shown}:{self.port}/"

    def serve_forever(self) -> None:
        """Serve requests until `stop` is called."""
        asyncio.run(self._serve())

    def stop(self) -> None:
        """End `serve_forever`; may be called from any thread."""
        self._stopping.set()
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._stop.set)

    def close(self) -> None:
        """Stop listening."""
        self._socket.close()

    async def _serve(self) -> None:
        """Accept connections until a stop event or a signal."""
        loop = self._loop = asyncio.get_running_loop()
        if self._stopping.is_set():
            return
        if threading.current_thread() is threading.main_thread():
            for name in _STOP_SIGNALS:
                # Unsupported on Windows, where Ctrl-C ends the loop itself.
                with suppress(NotImplementedError, AttributeError):
                    loop.add_signal_handler(getattr(signal, name), self._stop.set)
        tasks: set[asyncio.Task[None]] = set()
        for work in (self._accept(tasks), self._close_idle()):
            tasks.add(asyncio.create_task(work))
        await self._stop.wait()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    async def _accept(self, tasks: set[asyncio.Task[None]]) -> None:
        """Accept connections while there is room, each served by a task of its own."""
        loop = asyncio.get_running_loop()
        while True:
            if not self.connections.has_room():
                await asyncio.sleep(_PAUSE_SECONDS)
                continue
            try:
                peer, _ = await loop.sock_accept(self._socket)
            except OSError as error:
                # The peer left already, or the process has no descriptors.
                self._report(error)
                await asyncio.sleep(_PAUSE_SECONDS)
                continue
            task = asyncio.create_task(self._serve_peer(peer))
            tasks.add(task)
            task.add_done_callback(tasks.discard)
            # The task counts its connection before the next one is accepted.
            await asyncio.sleep(0)

    async def _close_idle(self) -> None:
        """Close idle connections regularly."""
        while True:
            await asyncio.sleep(_CHECK_SECONDS)
            self.connections.close_idle()

    async def _serve_peer(self, peer: socket.socket) -> None:
        """Serve a connection until it ends, or its peer leaves or is idle for too long."""
        loop = asyncio.get_running_loop()
        serving = asyncio.current_task()
        assert serving is not None
        reader = asyncio.StreamReader(MAX_HEAD_BYTES)
        transport: asyncio.Transport | None = None

        def close() -> None:
            # `transport.close` would wait until the peer has read what is left.
            if transport is not None:
                transport.abort()
            serving.cancel()

        connection = self.connections.add(peer, close)
        try:
            transport, protocol = await loop.connect_accepted_socket(
                lambda: _PeerProtocol(reader, connection),
                peer,
                ssl=self._hypercorn.tls,
                ssl_handshake_timeout=None if self._hypercorn.tls is None else _TLS_SECONDS,
            )
            # `drain` waits until all is sent, so that a connection holds one block. With a limit of
            # 0 a transport of TLS would wait for ever.
            transport.set_write_buffer_limits(1)
            writer = asyncio.StreamWriter(transport, protocol, reader, loop)
            app = partial(self._answer, connection, transport)
            await self._hypercorn.serve(app, reader, writer, transport)
        except asyncio.CancelledError:
            # The connection or the server ends.
            pass
        except Exception as error:
            # A bug of the application or of hypercorn ends one connection, not the server.
            self._report(error)
        finally:
            if transport is not None:
                transport.abort()
            self.connections.remove(peer)

    async def _answer(
        self,
        connection: Connection,
        transport: asyncio.Transport,
        scope: Message,
        receive: Receive,
        send: Send,
    ) -> None:
        """Answer one request, unless its peer leaves before the end.

        hypercorn discards what is sent to a peer that left, so that the application would send all
        of a file to it.
        """
        if self.requests >= _MAX_REQUESTS:
            self.connections.close_longest_idle()
            await refuse(send, HTTPStatus.SERVICE_UNAVAILABLE, {"Retry-After": "1"})
            return
        # Frees the other headers, of which a request can have thousands.
        scope["headers"] = [pair for pair in scope["headers"] if pair[0] in READ_HEADERS]
        answering = asyncio.current_task()
        assert answering is not None
        ended = False

        async def send_on(message: Message) -> None:
            nonlocal ended
            if transport.is_closing():
                raise ConnectionResetError("the peer closed the connection")
            ended = message["type"] in _BODIES and not message.get("more_body", False)
            with connection.sending():
                await send(message)

        async def watch() -> None:
            while (await receive())["type"] not in _DISCONNECTS:
                pass
            if not ended:
                answering.cancel()

        self.requests += 1
        watching = asyncio.create_task(watch())
        try:
            with connection.working():
                await self._app(scope, receive, send_on)
        except OSError:
            # The response breaks off; hypercorn then closes the connection.
            raise
        except Exception as error:
            self._report(error)
            raise
        finally:
            self.requests -= 1
            watching.cancel()

    def _report(self, error: BaseException) -> None:
        """Print a line about an error, the first time that one of its type occurs.

        Peers cause errors of connections, which are the rule, and those of hypercorn that strange
        requests meet: as many as they like.
        """
        while isinstance(error, BaseExceptionGroup):
            error = error.exceptions[0]
        kind = type(error).__name__
        if not isinstance(error, ConnectionError | TimeoutError | ssl.SSLError):
            if kind not in self._reported:
                print_error_line(f"a connection broke off: {kind}: {error}")
            self._reported.add(kind)


class _PeerProtocol(asyncio.StreamReaderProtocol):
    """Protocol of a connection, which ends at once when the peer closes it."""

    def __init__(self, reader: asyncio.StreamReader, connection: Connection) -> None:
        super().__init__(reader)
        self._open_connection = connection

    def eof_received(self) -> bool | None:
        """Close the connection: HTTP has no use for one that is half open."""
        self._open_connection.close()
        return super().eof_received()

    def connection_lost(self, exc: Exception | None) -> None:
        """Close the connection, which ends its task."""
        super().connection_lost(exc)
        self._open_connection.close()


class _NoIdleTask:
    """Substitute for hypercorn's timer of idle connections, which `OpenConnections` closes.

    hypercorn awaits its timer before it releases a connection that the peer has closed.
    """

    async def restart(self, task_group: object, action: object) -> None:
        """Start no timer."""

    async def stop(self) -> None:
        """Stop no timer."""


class _Hypercorn:
    """hypercorn's handler of connections, which are accepted elsewhere.

    Parameters
    ----------
    certificate : Certificate, optional
        Certificate for ``https://`` and HTTP/2.

    Attributes
    ----------
    tls : ssl.SSLContext or None
        Context of the certificate.

    Raises
    ------
    MissingExtraError
        ``needs-serve``: hypercorn is not installed.
    """

    def __init__(self, certificate: Certificate | None) -> None:
        try:
            from hypercorn.asyncio.tcp_server import TCPServer
            from hypercorn.asyncio.worker_context import WorkerContext
            from hypercorn.config import Config
            from hypercorn.utils import wrap_app
        except ImportError as error:
            raise MissingExtraError(
                "needs-serve", "files are served with hypercorn (pip install 'cogsplat[serve]')"
            ) from error
        config = self._config = Config()
        config.include_server_header = False
        config.errorlog = None
        config.h11_max_incomplete_size = MAX_HEAD_BYTES
        config.h2_max_header_list_size = MAX_HEAD_BYTES
        config.h2_max_concurrent_streams = _MAX_STREAMS
        if certificate is not None:
            config.certfile = str(certificate.certificate)
            config.keyfile = str(certificate.key)
        self.tls = config.create_ssl_context()
        self._server = TCPServer
        self._context = WorkerContext(None)
        self._wrap = wrap_app

    async def serve(
        self,
        app: App,
        reader: asyncio.StreamReader,
        writer: asyncio.StreamWriter,
        transport: asyncio.Transport,
    ) -> None:
        """Serve the requests of one connection with an ASGI application."""

        async def answer(scope: Message, receive: Receive, send: Send) -> None:
            if self.tls is None and scope["type"] == "http" and scope["http_version"] != "2":
                scope["extensions"][SEND_FILE] = partial(_send_file, transport, server)
            await app(scope, receive, send)

        wrapped = self._wrap(cast(Any, answer), 0, "asgi")
        loop = asyncio.get_running_loop()
        server = self._server(wrapped, loop, self._config, self._context, {}, reader, writer)
        server.idle_task = cast(Any, _NoIdleTask())
        await server


@dataclass(frozen=True)
class _SentBytes:
    """Placeholder for the bytes of a body that were sent past h11, so that h11 counts the bytes."""

    size: int

    def __len__(self) -> int:
        return self.size


def _send_file(
    transport: asyncio.Transport, server: Any, descriptor: int, first: int, size: int
) -> int:
    """Send bytes of a file to a connection without a copy; the type is `served_content.SendFile`.

    Parameters
    ----------
    transport : Transport
        Transport of a connection without TLS.
    server : TCPServer
        hypercorn's server of the connection, which speaks HTTP/1.
    descriptor, first, size : int
        Open file, first byte and number of bytes.
    """
    if transport.is_closing():
        raise ConnectionResetError("the peer closed the connection")
    if not hasattr(os, "sendfile") or transport.get_write_buffer_size():
        return 0
    try:
        peer = transport.get_extra_info("socket").fileno()
        sent = os.sendfile(peer, descriptor, first, size)
    except OSError as error:
        if error.errno not in _NOT_SENT:
            raise
        return 0
    from h11 import Data

    counted = Data(data=cast(bytes, _SentBytes(sent)))
    server.protocol.protocol.connection.send_with_data_passthrough(counted)
    return sent


@contextmanager
def running(server: FileServer) -> Iterator[FileServer]:
    """Run a server in a thread for the duration of a with block."""
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield server
    finally:
        server.stop()
        thread.join()
        server.close()
