"""Ranges of the objects of a folder on a network, all in one space of addresses (SPEC 3.4)."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import AsyncGenerator, AsyncIterator
from contextlib import asynccontextmanager, nullcontext
from typing import Final

from cogsplat.codec.errors import FormatError, StorageError, TruncatedError
from cogsplat.formats.network.backoff import TransientError
from cogsplat.formats.network.range_responses import RangeResponse, ResponseHead, SiblingTransport

from .folder_map import FolderMap, ObjectRange

# Objects, of at most 2^32 bytes, lie so far apart that no request joins ranges of two.
_SPACE_BITS: Final = 33

# Where addresses end: of as many objects as a file may have segments (SPEC 9.1), and the manifest.
_END: Final = ((1 << 20) + 1) << _SPACE_BITS

# What is kept of objects that a server without ranges has sent whole.
_KEPT_BYTES: Final = 32 << 20


def address_of(number: int, offset: int) -> int:
    """Return the address of a byte of an object by the number that the transport gave it."""
    return (number << _SPACE_BITS) + offset


class FolderTransport:
    """Asks for bytes of a manifest and of objects beside it by addresses; see `Transport`.

    The manifest has number 0, so that its bytes are addressed as they stand in it. A range is of
    one object.

    Parameters
    ----------
    manifest : SiblingTransport
    folder : FolderMap
    head : bytes
        What is there of the manifest already, from its first byte on.

    Attributes
    ----------
    requests, received_bytes : int
        As in `Traffic`, of all objects.
    """

    def __init__(self, manifest: SiblingTransport, folder: FolderMap, head: bytes) -> None:
        self._manifest = manifest
        self._map = folder
        self._head = head
        self._guard = threading.Lock()
        self._numbers: dict[str, int] = {"": 0}
        self._sizes = {0: folder.manifest_bytes}
        self._names = {0: ""}
        self._kept: dict[int, bytes] = {}
        self._has_ranges = True
        self._turns: dict[int, asyncio.Lock] = {}
        self.requests = self.received_bytes = 0

    def number_of(self, piece: ObjectRange) -> int:
        """Return the number of an object; the same for the same name."""
        with self._guard:
            number = self._numbers.setdefault(piece.name, len(self._numbers))
            self._sizes.setdefault(number, piece.object_bytes)
            self._names.setdefault(number, piece.name)
            return number

    @asynccontextmanager
    async def get(
        self, first: int, end: int, *, fresh: bool = False
    ) -> AsyncIterator[RangeResponse]:
        """Ask for a range of one object; see `Transport.get`.

        Raises
        ------
        TruncatedError
            ``segment-missing``: the object is not there; ``file-truncated``, of the manifest.
        FormatError
            ``segment-object``: it has another length than stated; ``file-trailing``, of the
            manifest.
        """
        number = first >> _SPACE_BITS
        base = number << _SPACE_BITS
        start, stop = first - base, min(end - base, self._sizes[number])
        stated = ResponseHead(first, base + stop, _END, None, is_whole=False)
        # From a server without ranges an object comes once, and the next range is of what is kept.
        turn = nullcontext() if self._has_ranges else self._turns.setdefault(number, asyncio.Lock())
        async with turn:
            kept = self._here(number, stop, fresh=fresh)
            if kept is not None:
                yield RangeResponse(stated, _of_memory(kept[start:stop]))
                return
            name = self._names[number]
            transport = self._manifest.sibling(name) if name else self._manifest
            self.requests += 1
            try:
                async with transport.get(start, stop, fresh=fresh) as answer:
                    size = answer.head.total
                    if size is not None:
                        self._check(number, size)
                    parts = self._parts(number, answer, start, stop)
                    if not answer.head.is_whole:
                        stop = answer.head.end
                        stated = ResponseHead(first, base + stop, _END, None, is_whole=False)
                    try:
                        yield RangeResponse(stated, parts)
                    finally:
                        await parts.aclose()
            except StorageError as error:
                if error.code != "not-found" or not name:
                    raise
                raise TruncatedError(
                    "segment-missing",
                    f"{self._map.name}: {name} is not there, expected an object of "
                    f"{self._sizes[number]} bytes",
                    clause="3.4",
                ) from error

    async def close(self) -> None:
        """Close the connections."""
        await self._manifest.close()

    def _here(self, number: int, stop: int, *, fresh: bool) -> bytes | None:
        """Return an object from its first byte on, where so much of it is here."""
        if number == 0 and stop <= len(self._head):
            return self._head
        return None if fresh else self._kept.get(number)

    async def _parts(
        self, number: int, answer: RangeResponse, start: int, stop: int
    ) -> AsyncGenerator[bytes, None]:
        """Yield the bytes from `start` to `stop` of an answer; what comes whole is kept first."""
        size, whole = self._sizes[number], answer.head.is_whole
        keep = whole and (number == 0 or size <= _KEPT_BYTES)
        self._has_ranges = self._has_ranges and not whole
        body: list[bytes] = []
        received, first = 0, 0 if whole else start
        async for part in answer.parts:
            received += len(part)
            self.received_bytes += len(part)
            if received > size:
                # However much more would come.
                self._check(number, received)
            if keep:
                body.append(part)
                continue
            end = first + received
            yield part[max(0, start - end + len(part)) : max(0, stop - end + len(part))]
        if not whole:
            return
        if answer.head.total is None:
            self._check(number, received)
        if received < size:
            raise TransientError(
                "connection-broken",
                f"{self._map.name}: {self._names[number] or 'the manifest'}: the answer ended "
                f"after {received} bytes, expected {size}",
            )
        if keep:
            self._keep(number, b"".join(body))
            yield self._kept[number][start:stop]

    def _keep(self, number: int, data: bytes) -> None:
        self._kept[number] = data
        # The manifest stays; of objects, those that came first go.
        others = [other for other in self._kept if other]
        while sum(len(self._kept[other]) for other in others) > _KEPT_BYTES:
            del self._kept[others.pop(0)]

    def _check(self, number: int, size: int) -> None:
        """Refuse an object of another length than stated."""
        if number == 0:
            self._map.check_manifest_size(size)
        elif size != self._sizes[number]:
            raise FormatError(
                "segment-object",
                f"{self._map.name}: {self._names[number]} has {size} bytes, expected "
                f"{self._sizes[number]}",
                clause="3.4",
            )


async def _of_memory(data: bytes) -> AsyncIterator[bytes]:
    yield data
