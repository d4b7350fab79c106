"""Source over a folder of manifest and objects on a network (SPEC 3.4)."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace

from cogsplat.formats.network.network_options import NetworkOptions
from cogsplat.formats.network.open_url import transport_of
from cogsplat.formats.network.range_source import RangeSource
from cogsplat.formats.network.traffic import Traffic
from cogsplat.formats.network.urls import redacted
from cogsplat.formats.storage.source import Cancel, require_within

from .folder_map import FolderMap, ObjectRange
from .folder_transport import FolderTransport, address_of
from .object_source import ObjectSource


class NetworkFolder(ObjectSource):
    """Source over a folder on a network, with the bytes of the file that it stands for.

    Parameters
    ----------
    url : str
        URL of the manifest.
    manifest : bytes
        Whole manifest.
    options : NetworkOptions, optional
        Timeouts, retries, request sizes and cache.
    bypass_caches : bool
        Whether to bypass HTTP caches.
    manifest_bytes : int, optional
        Length of the manifest according to the server, bytes.

    Attributes
    ----------
    name : str
        Name of the folder in messages.
    cache : SegmentCache or None
        Disk cache of segments, if the options name a folder for it.

    Raises
    ------
    StorageError
        The errors of `RangeSource`.
    FormatError, TruncatedError, UnsupportedError
        The manifest breaks SPEC 3.4, or its root SPEC 4 and 5. Missing objects
        (``segment-missing``) and objects of another length (``segment-object``) are refused on
        reading.

    Notes
    -----
    Safe to read from several threads. Close ranges of one object share a request. A request covers
    one object, so a missing or damaged object affects no other. From a server without range
    requests, whole objects are received and kept in memory.
    """

    def __init__(
        self,
        url: str,
        manifest: bytes,
        options: NetworkOptions | None = None,
        *,
        bypass_caches: bool = False,
        manifest_bytes: int | None = None,
    ) -> None:
        options = options or NetworkOptions()
        self.name = redacted(url)
        super().__init__(FolderMap(manifest, self.name))
        self._map.check_manifest_size(len(manifest) if manifest_bytes is None else manifest_bytes)
        self._manifest_bytes = len(manifest)
        self._objects = FolderTransport(transport_of(url, options), self._map, manifest)
        self._ranges = RangeSource(
            self._objects,
            self.name,
            options,
            bypass_caches=bypass_caches,
            beginning_bytes=len(manifest),
        )
        self.cache = self._ranges.cache

    def __enter__(self) -> NetworkFolder:
        return self

    def __exit__(self, *exc_info: object) -> None:
        self.close()

    @property
    def traffic(self) -> Traffic:
        """Requests and received bytes of all objects, including the manifest."""
        found, objects = self._ranges.traffic, self._objects
        return replace(
            found,
            requests=1 + objects.requests,
            received_bytes=self._manifest_bytes + objects.received_bytes,
        )

    def read(self, offset: int, length: int) -> bytes:
        """Return exactly `length` bytes from `offset` of the file; see `Source.read`.

        Raises
        ------
        TruncatedError
            ``file-truncated``: the range ends behind the file; ``segment-missing``: an object is
            missing.
        FormatError
            ``segment-object``; ``page-crc``, ``places-crc`` and the other codes of SPEC 3.4 and 5
            for a page.
        StorageError
            The errors of `RangeSource.read`.
        """
        pieces = self._object_ranges(offset, length)
        ahead = (
            self._ranges.prefetch([self._range_of(x) for x in pieces if x.data is None])
            if len(pieces) > 1
            else nullcontext()
        )
        with ahead:
            parts = [self._bytes_of(piece) for piece in pieces]
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def arrived(self, offset: int, length: int) -> bool:
        """Whether a prefetched range was received."""
        return all(
            piece.data is not None or self._ranges.arrived(*self._range_of(piece))
            for piece in self._object_ranges(offset, length)
        )

    def reread(self, offset: int, length: int) -> bytes:
        """Request damaged bytes of segments again, bypassing HTTP caches; raises as `read`."""
        pieces = self._object_ranges(offset, length)
        return b"".join(self._ranges.reread(*self._range_of(piece)) for piece in pieces)

    def prefetch(
        self, ranges: Sequence[tuple[int, int]], *, any_order: bool = False
    ) -> AbstractContextManager[Cancel]:
        """Prefetch ranges until the block ends; see `RemoteSource.prefetch`.

        With `any_order`, ranges of one object are requested together.
        """
        pieces = [
            piece
            for offset, length in ranges
            if offset + length <= self.size
            for piece in self._object_ranges(offset, length)
            if piece.data is None
        ]
        if any_order:
            turn: dict[str, int] = {}
            for piece in pieces:
                turn.setdefault(piece.name, len(turn))
            pieces.sort(key=lambda piece: (turn[piece.name], piece.offset))
        return self._ranges.prefetch([self._range_of(piece) for piece in pieces])

    def close(self) -> None:
        """Cancel all requests; later reads fail."""
        self._ranges.close()

    def _object_ranges(self, offset: int, length: int) -> list[ObjectRange]:
        """Return the ranges of objects that make up a range of the file."""
        require_within(self, offset, length)
        return super()._object_ranges(offset, length)

    def _prefetched(self, pieces: Sequence[ObjectRange]) -> AbstractContextManager[object]:
        """Return a context in which some ranges of objects are requested together."""
        return self._ranges.prefetch([self._range_of(piece) for piece in pieces])

    def _object_bytes(self, piece: ObjectRange) -> bytes:
        """Read a range of an object."""
        return self._ranges.read(*self._range_of(piece))

    def _range_of(self, piece: ObjectRange) -> tuple[int, int]:
        """Return the address (see `address_of`) and length to request for a range."""
        return address_of(self._objects.number_of(piece), piece.offset), piece.length
