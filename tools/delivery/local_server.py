"""A web server for a scene and its viewer, for browsers of this machine."""

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
"""The address that is listened on: no other machine reaches it."""

# Names under which browsers know this machine, with any port, because ports are forwarded. A page
# of another site whose name was made to lead here (DNS rebinding) comes with that site's name.
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
    """What an answer is taken from: an open file, its length in bytes and its strong ETag."""

    file: BinaryIO
    size: int
    etag: str


class SceneServer(ThreadingHTTPServer):
    """Serves a viewer page at ``/`` and a scene or two beside it, to this machine alone.

    Requests for anything else get 404, those that name another host 403 and other methods than GET
    and HEAD 405. The scene is answered by byte ranges, with an ETag that changes with the file.

    Parameters
    ----------
    scene : Path
        A ``.cogs`` file or the PLY of 3DGS training. It is opened for each request.
    title : str
        Of the page.
    port : int
        0 takes a free one.
    against : Path, optional
        A second one, which the page compares with the scene.
    against_title : str, optional
        What the page calls it.

    Raises
    ------
    StorageError
        ``io`` or ``permission``: the port cannot be listened on.

    Examples
    --------
    >>> from pathlib import Path
    >>> from cogsplat.tools.delivery.local_server import SceneServer
    >>> with SceneServer(Path("scene.cogs"), "scene") as server:
    ...     print(server.url)
    http://127.0.0.1:.../
    """

    # On Windows the option would let another process take the port over.
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
        # Their own names stay here: they may say more than the page needs to know.
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
        """Bind, without asking for the machine's name as `HTTPServer` does, which can take long."""
        socketserver.TCPServer.server_bind(self)
        self.server_name, self.server_port = HOST, int(self.server_address[1])

    @property
    def url(self) -> str:
        """Address of the page."""
        return f"http://{HOST}:{self.server_port}/"

    def handle_error(self, request: object, client_address: object) -> None:
        """Report a fault; a browser that goes away in the middle of an answer is none."""
        if not isinstance(sys.exception(), ConnectionError | TimeoutError):
            super().handle_error(request, client_address)  # type: ignore[arg-type]

    def open_content(self, name: str) -> _Content | None:
        """Open what stands under a name of the folder, None where nothing does.

        Raises
        ------
        StorageError
            The scene's file cannot be opened any more.
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
    """Answers the requests of one connection."""

    protocol_version = "HTTP/1.1"
    server_version = "cogsplat"
    sys_version = ""
    timeout = _IDLE_SECONDS
    server: SceneServer

    def parse_request(self) -> bool:
        """Refuse requests of other methods and for other hosts."""
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
        """Answer with a page, or with a range of the scene."""
        # Names are compared as they are sent: there is no path that could lead out of a folder.
        path = self.path.partition("?")[0]
        name = PAGE_NAME if path == "/" else path.removeprefix("/")
        try:
            content = self.server.open_content(name) if path.startswith("/") else None
        except StorageError:
            # The scene was there at the start and is gone: the page says so by the status.
            content = None
        if content is None:
            self._refuse(HTTPStatus.NOT_FOUND)
            return
        with content.file:
            self._answer(name, content)

    def do_HEAD(self) -> None:
        """Answer as to GET, without the bytes."""
        self.do_GET()

    def _answer(self, name: str, content: _Content) -> None:
        headers = {
            "ETag": content.etag,
            "Accept-Ranges": "bytes",
            # Kept, but asked for again, so that a file that was written anew is seen.
            "Cache-Control": "no-cache",
        }
        given = self.headers.get("If-None-Match")
        if given is not None and content.etag in [tag.strip() for tag in given.split(",")]:
            self._begin(HTTPStatus.NOT_MODIFIED, headers)
            return
        # Ranges are for GET alone (RFC 9110, 14.2); If-Range asks for the whole of another file.
        wanted = self.headers.get("Range") if self.command == "GET" else None
        if self.headers.get("If-Range", content.etag) != content.etag:
            wanted = None
        try:
            part = parse_range(wanted, content.size)
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
        while count:
            block = file.read(min(count, _COPY_BYTES))
            if not block:
                # The file was cut while it was sent: an answer that ends early tells the browser.
                self.close_connection = True
                return
            self.wfile.write(block)
            count -= len(block)

    def _begin(self, status: HTTPStatus, headers: Mapping[str, str]) -> None:
        self.send_response(status)
        for name, value in headers.items():
            self.send_header(name, value)
        self.send_header("X-Content-Type-Options", "nosniff")
        # Pages of other sites can neither read the scene nor draw it.
        self.send_header("Cross-Origin-Resource-Policy", "same-origin")
        self.end_headers()

    def _refuse(self, status: HTTPStatus, **headers: str) -> None:
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
        """Write nothing: the terminal is the user's."""
