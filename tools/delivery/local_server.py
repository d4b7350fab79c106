"""Web server for a scene and its viewer page, reachable from this machine only."""

from __future__ import annotations

import hashlib
import io
import os
import re
import socketserver
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import BinaryIO, Final

from cogsplat.codec.errors import StorageError
from cogsplat.formats.scenes.registry import is_cogs
from cogsplat.formats.storage.atomic import open_for_read, storage_errors

from .byte_range import RangeNotSatisfiableError, parse_range
from .viewer_pages import PAGE_NAME, linked_page

HOST: Final = "127.0.0.1"
"""Loopback address to listen on, so that no other machine can connect."""

# Accepted Host headers: names of this machine with any port, because ports may be forwarded. Other
# names are rejected against DNS rebinding, where a foreign site's name resolves to this machine.
_OWN_HOST: Final = re.compile(r"(127\.0\.0\.1|localhost)(:\d{1,5})?", re.ASCII | re.IGNORECASE)

_METHODS: Final = ("GET", "HEAD")
_TYPES: Final = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".cogs": "application/octet-stream",
    ".ply": "application/octet-stream",
}
_COPY_BYTES: Final = 1 << 18
_IDLE_SECONDS: Final = 60


@dataclass(frozen=True)
class _Content:
    """The content of a response: an open file, its size in bytes, and its strong ETag."""

    file: BinaryIO
    size: int
    etag: str


class SceneServer(ThreadingHTTPServer):
    """Web server for a viewer page at ``/`` and one or two scenes, for this machine only.

    Scenes support byte ranges and have an ETag that changes with the file. Error responses are 404
    for other paths, 403 for foreign Host headers, and 405 for methods other than GET and HEAD.

    Parameters
    ----------
    scene : Path
        A ``.cogs`` file or a PLY of 3DGS training; opened for each request.
    title : str
        Title of the page.
    port : int
        TCP port; 0 chooses a free one.
    against : Path, optional
        Second scene, which the page compares with the first.
    against_title : str, optional
        Label of the second scene on the page.

    Raises
    ------
    StorageError
        ``io`` or ``permission``: listening on the port failed.

    Examples
    --------
    >>> from pathlib import Path
    >>> from cogsplat.tools.delivery.local_server import SceneServer
    >>> with SceneServer(Path("scene.cogs"), "scene") as server:
    ...     print(server.url)
    http://127.0.0.1:.../
    """

    # On Windows the option would let another process listen on the same port.
    allow_reuse_address = os.name == "posix"

    def __init__(
        self,
        scene: Path,
        title: str,
        port: int = 0,
        *,
        against: Path | None = None,
        against_title: str | None = None,
    ) -> None:
        # Scenes get neutral names, because the page need not expose the files' names.
        named = {"scene": scene, "against": against}
        self._scenes = {
            f"{name}{'.cogs' if is_cogs(path) else '.ply'}": path
            for name, path in named.items()
            if path is not None
        }
        scene_name, against_name = [*self._scenes, None][:2]
        assert scene_name is not None
        self._pages: Mapping[str, bytes] = linked_page(
            title, scene_name, against_name, against_title
        )
        with storage_errors(f"{HOST}:{port}"):
            super().__init__((HOST, port), _Handler)

    def server_bind(self) -> None:
        """Bind without the reverse DNS lookup of `HTTPServer`, which can be slow."""
        socketserver.TCPServer.server_bind(self)
        self.server_name, self.server_port = HOST, int(self.server_address[1])

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self.server_port}/"

    def handle_error(self, request: object, client_address: object) -> None:
        """Report errors, except connections that the browser closed during a response."""
        if not isinstance(sys.exception(), ConnectionError | TimeoutError):
            super().handle_error(request, client_address)  # type: ignore[arg-type]

    def open_content(self, name: str) -> _Content | None:
        """Open the page or scene of a name; None if there is none.

        Raises
        ------
        StorageError
            The scene's file can no longer be opened.
        """
        if name in self._scenes:
            file = open_for_read(self._scenes[name])
            status = os.fstat(file.fileno())
            etag = f'"{status.st_mtime_ns:x}-{status.st_size:x}-{status.st_ino:x}"'
            return _Content(file, status.st_size, etag)
        page = self._pages.get(name)
        if page is None:
            return None
        etag = f'"{hashlib.sha256(page).hexdigest()[:32]}"'
        return _Content(io.BytesIO(page), len(page), etag)


class _Handler(BaseHTTPRequestHandler):
    """Handler of one connection's requests."""

    protocol_version = "HTTP/1.1"
    server_version = "cogsplat"
    sys_version = ""
    timeout = _IDLE_SECONDS
    server: SceneServer

    def parse_request(self) -> bool:
        """Parse a request; reject unsupported methods and foreign Host headers."""
        if not super().parse_request():
            return False
        if self.command not in _METHODS:
            self._refuse(HTTPStatus.METHOD_NOT_ALLOWED, Allow=", ".join(_METHODS))
            return False
        hosts = self.headers.get_all("Host") or []
        if len(hosts) != 1:
            self._refuse(HTTPStatus.BAD_REQUEST)
            return False
        if not _OWN_HOST.fullmatch(hosts[0].strip()):
            self._refuse(HTTPStatus.FORBIDDEN)
            return False
        return True

    def do_GET(self) -> None:
        """Respond with a page, a scene, or a range of a scene."""
        # Raw names are looked up in a dictionary, so that no path can leave a folder.
        path = self.path.partition("?")[0]
        name = PAGE_NAME if path == "/" else path.removeprefix("/")
        try:
            content = self.server.open_content(name) if path.startswith("/") else None
        except StorageError:
            # The scene was deleted since the start: the page shows the status.
            content = None
        if content is None:
            self._refuse(HTTPStatus.NOT_FOUND)
            return
        with content.file:
            self._respond(name, content)

    def do_HEAD(self) -> None:
        """Respond like GET, without a body."""
        self.do_GET()

    def _respond(self, name: str, content: _Content) -> None:
        """Respond with content or a range of it, after checking the request's conditions."""
        headers = {
            "ETag": content.etag,
            "Accept-Ranges": "bytes",
            # The browser may cache, but must revalidate, so that it sees a rewritten file.
            "Cache-Control": "no-cache",
        }
        tags = self.headers.get("If-None-Match")
        if tags is not None and content.etag in [tag.strip() for tag in tags.split(",")]:
            self._begin(HTTPStatus.NOT_MODIFIED, headers)
            return
        # Ranges apply to GET only (RFC 9110, 14.2). If-Range with an old ETag means the whole file.
        stated = self.headers.get("Range") if self.command == "GET" else None
        if self.headers.get("If-Range", content.etag) != content.etag:
            stated = None
        try:
            part = parse_range(stated, content.size)
        except RangeNotSatisfiableError:
            self._refuse(
                HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE,
                **{"Content-Range": f"bytes */{content.size}"},
            )
            return
        first, end = part or (0, content.size)
        headers["Content-Type"] = _TYPES[Path(name).suffix]
        headers["Content-Length"] = str(end - first)
        if part is not None:
            headers["Content-Range"] = f"bytes {first}-{end - 1}/{content.size}"
        self._begin(HTTPStatus.OK if part is None else HTTPStatus.PARTIAL_CONTENT, headers)
        if self.command == "GET":
            content.file.seek(first)
            self._copy(content.file, end - first)

    def _copy(self, file: BinaryIO, count: int) -> None:
        """Send the next `count` bytes of a file."""
        while count:
            block = file.read(min(count, _COPY_BYTES))
            if not block:
                # The file was truncated: closing early lets the browser detect it.
                self.close_connection = True
                return
            self.wfile.write(block)
            count -= len(block)

    def _begin(self, status: HTTPStatus, headers: Mapping[str, str]) -> None:
        """Send the status and headers of a response."""
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        self.send_header("X-Content-Type-Options", "nosniff")
        # Pages of other sites cannot read or embed the scene.
        self.send_header("Cross-Origin-Resource-Policy", "same-origin")
        self.end_headers()

    def _refuse(self, status: HTTPStatus, **headers: str) -> None:
        """Send an error response with its status as text, and close the connection."""
        text = f"{status.value} {status.phrase}\n".encode()
        self.close_connection = True
        headers |= {
            "Content-Type": "text/plain; charset=utf-8",
            "Content-Length": str(len(text)),
            "Connection": "close",
        }
        self._begin(status, headers)
        if self.command != "HEAD":
            self.wfile.write(text)

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        """Suppress the request log, which would fill the user's terminal."""
