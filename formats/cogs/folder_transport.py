"""Transport for the objects of a folder on a network, in one address space (SPEC 3.4)."""

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

# Address bits per object. Objects have at most 2^32 bytes, so no request joins ranges of two.
_SPACE_BITS: Final = 33

# End of the address space: the manifest, and one object for each segment at most (SPEC 9.1).
_END: Final = ((1 << 20) + 1) << _SPACE_BITS

# Memory for whole objects from a server without range requests, bytes.
_KEPT_BYTES: Final = 32 << 20


def address_of(number: int, offset: int) -> int:
    """Return the address of an object's byte in the address space of `FolderTransport`.

    Parameters
    ----------
    number : int
        Number of the object; 0 for the manifest.
    offset : int
        Offset of the byte within the object.
    """
    return (number << _SPACE_BITS) + offset


class FolderTransport:
    """Transport for a manifest and its objects, which share one address space; see `Transport`.

    Each object begins at its number × 2³³. The manifest has number 0, so its addresses are its byte
    offsets. A range lies in one object.

    Parameters
    ----------
    manifest : SiblingTransport
        Transport for the manifest.
    folder : FolderMap
        Map of the folder.
    received : bytes
        Whole manifest, received before.

    Attributes
    ----------
    requests, received_bytes : int
        Requests and received bytes of all objects; see `Traffic`.
    """

    def __init__(self, manifest: SiblingTransport, folder: FolderMap, received: bytes) -> None:
        self._manifest = manifest
        self._map = folder
        self._received = received
        self._guard = threading.Lock()
        self._numbers: dict[str, int] = {"": 0}
        self._sizes = {0: folder.manifest_bytes}
        self._names = {0: ""}
        self._kept: dict[int, bytes] = {}
        self._has_ranges = True
        self._turns: dict[int, asyncio.Lock] = {}
        self.requests = self.received_bytes = 0

    def number_of(self, piece: ObjectRange) -> int:
        """Return the number of an object; a new name gets the next number."""
        with self._guard:
            number = self._numbers.setdefault(piece.name, len(self._numbers))
            self._sizes.setdefault(number, piece.object_bytes)
            self._names.setdefault(number, piece.name)
            return number

    @asynccontextmanager
    async def get(
        self, first: int, end: int, *, bypass_caches: bool = False
    ) -> AsyncIterator[RangeResponse]:
        """Request a range of one object by its address; see `Transport.get`.

        Raises
        ------
        TruncatedError
            ``segment-missing``: the object is missing; ``file-truncated``: the manifest is short.
        FormatError
            ``segment-object``: the object has another length; ``file-trailing``: the manifest is
            too long.
        """
        number = first >> _SPACE_BITS
        base = number << _SPACE_BITS
        start, stop = first - base, min(end - base, self._sizes[number])
        stated = ResponseHead(first, base + stop, _END, None, is_whole=False)
        # A server without range requests sends an object once; later ranges are read from memory.
        turn = nullcontext() if self._has_ranges else self._turns.setdefault(number, asyncio.Lock())
        async with turn:
            kept = self._here(number, stop, bypass_caches=bypass_caches)
            if kept is not None:
                yield RangeResponse(stated, _of_memory(kept[start:stop]))
                return
            name = self._names[number]
            transport = self._manifest.sibling(name) if name else self._manifest
            self.requests += 1
            try:
                async with transport.get(start, stop, bypass_caches=bypass_caches) as answer:
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
                    f"{self._map.name}: {name} is missing, expected an object of "
                    f"{self._sizes[number]} bytes",
                    clause="3.4",
                ) from error

    async def close(self) -> None:
        """Close the connections."""
        await self._manifest.close()

    def _here(self, number: int, stop: int, *, bypass_caches: bool) -> bytes | None:
        """Return the received bytes of an object if `stop` lies within; None otherwise."""
        if bypass_caches:
            return None
        is_manifest = number == 0 and stop <= len(self._received)
        return self._received if is_manifest else self._kept.get(number)

    async def _parts(
        self, number: int, answer: RangeResponse, start: int, stop: int
    ) -> AsyncGenerator[bytes, None]:
        """Yield the bytes from `start` to `stop` of an object, cut from a response.

        Also keep an object that the server sent whole, up to `_KEPT_BYTES`, for later ranges.
        """
        size, whole = self._sizes[number], answer.head.is_whole
        keep = whole and (number == 0 or size <= _KEPT_BYTES)
        self._has_ranges = self._has_ranges and not whole
        body: list[bytes] = []
        received, first = 0, 0 if whole else start
        async for part in answer.parts:
            received += len(part)
            self.received_bytes += len(part)
            if received > size:
                # Checked early, because the response may be endless.
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
                f"{self._map.name}: {self._names[number] or 'the manifest'}: the response ended "
                f"after {received} bytes, expected {size}",
            )
        if keep:
            self._keep(number, b"".join(body))
            yield self._kept[number][start:stop]

    def _keep(self, number: int, data: bytes) -> None:
        """Keep a whole object in memory; evict the oldest objects, but never the manifest."""
        self._kept[number] = data
        others = [other for other in self._kept if other]
        while sum(len(self._kept[other]) for other in others) > _KEPT_BYTES:
            del self._kept[others.pop(0)]

    def _check(self, number: int, size: int) -> None:
        """Refuse an object or manifest of an unexpected length."""
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
    """Yield bytes in memory as the only part of a response body."""
    yield data
