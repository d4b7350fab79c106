"""What sources of folders have in common, wherever their manifest and objects are (SPEC 3.4)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from functools import cached_property

from .folder_map import FolderMap, ObjectRange
from .folder_places import Places
from .root import SegmentTable


class ObjectSource(ABC):
    """A source that reads a folder: what it has beside the bytes of the file.

    Parameters
    ----------
    folder_map : FolderMap
        Pages are added to it as ranges are asked for that need them.
    """

    def __init__(self, folder_map: FolderMap) -> None:
        self._map = folder_map

    @property
    def size(self) -> int:
        """Bytes of the file that the folder stands for."""
        return self._map.file_length

    @property
    def first_request_bytes(self) -> int:
        """Bytes of preamble and root, which no segment is needed for."""
        return self._map.root_end

    def tables(self) -> list[tuple[SegmentTable, Places]]:
        """Return segments and their places, of the root and of each page; raises as `read`."""
        self._object_ranges(0, self.size)
        return self._map.tables()

    def objects(self) -> Mapping[str, int]:
        """Return the bytes of all objects that the manifest names; raises as `read`."""
        return self._named

    def read_object(self, name: str) -> bytes:
        """Return the bytes of an object, as `objects` names it; raises as `read`."""
        size = self._named[name]
        return self._object_bytes(ObjectRange(name, 0, size, size))

    @cached_property
    def _named(self) -> dict[str, int]:
        self._object_ranges(0, self.size)
        return self._map.objects()

    @abstractmethod
    def _object_ranges(self, offset: int, length: int) -> list[ObjectRange]:
        """Return where bytes of the file lie; pages that say so are read."""

    @abstractmethod
    def _object_bytes(self, piece: ObjectRange) -> bytes:
        """Return bytes of an object."""
