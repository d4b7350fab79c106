"""Answers to range requests: what is checked of status and headers before a byte is taken."""

from __future__ import annotations

import re
from collections.abc import AsyncIterator, Mapping
from contextlib import AbstractAsyncContextManager
from dataclasses import dataclass
from typing import Final, Protocol

from cogsplat.codec.errors import StorageError

from .faults import PASSING_STATUSES, PassingFault, wait_asked_for

_CONTENT_RANGE: Final = re.compile(r"bytes (\d{1,19})-(\d{1,19})/(\d{1,19}|\*)", re.ASCII)
_UNSATISFIED: Final = re.compile(r"bytes \*/(\d{1,19})", re.ASCII)
_LENGTH: Final = re.compile(r"\d{1,19}", re.ASCII)


@dataclass(frozen=True)
class Stated:
    """What the headers of an answer state about its bytes.

    Parameters
    ----------
    first, end : int
        First byte of the body in the file, and the end behind its last; `end` is -1 where a whole
        file comes whose length is not stated.
    total : int or None
        Length of the file, bytes, where it is stated.
    etag : str or None
        A strong one; weak ones say nothing about bytes.
    is_whole : bool
        Whether the whole file comes, whatever was asked for.
    """

    first: int
    end: int
    total: int | None
    etag: str | None
    is_whole: bool


@dataclass(frozen=True)
class Answer:
    """An answer that was accepted, and its bytes as they come."""

    stated: Stated
    parts: AsyncIterator[bytes]


class Transport(Protocol):
    """How ranges of one file are asked for; used in one event loop."""

    def get(
        self, first: int, end: int, *, fresh: bool = False
    ) -> AbstractAsyncContextManager[Answer]:
        """Ask for bytes from `first` up to `end`; fewer come where the file ends in between.

        Parameters
        ----------
        first, end : int
        fresh : bool
            Go around caches.

        Raises
        ------
        PassingFault
            The request failed and is worth making again.
        StorageError
            It failed for good.
        """

    async def close(self) -> None:
        """Close all connections."""


class NeighbouringTransport(Transport, Protocol):
    """A transport that reaches the files beside its own, over the same connections."""

    def beside(self, name: str) -> Transport:
        """Return a transport of a file that is named relative to this one."""


def stated_by(status: int, headers: Mapping[str, str], first: int, end: int, where: str) -> Stated:
    """Check the status and headers of an answer to a range request.

    Parameters
    ----------
    status : int
    headers : mapping
        Names in lower case.
    first, end : int
        The bytes that were asked for.
    where : str
        Names the file in messages.

    Raises
    ------
    PassingFault
        ``http-status``: the server may answer later.
    StorageError
        ``not-found``, ``permission``, ``http-status``, ``answer-range``, ``answer-encoding``;
        ``source-changed`` where the file ends before the range.
    """
    what = f"{where}: bytes {first} to {end - 1}"
    if status not in (200, 206, 416):
        raise _refusal(status, headers, what)
    if status == 416:
        told = _UNSATISFIED.fullmatch(headers.get("content-range", "").strip())
        if first == 0 and told is not None and int(told[1]) == 0:
            return Stated(0, 0, 0, None, is_whole=False)
        raise StorageError(
            "source-changed", f"{what}: the server says that the file ends before (status 416)"
        )
    encoding = headers.get("content-encoding", "identity").strip().lower()
    if encoding not in ("", "identity"):
        raise StorageError(
            "answer-encoding",
            f"{what}: an answer with Content-Encoding {encoding}, expected the bytes as they are; "
            "the server or something before it compresses this file and must not",
        )
    etag = headers.get("etag", "").strip()
    strong = etag if etag.startswith('"') else None
    length = _LENGTH.fullmatch(headers.get("content-length", "").strip())
    if status == 200:
        total = int(length[0]) if length else None
        return Stated(0, -1 if total is None else total, total, strong, is_whole=True)
    return _partial(headers, first, end, what, strong, None if length is None else int(length[0]))


def _partial(
    headers: Mapping[str, str],
    first: int,
    end: int,
    what: str,
    etag: str | None,
    length: int | None,
) -> Stated:
    """Check the headers of a 206."""
    kind = headers.get("content-type", "").lower()
    if kind.startswith("multipart/"):
        raise StorageError(
            "answer-range", f"{what}: an answer of type {kind}, expected the one range alone"
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
    # A server may send less than was asked for; the rest is asked for again.
    fits = found_first == first and first < found_end <= end
    if not fits or (total is not None and found_end > total):
        raise StorageError(
            "answer-range",
            f"{what}: an answer of {text!r}, expected bytes {first}-{end - 1}/… or its beginning",
        )
    if length is not None and length != found_end - found_first:
        raise StorageError(
            "answer-range", f"{what}: an answer of {length} bytes and of Content-Range {text!r}"
        )
    return Stated(found_first, found_end, total, etag, is_whole=False)


def _refusal(status: int, headers: Mapping[str, str], what: str) -> PassingFault | StorageError:
    if status in PASSING_STATUSES:
        wait = wait_asked_for(headers.get("retry-after"), headers.get("date"))
        asked = f", asked to wait {wait:g} s" if wait else ""
        return PassingFault("http-status", f"{what}: status {status}{asked}", wait)
    if status in (404, 410):
        return StorageError("not-found", f"{what}: the server has no such file (status {status})")
    if status in (401, 403):
        return StorageError("permission", f"{what}: the server refuses access (status {status})")
    if status == 412:
        return StorageError(
            "source-changed", f"{what}: the server says that the file is another one (status 412)"
        )
    return StorageError("http-status", f"{what}: status {status}, expected 206")
