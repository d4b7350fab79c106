"""Web server for a scene and its viewer page, reachable from this machine only."""

from __future__ import annotations

import re
from collections.abc import Mapping
from http import HTTPStatus
from pathlib import Path
from typing import Final

from cogsplat.codec.errors import StorageError
from cogsplat.formats.scenes.registry import is_cogs

from .byte_range import RangeNotSatisfiableError, parse_range
from .served_content import Content, bytes_content, file_content
from .threaded_server import ThreadedHandler, ThreadedServer
from .viewer_pages import PAGE_NAME, linked_page

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
# Bytes that a thread holds of a response.
_BLOCK_BYTES: Final = 1 << 16


class SceneServer(ThreadedServer):
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
        pages = linked_page(title, scene_name, against_name, against_title)
        self._pages = {name: bytes_content(page) for name, page in pages.items()}
        super().__init__(port, _Handler)

    def content(self, name: str) -> Content | None:
        """Return the page or scene of a name; None if there is none.

        Raises
        ------
        StorageError
            The scene's file can no longer be opened.
        """
        scene = self._scenes.get(name)
        return self._pages.get(name) if scene is None else file_content(scene)


class _Handler(ThreadedHandler):
    """Handler of one connection's requests."""

    server_version = "cogsplat"
    sys_version = ""
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

    def do_GET(self) -> None:  # noqa: N802
        """Respond with a page, a scene, or a range of a scene."""
        # Raw names are looked up in a dictionary, so that no path can leave a folder.
        path = self.path.partition("?")[0]
        name = PAGE_NAME if path == "/" else path.removeprefix("/")
        try:
            content = self.server.content(name) if path.startswith("/") else None
        except StorageError:
            # The scene was deleted since the start: the page shows the status.
            content = None
        if content is None:
            self._refuse(HTTPStatus.NOT_FOUND)
            return
        self._respond(name, content)

    def do_HEAD(self) -> None:  # noqa: N802
        """Respond like GET, without a body."""
        self.do_GET()

    def _respond(self, name: str, content: Content) -> None:
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
            self._copy(content, first, end)

    def _copy(self, content: Content, first: int, end: int) -> None:
        """Send bytes of a scene or page."""
        for start in range(first, end, _BLOCK_BYTES):
            try:
                block = content.read(start, min(start + _BLOCK_BYTES, end))
            except OSError:
                # Closing early lets the browser detect it.
                self.close_connection = True
                return
            self.wfile.write(block)
            self.progress()

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
