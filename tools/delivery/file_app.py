"""ASGI application that serves scenes' files with ranges, CORS, media types and ETags."""

from __future__ import annotations

import os
from collections.abc import Awaitable, Callable, Mapping, MutableMapping
from http import HTTPStatus
from pathlib import Path, PurePath, PurePosixPath
from typing import Any, Final
from urllib.parse import unquote_to_bytes

from cogsplat.codec.errors import StorageError

from .byte_range import RangeNotSatisfiableError, parse_range
from .served_content import Content, SendFile, bytes_content, file_content
from .shaped_link import ShapedLink

Message = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Message]]
Send = Callable[[Message], Awaitable[None]]

_METHODS: Final = "GET, HEAD, OPTIONS"

TYPES: Final = {
    ".html": "text/html; charset=utf-8",
    ".css": "text/css; charset=utf-8",
    ".js": "text/javascript; charset=utf-8",
    ".mjs": "text/javascript; charset=utf-8",
    ".json": "application/json",
    ".wasm": "application/wasm",
    ".png": "image/png",
    ".svg": "image/svg+xml",
}
"""Media types by extension; all other files, e.g. scenes, are application/octet-stream."""

_IMMUTABLE: Final = "public, max-age=31536000, immutable, no-transform"
_REVALIDATED: Final = "no-cache, no-transform"

READ_HEADERS: Final = frozenset({b"range", b"if-range", b"if-match", b"if-none-match"})
"""Headers of requests that are read."""

SEND_FILE: Final = "cogsplat.send_file"
"""Key of ``scope["extensions"]``: a `SendFile` of the connection, if it can have one."""

# Bytes that a `SendFile` may send at once, and bytes of the block after them, which waits for room.
# Processor time of a download of 300 MB, ns per byte: 0.51 with blocks of 4 KiB, 0.43 with 16 KiB,
# 0.49 with 64 KiB; 0.61 and 1.35 with 256 and 64 KiB sent at once; 0.85 without `SendFile`.
_DIRECT_BYTES: Final = 1 << 20
_WAITING_BYTES: Final = 1 << 14

# Folder of the objects named by the hash of their content (SPEC 3.4), which never change.
_OBJECT_FOLDER: Final = "segments"

# Pages of any origin may read files, and the headers that a reader checks.
_CORS: Final = {
    "Access-Control-Allow-Origin": "*",
    "Access-Control-Expose-Headers": (
        "ETag, Content-Range, Accept-Ranges, Content-Length, Content-Encoding, Retry-After, Date"
    ),
    "Cross-Origin-Resource-Policy": "cross-origin",
    "Timing-Allow-Origin": "*",
    "X-Content-Type-Options": "nosniff",
}
_PREFLIGHT: Final = {
    "Access-Control-Allow-Methods": _METHODS,
    "Access-Control-Allow-Headers": "Range, If-Range, If-Match, If-None-Match, Cache-Control",
    "Access-Control-Max-Age": "86400",
}


class ConnectionLostError(ConnectionError):
    """A response breaks off, as on a bad link; the server then closes the connection."""


class FileApp:
    """ASGI application for the files of a folder, or for one file.

    Parameters
    ----------
    root : Path
        A folder, or a file, which is served under its own name. Of a folder, names that begin with
        a dot are not served, nor links to such names or to targets outside the folder.
    link : ShapedLink
        Simulated link of all responses.
    pages : mapping of str to bytes
        Further files in memory, by name; ``/`` serves ``index.html``.

    Examples
    --------
    >>> from pathlib import Path
    >>> from cogsplat.tools.delivery.file_app import FileApp
    >>> from cogsplat.tools.delivery.shaped_link import LinkQuality, ShapedLink
    >>> app = FileApp(Path("scene.cogs"), ShapedLink(LinkQuality()))
    """

    def __init__(
        self, root: Path, link: ShapedLink, pages: Mapping[str, bytes] | None = None
    ) -> None:
        self._root = root.resolve()
        self._name = root.name
        self._link = link
        self._pages = {name: bytes_content(page) for name, page in (pages or {}).items()}
        # Files of which bytes are being sent.
        self._copies = 0

    async def __call__(self, scope: Message, receive: Receive, send: Send) -> None:
        """Handle one HTTP request; refuse a WebSocket; acknowledge the ASGI lifespan protocol."""
        if scope["type"] == "lifespan":
            await _lifespan(receive, send)
        elif scope["type"] == "http":
            await self._handle(scope, send)
        elif scope["type"] == "websocket":
            await refuse(_as_websocket(send), HTTPStatus.NOT_FOUND)

    async def _handle(self, scope: Message, send: Send) -> None:
        """Handle one HTTP request."""
        if await self._link.begin():
            await refuse(send, HTTPStatus.SERVICE_UNAVAILABLE, {"Retry-After": "0"})
            return
        method: str = scope["method"]
        if method == "OPTIONS":
            await _begin(send, HTTPStatus.NO_CONTENT, {**_PREFLIGHT, "Allow": _METHODS})
            await send({"type": "http.response.body", "body": b""})
            return
        if method not in ("GET", "HEAD"):
            await refuse(send, HTTPStatus.METHOD_NOT_ALLOWED, {"Allow": _METHODS})
            return
        name = os.fsdecode(unquote_to_bytes(scope["raw_path"].partition(b"?")[0])).lstrip("/")
        name = name or "index.html"
        try:
            content = self._content(name)
        except StorageError:
            # The path names a file, but opening it failed, e.g. for want of descriptors.
            await refuse(send, HTTPStatus.SERVICE_UNAVAILABLE, {"Retry-After": "1"})
            return
        if content is None:
            await refuse(send, HTTPStatus.NOT_FOUND)
            return
        headers = {
            key.decode("latin-1"): value.decode("latin-1") for key, value in scope["headers"]
        }
        send_file = scope.get("extensions", {}).get(SEND_FILE)
        await self._send(name, content, headers, send, send_file, with_body=method == "GET")

    def _content(self, name: str) -> Content | None:
        """Return the page or file of a name; None for a name that is not served.

        Raises
        ------
        StorageError
            The file is there but cannot be opened.
        """
        page = self._pages.get(name)
        if page is not None:
            return page
        path = self._path(name)
        return None if path is None else file_content(path)

    def _path(self, name: str) -> Path | None:
        """Return the path of a served file; None for a name that must not be served."""
        try:
            if self._root.is_file():
                return self._root if name == self._name else None
            if "\0" in name or "\\" in name or ":" in name or _has_dot_name(PurePosixPath(name)):
                return None
            path = self._root.joinpath(*PurePosixPath(name).parts).resolve(strict=True)
            served = path.is_file() and os.access(path, os.R_OK)
        except (OSError, RuntimeError):
            # No such file, a name that is too long, or links in a circle.
            return None
        if not served or not path.is_relative_to(self._root):
            return None
        return None if _has_dot_name(path.relative_to(self._root)) else path

    async def _send(
        self,
        name: str,
        content: Content,
        request_headers: Mapping[str, str],
        send: Send,
        send_file: SendFile | None,
        *,
        with_body: bool,
    ) -> None:
        """Send a file, or a range of it, after checking the request's conditions."""
        media_type = TYPES.get(PurePosixPath(name).suffix.lower(), "application/octet-stream")
        immutable = _OBJECT_FOLDER in PurePosixPath(name).parts[:-1]
        headers = {
            "ETag": content.etag,
            "Accept-Ranges": "bytes",
            "Cache-Control": _IMMUTABLE if immutable else _REVALIDATED,
            "Content-Type": media_type,
        }
        if content.etag in _tags(request_headers.get("if-none-match", "")):
            await _begin(send, HTTPStatus.NOT_MODIFIED, headers)
            await send({"type": "http.response.body", "body": b""})
            return
        match_tags = _tags(request_headers.get("if-match", ""))
        if match_tags and content.etag not in match_tags and "*" not in match_tags:
            await refuse(send, HTTPStatus.PRECONDITION_FAILED, {"ETag": content.etag})
            return
        # Ranges apply to GET only (RFC 9110, 14.2). If-Range with an old ETag means the whole file.
        unchanged = request_headers.get("if-range", content.etag) == content.etag
        stated = request_headers.get("range") if with_body and unchanged else None
        try:
            part = parse_range(stated, content.size)
        except RangeNotSatisfiableError:
            missing = {"Content-Range": f"bytes */{content.size}", "ETag": content.etag}
            await refuse(send, HTTPStatus.REQUESTED_RANGE_NOT_SATISFIABLE, missing)
            return
        first, end = part or (0, content.size)
        headers["Content-Length"] = str(end - first)
        if part is not None:
            headers["Content-Range"] = f"bytes {first}-{end - 1}/{content.size}"
        await _begin(send, HTTPStatus.OK if part is None else HTTPStatus.PARTIAL_CONTENT, headers)
        if with_body:
            await self._copy(content, first, end, send, send_file)
        await send({"type": "http.response.body", "body": b""})

    async def _copy(
        self, content: Content, first: int, end: int, send: Send, send_file: SendFile | None
    ) -> None:
        """Send bytes of a file at the speed of the link.

        With a `SendFile`, most bytes go from the file to the socket without a copy in this process:
        as many as the socket's buffer has room for, then a small block, which waits for room.

        Raises
        ------
        ConnectionLostError
            The link breaks.
        ContentChangedError
            The file was changed during the response.
        """
        stop = self._link.breaks_at(end - first)
        start = first
        direct = send_file if stop is None and self._link.is_unlimited else None
        self._copies += 1
        try:
            while start < end:
                block_bytes = self._link.block_bytes(self._copies)
                if direct is not None:
                    start += content.send(direct, start, min(start + _DIRECT_BYTES, end))
                    if start == end:
                        break
                    block_bytes = min(block_bytes, _WAITING_BYTES)
                until = min(start + block_bytes, end)
                if stop is not None and until - first > stop:
                    raise ConnectionLostError("the link breaks")
                block = content.read(start, until)
                await self._link.wait(len(block))
                await send({"type": "http.response.body", "body": block, "more_body": True})
                start = until
        finally:
            self._copies -= 1


def _has_dot_name(path: PurePath) -> bool:
    """Return whether a part of a path begins with a dot."""
    return any(part.startswith(".") for part in path.parts)


def _tags(header: str) -> list[str]:
    """Split a header of ETags."""
    return [tag.strip() for tag in header.split(",") if tag.strip()]


async def _lifespan(receive: Receive, send: Send) -> None:
    """Acknowledge the messages of the ASGI lifespan protocol."""
    while True:
        kind = (await receive())["type"]
        await send({"type": f"{kind}.complete"})
        if kind == "lifespan.shutdown":
            return


async def _begin(send: Send, status: HTTPStatus, headers: Mapping[str, str]) -> None:
    """Send the status and headers of a response, with the CORS headers."""
    pairs = [
        (key.lower().encode("latin-1"), value.encode("latin-1"))
        for key, value in {**headers, **_CORS}.items()
    ]
    await send({"type": "http.response.start", "status": int(status), "headers": pairs})


def _as_websocket(send: Send) -> Send:
    """Return a `send` for the HTTP response that refuses a WebSocket (ASGI extension)."""

    async def send_on(message: Message) -> None:
        await send({**message, "type": f"websocket.{message['type']}"})

    return send_on


async def refuse(send: Send, status: HTTPStatus, headers: Mapping[str, str] | None = None) -> None:
    """Send an error response with its status as text.

    Parameters
    ----------
    send : callable
        ASGI's ``send`` of the request.
    status : HTTPStatus
        Status of the response.
    headers : mapping of str to str, optional
        Further headers.
    """
    text = f"{status.value} {status.phrase}\n".encode()
    own = {"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(text))}
    await _begin(send, status, {**(headers or {}), **own, "Cache-Control": "no-store"})
    await send({"type": "http.response.body", "body": text})
