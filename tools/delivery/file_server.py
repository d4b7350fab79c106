"""Web server for files: HTTP/1.1, or HTTP/2 with a certificate, by hypercorn."""

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
        """Run hypercorn until a stop event or a signal."""
        loop = self._loop = asyncio.get_running_loop()
        if self._stopping.is_set():
            return
        loop.set_exception_handler(_report_unless_cancelled)
        if threading.current_thread() is threading.main_thread():
            for name in _STOP_SIGNALS:
                # Unsupported on Windows, where Ctrl-C ends the loop itself.
                with suppress(NotImplementedError, AttributeError):
                    loop.add_signal_handler(getattr(signal, name), self._stop.set)
        config = self._hypercorn.config.Config()
        # A duplicate descriptor, because hypercorn closes its own.
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
    """Run a server in a thread for the duration of a with block."""
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield server
    finally:
        server.stop()
        thread.join()
        server.close()


def _report_unless_cancelled(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    """Report errors of the event loop, except connections cancelled when the server stops."""
    if not isinstance(context.get("exception"), asyncio.CancelledError):
        loop.default_exception_handler(context)


def _hypercorn() -> ModuleType:
    """Import hypercorn, or raise ``needs-serve``."""
    try:
        import hypercorn.asyncio
        import hypercorn.config
    except ImportError as error:
        raise MissingExtraError(
            "needs-serve", "files are served with hypercorn (pip install 'cogsplat[serve]')"
        ) from error
    return hypercorn
