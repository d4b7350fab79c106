"""Serve files over HTTP/1.1, and over HTTP/2 where there is a certificate, with hypercorn."""

from __future__ import annotations

import asyncio
import signal
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from cogsplat.codec.errors import MissingExtraError
from cogsplat.formats.storage.atomic import storage_errors

from .file_app import FileApp
from .local_server import HOST

_BACKLOG: Final = 1024
_IDLE_SECONDS: Final = 60.0
_STOP_SIGNALS: Final = ("SIGINT", "SIGTERM", "SIGHUP")


@dataclass(frozen=True)
class Certificate:
    """Files of a certificate and of its key, PEM; browsers speak HTTP/2 with one alone."""

    certificate: Path
    key: Path


class FileServer:
    """Listens on a port and answers requests with an application.

    Parameters
    ----------
    app : FileApp
    port : int
        0 takes a free one.
    host : str
        The address to listen on; by default no other machine reaches it.
    certificate : Certificate, optional
        For ``https://``, with HTTP/2.

    Raises
    ------
    MissingExtraError
        ``needs-serve``: hypercorn is not installed.
    StorageError
        ``io`` or ``permission``: the port cannot be listened on.

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
        self._hypercorn = _hypercorn()
        self._certificate = certificate
        self._stopping = threading.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._stop = asyncio.Event()
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        with storage_errors(f"{host}:{port}"):
            self._socket = socket.create_server((host, port), family=family, backlog=_BACKLOG)
        self.port = int(self._socket.getsockname()[1])
        scheme = "http" if certificate is None else "https"
        shown = f"[{host}]" if ":" in host else host
        self.url = f"{scheme}://{shown}:{self.port}/"

    def serve_forever(self) -> None:
        """Answer requests until `stop`."""
        asyncio.run(self._serve())

    def stop(self) -> None:
        """End `serve_forever`, from any thread."""
        self._stopping.set()
        if self._loop is not None:
            self._loop.call_soon_threadsafe(self._stop.set)

    def close(self) -> None:
        """Stop listening."""
        self._socket.close()

    async def _serve(self) -> None:
        loop = self._loop = asyncio.get_running_loop()
        if self._stopping.is_set():
            return
        loop.set_exception_handler(_told_unless_cancelled)
        if threading.current_thread() is threading.main_thread():
            for name in _STOP_SIGNALS:
                # Not on Windows, where Ctrl-C ends the loop itself.
                with suppress(NotImplementedError, AttributeError):
                    loop.add_signal_handler(getattr(signal, name), self._stop.set)
        config = self._hypercorn.config.Config()
        # hypercorn closes the descriptor that it is given.
        config.bind = [f"fd://{self._socket.dup().detach()}"]
        config.include_server_header = False
        config.keep_alive_timeout = _IDLE_SECONDS
        config.graceful_timeout = 0.2
        config.errorlog = None
        if self._certificate is not None:
            config.certfile = str(self._certificate.certificate)
            config.keyfile = str(self._certificate.key)
        serve = self._hypercorn.asyncio.serve
        await serve(self._app, config, mode="asgi", shutdown_trigger=self._stop.wait)


@contextmanager
def running(server: FileServer) -> Iterator[FileServer]:
    """Answer requests in a thread as long as the block lasts."""
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield server
    finally:
        server.stop()
        thread.join()
        server.close()


def _told_unless_cancelled(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Report a fault of the loop; connections that are cut when the server ends are none."""
    if not isinstance(context.get("exception"), asyncio.CancelledError):
        loop.default_exception_handler(context)


def _hypercorn() -> ModuleType:
    try:
        import hypercorn.asyncio
        import hypercorn.config
    except ImportError as error:
        raise MissingExtraError(
            "needs-serve", "files are served with hypercorn (pip install 'cogsplat[serve]')"
        ) from error
    return hypercorn
