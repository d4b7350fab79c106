"""Source over a folder of manifest and objects on disk (SPEC 3.4)."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterable
from contextlib import closing
from functools import cached_property
from pathlib import Path

from cogsplat.codec.errors import FormatError, TruncatedError
from cogsplat.formats.storage.atomic import StrPath, is_folder, open_for_read, storage_errors
from cogsplat.formats.storage.regular_files import open_regular
from cogsplat.formats.storage.source import FileSource, require_within

from . import layout
from .folder_map import MANIFEST_NAME, MAX_MANIFEST_BYTES, FolderMap, ObjectRange, is_manifest
from .folder_places import SEGMENT_FOLDER
from .object_source import ObjectSource


def manifest_path(path: StrPath) -> Path:
    """Return the path of a manifest from its own path or that of its folder."""
    given = Path(path)
    return given / MANIFEST_NAME if is_folder(given) else given


def names_folder(path: StrPath) -> bool:
    """Whether a path is a folder or a manifest.

    Raises
    ------
    StorageError
        ``not-found``, ``not-a-file``, ``permission`` or ``io``.
    """
    if is_folder(path):
        return True
    with open_for_read(path) as file, storage_errors(path):
        return is_manifest(file.read(layout.PREAMBLE_BYTES))


class FolderSource(ObjectSource):
    """Source over a folder on disk, with the bytes of the file that it stands for.

    Parameters
    ----------
    path : path
        Folder with a ``manifest.cogsm``, or the path of a manifest.

    Attributes
    ----------
    size : int
        Length of the file, bytes, missing segments included.

    Raises
    ------
    StorageError
        ``not-found``, ``not-a-file``, ``permission`` or ``io``.
    FormatError, TruncatedError, UnsupportedError
        The manifest breaks SPEC 3.4, or its root SPEC 4 and 5.

    Notes
    -----
    Safe to read from several threads. Each read opens its objects anew and follows no links.
    """

    def __init__(self, path: StrPath) -> None:
        manifest = manifest_path(path)
        self.name = str(path)
        self._folder = manifest.parent
        with closing(FileSource(manifest)) as file:
            head = file.read(0, min(MAX_MANIFEST_BYTES, file.size))
            super().__init__(FolderMap(head, file.name))
            self._map.check_manifest_size(file.size)

    @property
    def stored_bytes(self) -> int:
        """Total length of the manifest and all objects, bytes, capped at `size`."""
        return min(self.size, self._map.manifest_bytes + sum(self._objects.values()))

    def read(self, offset: int, length: int) -> bytes:
        """Return exactly `length` bytes from `offset` of the file.

        Raises
        ------
        TruncatedError
            ``file-truncated``: the range ends behind the file; ``segment-missing``: an object is
            missing.
        FormatError
            ``segment-object``: an object has another length, or is not a file; ``page-crc``,
            ``places-crc`` and the other codes of SPEC 3.4 and 5 for a page.
        StorageError
            ``permission`` or ``io``.
        """
        require_within(self, offset, length)
        parts = [self._bytes_of(piece) for piece in self._object_ranges(offset, length)]
        return parts[0] if len(parts) == 1 else b"".join(parts)

    def holds(self, offset: int, length: int) -> bool:
        """Whether all objects of a range exist; the folder is listed once, at the first call."""
        with self._lock:
            while pages := self._map.pages_for(offset, length):
                first = self._map.page_range(pages[0])
                if not self._has_objects([first]):
                    return False
                self._map.add_page(pages[0], self._object_bytes(first))
        return self._has_objects(self._object_ranges(offset, length))

    def close(self) -> None:
        """Do nothing: no file stays open between reads."""

    def _has_objects(self, pieces: Iterable[ObjectRange]) -> bool:
        """Whether the objects of some ranges exist."""
        return all(piece.data is not None or piece.name in self._objects for piece in pieces)

    @cached_property
    def _objects(self) -> dict[str, int]:
        """Length of each object in the folder at the first call, bytes; 0 for a link or folder."""
        folder = self._folder / SEGMENT_FOLDER
        if not is_folder(folder):
            return {}
        with storage_errors(folder), os.scandir(folder) as entries:
            return {
                f"{SEGMENT_FOLDER}/{entry.name}": entry.stat(follow_symlinks=False).st_size
                if entry.is_file(follow_symlinks=False)
                else 0
                for entry in entries
            }

    def _object_bytes(self, piece: ObjectRange) -> bytes:
        """Read a range of an object; refuse an object of another length than in the manifest."""
        path = self._folder / piece.name
        if path.parent.is_symlink():
            raise self._refused(piece, "is behind a link")
        with storage_errors(path):
            try:
                status = path.lstat()
            except (FileNotFoundError, NotADirectoryError):
                raise TruncatedError(
                    "segment-missing",
                    f"{self.name}: {piece.name} is missing, expected an object of "
                    f"{piece.object_bytes} bytes",
                    clause="3.4",
                ) from None
            # Checked before opening, because opening a pipe blocks until its other end is open.
            if not stat.S_ISREG(status.st_mode):
                raise self._refused(piece, "is a link, a folder or a device")
            if status.st_size != piece.object_bytes:
                raise self._refused(piece, f"has {status.st_size} bytes")
            with open_regular(path) as file:
                file.seek(piece.offset)
                data = file.read(piece.length)
        if len(data) != piece.length:
            raise self._refused(piece, "became shorter while it was read")
        return data

    def _refused(self, piece: ObjectRange, what: str) -> FormatError:
        """Return the error for an object with another type or length."""
        return FormatError(
            "segment-object",
            f"{self.name}: {piece.name} {what}, expected a file of {piece.object_bytes} bytes",
            clause="3.4",
        )
