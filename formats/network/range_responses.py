"""Responses to range requests, whose status and headers are checked before their bytes are used."""

from __future__ import annotations

import asyncio
import re
from collections.abc import AsyncIterator, Mapping
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from typing import Final, Protocol

from cogsplat.codec.errors import StorageError

from .backoff import PROGRESS_BYTES, TRANSIENT_STATUSES, TransientError, retry_after_seconds

_CONTENT_RANGE: Final = re.compile(r"bytes (\d{1,19})-(\d{1,19})/(\d{1,19}|\*)", re.ASCII)
_UNSATISFIED: Final = re.compile(r"bytes \*/(\d{1,19})", re.ASCII)
_LENGTH: Final = re.compile(r"\d{1,19}", re.ASCII)


@dataclass(frozen=True)
class ResponseHead:
    """Byte range, file length and ETag according to the headers of a response.

    Parameters
    ----------
    first, end : int
        Range of the body in the file: the first byte, and one past the last. `end` is -1 for a
        whole file of unknown length.
    total : int or None
        Length of the file, bytes; None where the headers lack it.
    etag : str or None
        Strong ETag; None for a weak one, which does not identify bytes.
    is_whole : bool
        Whether the body is the whole file instead of the requested range.
    """

    first: int
    end: int
    total: int | None
    etag: str | None
    is_whole: bool


@dataclass(frozen=True)
class RangeResponse:
    """Accepted response to a range request.

    Parameters
    ----------
    head : ResponseHead
        Range of the body.
    parts : async iterator of bytes
        Body, in parts as they arrive.
    """

    head: ResponseHead
    parts: AsyncIterator[bytes]


class Transport(Protocol):
    """Protocol for requesting byte ranges of one file; used in one event loop."""

    def get(
        self, first: int, end: int, *, bypass_caches: bool = False
    ) -> AbstractAsyncContextManager[RangeResponse]:
        """Request bytes `first` to `end`; the response is shorter where the file ends before.

        Parameters
        ----------
        first, end : int
            First byte of the file, and one past the last.
        bypass_caches : bool
            Whether to bypass HTTP caches.

        Raises
        ------
        TransientError
            The request failed and a retry may succeed.
        StorageError
            The request failed for good.
        """

    async def close(self) -> None:
        """Close all connections."""


class SiblingTransport(Transport, Protocol):
    """Transport of one file that also opens sibling files."""

    def sibling(self, name: str) -> Transport:
        """Return a transport for the file `name`, relative to this file, on shared connections."""


async def timely(
    parts: AsyncIterator[bytes], idle_seconds: float, where: str
) -> AsyncIterator[bytes]:
    """Yield the parts of a body; raise an error if 16 KiB of the body take too long.

    Parameters
    ----------
    parts : async iterator of bytes
        Body of a response.
    idle_seconds : float
        Time for each 16 KiB, and for the end of the body, seconds. Time in which the consumer does
        not ask for a part is not counted.
    where : str
        Name of the file in messages.

    Raises
    ------
    TransientError
        ``network-timeout``.
    """
    loop = asyncio.get_running_loop()
    count, waited = 0, 0.0
    while True:
        start = loop.time()
        try:
            async with asyncio.timeout(idle_seconds - waited):
                part = await anext(parts, None)
        except TimeoutError as error:
            raise late(where, idle_seconds, count) from error
        if part is None:
            return
        waited += loop.time() - start
        count += len(part)
        if count >= PROGRESS_BYTES:
            count, waited = 0, 0.0
        yield part


def late(where: str, seconds: float, count: int = 0) -> TransientError:
    """Return the error for a peer that sent `count` bytes in `seconds`, less than progress."""
    found = f"{count} bytes in" if count else "no byte for"
    return TransientError(
        "network-timeout",
        f"{where}: {found} {seconds:g} s, expected {PROGRESS_BYTES} or the whole response",
    )


def check_response_head(
    status: int, headers: Mapping[str, str], first: int, end: int, where: str
) -> ResponseHead:
    """Check the status and headers of the response to a range request.

    Parameters
    ----------
    status : int
        HTTP status code.
    headers : mapping of str to str
        Header values by lower-case name.
    first, end : int
        Requested range: the first byte, and one past the last.
    where : str
        Name of the file in messages.

    Raises
    ------
    TransientError
        ``http-status``: a status after which a retry may succeed.
    StorageError
        ``not-found``, ``permission``, ``http-status``, ``answer-range``, ``answer-encoding``;
        ``source-changed`` where the file ends before the range.
    """
    what = f"{where}: bytes {first} to {end - 1}"
    if status not in (200, 206, 416):
        raise _refusal(status, headers, what)
    if status == 416:
        length_only = _UNSATISFIED.fullmatch(headers.get("content-range", "").strip())
        if first == 0 and length_only is not None and int(length_only[1]) == 0:
            return ResponseHead(0, 0, 0, None, is_whole=False)
        raise StorageError(
            "source-changed",
            f"{what}: the server has no such range (status 416), expected a longer file; it "
            "became shorter: open it again",
        )
    encoding = headers.get("content-encoding", "identity").strip().lower()
    if encoding not in ("", "identity"):
        raise StorageError(
            "answer-encoding",
            f"{what}: Content-Encoding {encoding}, expected none; switch off compression of this "
            "file on the server or its proxy",
        )
    etag = headers.get("etag", "").strip()
    strong = etag if etag.startswith('"') else None
    length = _LENGTH.fullmatch(headers.get("content-length", "").strip())
    if status == 200:
        total = int(length[0]) if length else None
        return ResponseHead(0, -1 if total is None else total, total, strong, is_whole=True)
    return _partial(headers, first, end, what, strong, None if length is None else int(length[0]))


def _partial(
    headers: Mapping[str, str],
    first: int,
    end: int,
    what: str,
    etag: str | None,
    length: int | None,
) -> ResponseHead:
    """Check the headers of a response with status 206 (partial content)."""
    kind = headers.get("content-type", "").lower()
    if kind.startswith("multipart/"):
        raise StorageError(
            "answer-range", f"{what}: a response of type {kind}, expected a single range"
        )
    text = headers.get("content-range", "").strip()
    stated = _CONTENT_RANGE.fullmatch(text)
    if stated is None:
        raise StorageError(
            "answer-range",
            f"{what}: Content-Range {text!r} with status 206, expected bytes {first}-{end - 1}/…",
        )
    total = None if stated[3] == "*" else int(stated[3])
    found_first, found_end = int(stated[1]), int(stated[2]) + 1
    # A server may send less than the requested range; the rest takes another request.
    fits = found_first == first and first < found_end <= end
    if not fits or (total is not None and found_end > total):
        raise StorageError(
            "answer-range",
            f"{what}: Content-Range {text!r}, expected bytes {first}-{end - 1}/… or its beginning",
        )
    if length is not None and length != found_end - found_first:
        raise StorageError(
            "answer-range",
            f"{what}: Content-Length {length} with Content-Range {text!r}, expected "
            f"{found_end - found_first}",
        )
    return ResponseHead(found_first, found_end, total, etag, is_whole=False)


def _refusal(status: int, headers: Mapping[str, str], what: str) -> TransientError | StorageError:
    """Return the error for a failed request's HTTP status."""
    if status in TRANSIENT_STATUSES:
        wait = retry_after_seconds(headers.get("retry-after"), headers.get("date"))
        delay = f", retry after {wait:g} s" if wait else ""
        return TransientError("http-status", f"{what}: status {status}{delay}, expected 206", wait)
    if status in (404, 410):
        return StorageError(
            "not-found",
            f"{what}: the server has no such file (status {status}), expected it; check the URL",
        )
    if status in (401, 403):
        return StorageError(
            "permission",
            f"{what}: the server refuses access (status {status}), expected access; pass "
            "credentials, or a URL that is still signed",
        )
    if status == 412:
        return StorageError(
            "source-changed",
            f"{what}: the file changed while it was read (status 412), expected the same file; "
            "open it again",
        )
    return StorageError("http-status", f"{what}: status {status}, expected 206")
