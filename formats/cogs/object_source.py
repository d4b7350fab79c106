"""Base class of the sources of folders, on disk or on a network (SPEC 3.4)."""

from __future__ import annotations

import threading
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import cached_property

from .folder_map import FolderMap, ObjectRange, PlacedSegments


class ObjectSource(ABC):
    """Base class of sources that read a folder as the file that it stands for.

    Parameters
    ----------
    folder_map : FolderMap
        Map of the folder; reads add pages to it as needed.
    """

    def __init__(self, folder_map: FolderMap) -> None:
        self._map = folder_map
        self._lock = threading.RLock()

    @property
    def size(self) -> int:
        """Length of the file that the folder stands for, bytes."""
        return self._map.file_length

    @property
    def first_request_bytes(self) -> int:
        """End of the root, byte offset: reads up to here need no object."""
        return self._map.root_end

    def placed_segments(self) -> list[PlacedSegments]:
        """Return the segments of the root and of each page that objects hold; raises as `read`."""
        self._object_ranges(0, self.size)
        return self._map.placed_segments()

    def page_objects(self) -> Mapping[str, int]:
        """Return the offset in the file of the first page in each object of pages, by name."""
        return self._map.page_objects()

    def objects(self) -> Mapping[str, int]:
        """Return the length of each object of the folder, bytes, by name; raises as `read`."""
        return self._named

    def read_object(self, name: str) -> bytes:
        """Return the bytes of an object, given its key in `objects`; raises as `read`."""
        size = self._named[name]
        return self._object_bytes(ObjectRange(name, 0, size, size))

    @cached_property
    def _named(self) -> dict[str, int]:
        """Lengths of all objects by name, bytes."""
        self._object_ranges(0, self.size)
        return self._map.objects()

    def _object_ranges(self, offset: int, length: int) -> list[ObjectRange]:
        """Return the ranges of objects that make up a range of the file.

        First reads those pages of the range that are not yet in the map.
        """
        with self._lock:
            while pages := self._map.pages_for(offset, length):
                ranges = [self._map.page_range(page) for page in pages]
                with self._prefetched(ranges):
                    for page, stored in zip(pages, ranges, strict=True):
                        self._map.add_page(page, self._object_bytes(stored))
            return self._map.object_ranges(offset, length)

    def _prefetched(self, pieces: Sequence[ObjectRange]) -> AbstractContextManager[object]:
        """Return a context in which some ranges of objects are requested together."""
        del pieces
        return nullcontext()

    def _bytes_of(self, piece: ObjectRange) -> bytes:
        """Return the bytes of a range, from the map or from its object."""
        return self._object_bytes(piece) if piece.data is None else piece.data

    @abstractmethod
    def _object_bytes(self, piece: ObjectRange) -> bytes:
        """Read the bytes of a range of an object."""
