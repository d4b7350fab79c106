"""A folder of a manifest and objects on a network, read as the file it stands for (SPEC 3.4)."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from typing import Final

from cogsplat.formats.network.network_options import NetworkOptions
from cogsplat.formats.network.open_url import transport_of
from cogsplat.formats.network.range_source import RangeSource
from cogsplat.formats.network.traffic import Traffic
from cogsplat.formats.network.urls import redacted
from cogsplat.formats.storage.source import Cancel, require_within

from . import layout
from .folder_map import FolderMap, ObjectRange
from .folder_transport import FolderTransport, address_of
from .object_source import ObjectSource

# Bytes of so many index pages are kept.
_PAGES_KEPT: Final = 8


class NetworkFolder(ObjectSource):
    """A folder on a network as a `Source`, whose bytes are those of the file that it stands for.

    Parameters
    ----------
    url : str
        Of the manifest.
    head : bytes
        First bytes of the manifest, its root and the places of the root's segments among them; all
        of a small one.
    options : NetworkOptions, optional
    fresh : bool
        Go around caches.
    manifest_bytes : int, optional
        Bytes that the server states of the manifest.

    Attributes
    ----------
    name : str
        Names the folder in messages.
    cache : SegmentCache or None
        Segments on disk, where the options name a folder for them.

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
    Safe to read from several threads. Of an object, what lies close together is asked for with one
    request; a server without ranges sends all of it, which is kept. A request is of one object, so
    that one that is missing or damaged spoils no other.
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
        self.name = redacted(url)
        super().__init__(FolderMap(head, self.name))
        if manifest_bytes is not None:
            self._map.check_manifest_size(manifest_bytes)
        self._head = head[: self._map.manifest_bytes]
        self._objects = FolderTransport(transport_of(url, options), self._map, self._head)
        self._ranges = RangeSource(
            self._objects, self.name, options, fresh=fresh, beginning_bytes=len(self._head)
        )
        self.cache = self._ranges.cache
        self._lock = threading.Lock()
        self._pages: dict[int, bytes] = {}

    def __enter__(self) -> NetworkFolder:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    @property
    def traffic(self) -> Traffic:
        """What was asked for and what came, object by object; the request for `head` counted."""
        found, objects = self._ranges.traffic, self._objects
        return replace(
            found,
            requests=1 + objects.requests,
            received_bytes=len(self._head) + objects.received_bytes,
        )

    def read(self, offset: int, length: int) -> bytes:
        """Return exactly `length` bytes from `offset` of the file; see `Source.read`.

        Raises
        ------
        TruncatedError
            ``file-truncated``: the file ends before; ``segment-missing``: an object is not there.
        FormatError
            ``segment-object``; ``page-crc``, ``places-crc`` and what else breaks SPEC 3.4 and 5 in
            a page.
        StorageError
            As `RangeSource.read`.
        """
        pieces = self._object_ranges(offset, length)
        ahead = (
            self._ranges.prefetch([self._range_of(x) for x in pieces if not self._is_here(x)])
            if len(pieces) > 1
            else nullcontext()
        )
        with ahead:
            parts = [self._bytes_of(piece) for piece in pieces]
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def arrived(self, offset: int, length: int) -> bool:
        """Whether bytes that are fetched ahead are here."""
        return all(
            self._is_here(piece) or self._ranges.arrived(*self._range_of(piece))
            for piece in self._object_ranges(offset, length)
        )

    def reread(self, offset: int, length: int) -> bytes:
        """Return bytes of segments that came damaged, asked for once more around caches.

        Raises as `read`, and ValueError where there are other bytes among them.
        """
        pieces = self._object_ranges(offset, length)
        if not all(piece.name for piece in pieces):
            raise ValueError(f"{length} bytes from byte {offset}, expected those of segments")
        return b"".join(self._ranges.reread(*self._range_of(piece)) for piece in pieces)

    def prefetch(
        self, ranges: Sequence[tuple[int, int]], *, any_order: bool = False
    ) -> AbstractContextManager[Cancel]:
        """Fetch ranges ahead of reading them, as long as the block lasts; see `RemoteSource`.

        In any order, what lies in one object is asked for together.
        """
        pieces = [
            piece
            for offset, length in ranges
            if offset + length <= self.size
            for piece in self._object_ranges(offset, length)
            if not self._is_here(piece)
        ]
        if any_order:
            turn: dict[str, int] = {}
            for piece in pieces:
                turn.setdefault(piece.name, len(turn))
            pieces.sort(key=lambda piece: (turn[piece.name], piece.offset))
        return self._ranges.prefetch([self._range_of(piece) for piece in pieces])

    def close(self) -> None:
        """End all requests; reading is over."""
        self._ranges.close()

    def _object_ranges(self, offset: int, length: int) -> list[ObjectRange]:
        require_within(self, offset, length)
        with self._lock:
            pages = self._map.pages_for(offset, length)
            if pages:
                with self._ranges.prefetch([(page.offset, page.length) for page in pages]):
                    for page in pages:
                        self._page(page.page)
            return self._map.object_ranges(offset, length)

    def _is_here(self, piece: ObjectRange) -> bool:
        """Whether bytes of the manifest came with its first, or with a page."""
        if piece.name:
            return False
        page = self._map.page_at(piece.offset)
        return piece.offset + piece.length <= len(self._head) or page in self._pages

    def _bytes_of(self, piece: ObjectRange) -> bytes:
        if piece.name:
            return self._object_bytes(piece)
        page = self._map.page_at(piece.offset)
        if page is None:
            # The file's own preamble stands in the place of the manifest's.
            data = self._map.preamble + self._head[layout.PREAMBLE_BYTES :]
            return data[piece.offset : piece.offset + piece.length]
        with self._lock:
            start = piece.offset - self._map.page_range(page).offset
            return self._page(page)[start : start + piece.length]

    def _object_bytes(self, piece: ObjectRange) -> bytes:
        return self._ranges.read(*self._range_of(piece))

    def _page(self, page: int) -> bytes:
        """Return a page and its places; those of the last pages are kept, and all are known."""
        data = self._pages.get(page)
        if data is None:
            place = self._map.page_range(page)
            data = self._ranges.read(place.offset, place.length)
            if not self._map.knows(page):
                self._map.add_page(page, data)
            self._pages[page] = data
            while len(self._pages) > _PAGES_KEPT:
                del self._pages[next(iter(self._pages))]
        return data

    def _range_of(self, piece: ObjectRange) -> tuple[int, int]:
        """Return the address and length by which a piece is asked for; of a page, all."""
        page = None if piece.name else self._map.page_at(piece.offset)
        if page is not None:
            place = self._map.page_range(page)
            return place.offset, place.length
        return address_of(self._objects.number_of(piece), piece.offset), piece.length
