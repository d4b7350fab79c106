"""Base class of the sources of folders, on disk or on a network (SPEC 3.4)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cached_property

from .folder_map import FolderMap, ObjectRange
from .folder_places import PlaceTable
from .root import SegmentTable


class ObjectSource(ABC):
    """Base class of sources that read a folder as the file that it stands for.

    Parameters
    ----------
    folder_map : FolderMap
        Map of the folder; reads add index pages to it as needed.
    """

    def __init__(self, folder_map: FolderMap) -> None:
        self._map = folder_map

    @property
    def size(self) -> int:
        """Length of the file that the folder stands for, bytes."""
        return self._map.file_length

    @property
    def first_request_bytes(self) -> int:
        """End of the root, byte offset: reads up to here need no object."""
        return self._map.root_end

    def tables(self) -> list[tuple[SegmentTable, PlaceTable]]:
        """Return the segment table and the table of places of the root and of each page.

        Raises as `read`.
        """
        self._object_ranges(0, self.size)
        return self._map.tables()

    def objects(self) -> Mapping[str, int]:
        """Return the length of each object of the manifest, bytes, by name; raises as `read`."""
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

    @abstractmethod
    def _object_ranges(self, offset: int, length: int) -> list[ObjectRange]:
        """Return the ranges of objects that make up a range of the file.

        First reads those index pages of the range that are not yet in the map.
        """

    @abstractmethod
    def _object_bytes(self, piece: ObjectRange) -> bytes:
        """Return the bytes of a range of an object."""
