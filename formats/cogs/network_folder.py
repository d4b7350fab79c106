"""A folder of a manifest and segments on a network, read as the file it stands for (SPEC 3.4)."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncGenerator, AsyncIterator, Sequence
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Final

from cogsplat.codec.errors import FormatError, StorageError, TruncatedError
from cogsplat.formats.network.answers import Answer, Stated
from cogsplat.formats.network.faults import Backoff, PassingFault
from cogsplat.formats.network.http_transport import HttpTransport
from cogsplat.formats.network.options import NetworkOptions
from cogsplat.formats.network.range_source import RangeSource
from cogsplat.formats.network.traffic import Traffic
from cogsplat.formats.network.urls import shown

from . import layout
from .folder_map import FolderMap, Piece

# Objects of one request that are asked for before the first of them is there.
_AHEAD: Final = 6

# Bytes of so many index pages are kept.
_PAGES_KEPT: Final = 8


class NetworkFolder(RangeSource):
    """A folder on a network as a `Source`, whose bytes are those of the file that it stands for.

    Parameters
    ----------
    url : str
        Of the manifest.
    head : bytes
        First bytes of the manifest, its root among them; all of a small one.
    options : NetworkOptions, optional
    fresh : bool
        Go around caches.
    manifest_bytes : int, optional
        Bytes that the server states of the manifest.

    Raises
    ------
    StorageError
        As `RangeSource`.
    FormatError, TruncatedError, UnsupportedError
        The manifest breaks SPEC 3.4, or its root SPEC 4 and 5. An object that is not there is
        refused when it is read (``segment-missing``), one of another length likewise
        (``segment-object``).

    Notes
    -----
    Objects are asked for whole, each by a request of its own, so that no ranges are needed and one
    that is missing or damaged spoils no other.
    """

    def __init__(
        self,
        url: str,
        head: bytes,
        options: NetworkOptions | None = None,
        *,
        fresh: bool = False,
        manifest_bytes: int | None = None,
    ) -> None:
        options = options or NetworkOptions()
        name = shown(url)
        folder = FolderMap(head, name)
        self._root_end = folder.root_end
        if manifest_bytes is not None:
            folder.check_manifest_size(manifest_bytes)
        # A request of one byte at most: no two segments are asked for together.
        single = replace(options, gap_bytes=0, request_bytes=1)
        transport = FolderTransport(HttpTransport(url, options), folder, head, name, options)
        self._objects = transport
        self._head_bytes = len(head)
        # No more than the root, which is there: segments are objects of their own.
        super().__init__(transport, name, single, fresh=fresh, beginning_bytes=self._root_end)

    @property
    def traffic(self) -> Traffic:
        """What was asked for and what came, object by object; the request for `head` counted."""
        objects = self._objects
        return replace(
            super().traffic,
            requests=1 + objects.requests,
            received_bytes=self._head_bytes + objects.received_bytes,
            failures=objects.failures,
        )

    @property
    def opening_bytes(self) -> int:
        """Bytes of preamble and root, which no segment is needed for."""
        return self._root_end


class FolderTransport:
    """Asks for ranges of a file by the objects of its folder; see `answers.Transport`.

    Parameters
    ----------
    manifest : HttpTransport
    folder : FolderMap
    head : bytes
        What is there of the manifest already, from its first byte on.
    name : str
        Names the folder in messages.
    options : NetworkOptions

    Attributes
    ----------
    requests, received_bytes, failures : int
        As in `Traffic`, of all objects.
    """

    def __init__(
        self,
        manifest: HttpTransport,
        folder: FolderMap,
        head: bytes,
        name: str,
        options: NetworkOptions,
    ) -> None:
        self._options = options
        self._manifest = manifest
        self._map = folder
        self._head = folder.preamble + head[layout.PREAMBLE_BYTES :]
        self._name = name
        self.requests = self.received_bytes = self.failures = 0
        # The last pages that were read, by their place in the manifest.
        self._pages: dict[tuple[int, int], bytes] = {}

    @asynccontextmanager
    async def get(self, first: int, end: int, *, fresh: bool = False) -> AsyncIterator[Answer]:
        """Ask for a range; see `answers.Transport.get`."""
        end = min(end, self._map.file_length)
        for page in self._map.pages_for(first, end - first):
            self._map.add_page(page.page, await self._of_index(page.offset, page.length, fresh))
        stated = Stated(first, end, self._map.file_length, None, is_whole=False)
        parts = self._parts(self._map.pieces(first, end - first), fresh)
        try:
            yield Answer(stated, parts)
        finally:
            await parts.aclose()

    async def close(self) -> None:
        """Close the connections."""
        await self._manifest.close()

    async def _parts(self, pieces: Sequence[Piece], fresh: bool) -> AsyncGenerator[bytes, None]:
        """Yield the bytes of pieces in their order, the next ones asked for meanwhile."""
        waiting = deque(pieces)
        under_way: deque[asyncio.Task[bytes]] = deque()
        try:
            while waiting or under_way:
                while waiting and len(under_way) < _AHEAD:
                    under_way.append(asyncio.create_task(self._bytes_of(waiting.popleft(), fresh)))
                yield await under_way[0]
                under_way.popleft()
        finally:
            for task in under_way:
                task.cancel()
            await asyncio.gather(*under_way, return_exceptions=True)

    async def _bytes_of(self, piece: Piece, fresh: bool) -> bytes:
        if not piece.name:
            return await self._of_index(piece.offset, piece.length, fresh)
        try:
            return await self._of_object(piece, fresh)
        except StorageError as error:
            if error.code != "not-found":
                raise
            raise TruncatedError(
                "segment-missing",
                f"{self._name}: {piece.name} is not there, expected a segment of "
                f"{piece.object_bytes} bytes",
                clause="3.4",
            ) from error

    async def _of_object(self, piece: Piece, fresh: bool) -> bytes:
        """Return bytes of an object, asked for again where an answer breaks off."""
        transport = self._manifest.beside(piece.name)
        backoff = Backoff(self._options)
        data = bytearray()
        while len(data) < piece.length:
            before = len(data)
            try:
                await self._take(transport, piece, data, fresh)
            except PassingFault as fault:
                self.failures += 1
                if len(data) > before:
                    backoff.progressed()
                await asyncio.sleep(backoff.pause_after(fault))
        return bytes(data[: piece.length])

    async def _take(
        self, transport: HttpTransport, piece: Piece, data: bytearray, fresh: bool
    ) -> None:
        """Add to the bytes of a piece what one answer brings of those that are missing."""
        start, end = piece.offset + len(data), piece.offset + piece.length
        self.requests += 1
        async with transport.get(start, end, fresh=fresh) as answer:
            stated = answer.stated
            if stated.total is not None and stated.total != piece.object_bytes:
                raise self._another_length(piece, stated.total)
            # A server without ranges sends all of it.
            skip = start if stated.is_whole else 0
            received = 0
            async for part in answer.parts:
                received += len(part)
                self.received_bytes += len(part)
                data += part[skip:]
                skip = max(0, skip - len(part))
                if received > piece.object_bytes:
                    # However much more would come.
                    raise self._another_length(piece, received)
        if stated.is_whole and stated.total is None and received != piece.object_bytes:
            raise self._another_length(piece, received)
        if piece.offset + len(data) < min(end, stated.end):
            raise PassingFault(
                "connection-broken",
                f"{self._name}: {piece.name}: the answer ended at byte "
                f"{piece.offset + len(data)}, expected {end}",
            )

    def _another_length(self, piece: Piece, size: int) -> FormatError:
        return FormatError(
            "segment-object",
            f"{self._name}: {piece.name} has {size} bytes, expected {piece.object_bytes}",
            clause="3.4",
        )

    async def _of_index(self, offset: int, length: int, fresh: bool) -> bytes:
        """Return bytes of the root or of a page; those of the last pages are kept.

        A page is read as a part of the file and, to name segments, by the map.
        """
        place = offset, length
        data = None if fresh else self._pages.get(place)
        if data is None:
            data = await self._of_manifest(offset, length, fresh)
            if offset + length > len(self._head):
                self._pages[place] = data
            while len(self._pages) > _PAGES_KEPT:
                del self._pages[next(iter(self._pages))]
        return data

    async def _of_manifest(self, offset: int, length: int, fresh: bool) -> bytes:
        end = offset + length
        if end > len(self._head):
            self.requests += 1
            async with self._manifest.get(offset, end, fresh=fresh) as answer:
                stated = answer.stated
                if stated.total is not None:
                    self._map.check_manifest_size(stated.total)
                data = b""
                async for part in answer.parts:
                    data += part
                    self.received_bytes += len(part)
                    if len(data) > self._map.manifest_bytes:
                        break
            if len(data) < (stated.end if stated.is_whole else length):
                raise PassingFault(
                    "connection-broken",
                    f"{self._name}: the answer ended after {len(data)} bytes, expected {length}",
                )
            if not stated.is_whole:
                return data[:length]
            # The server sends no ranges: all of the manifest is kept.
            self._map.check_manifest_size(len(data))
            self._head = self._map.preamble + data[layout.PREAMBLE_BYTES :]
        return self._head[offset:end]
