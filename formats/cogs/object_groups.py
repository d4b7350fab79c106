"""Which segments share an object of a folder, and which are in one already (SPEC 3.4)."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cogsplat.codec.errors import CogsplatError, CogsplatWarning
from cogsplat.formats.storage.atomic import storage_errors

from .folder_map import MANIFEST_SUFFIX
from .folder_places import key_of, object_name
from .folder_source import FolderSource
from .layout import CODEBOOK_KINDS, SegmentKind
from .root import SegmentTable

# What decoding a chunk may take of its own.
_CHUNK_KINDS: Final = (
    SegmentKind.HEAD,
    SegmentKind.REFINEMENT,
    SegmentKind.TAIL,
    SegmentKind.OPACITIES,
    SegmentKind.ATTRIBUTES,
)


@dataclass(frozen=True)
class SegmentPlace:
    """Where a segment lies.

    Parameters
    ----------
    key : bytes
        Of the object: the first 16 bytes of the SHA-256 of its bytes.
    size : int
        Bytes of the object.
    offset : int
        First byte of the segment within it.
    """

    key: bytes
    size: int
    offset: int


def group_segments(table: SegmentTable) -> list[list[int]]:
    """Return the rows of the segments of each object, in the order of the file.

    The segments of a chunk are one object, and those of all codebooks another, so that a chunk
    takes two objects at most; every other segment is an object of its own.

    Parameters
    ----------
    table : SegmentTable
        Of the root and of all pages.

    Returns
    -------
    list of list of int
        Each row once.
    """
    groups: dict[object, list[int]] = {}
    books, chunks = set(CODEBOOK_KINDS), set(_CHUNK_KINDS)
    for row, (kind, owner) in enumerate(
        zip(table.kind.tolist(), table.owner.tolist(), strict=True)
    ):
        key: object = ("alone", row)
        if kind in books:
            key = "codebooks"
        elif kind in chunks:
            key = ("chunk", owner)
        groups.setdefault(key, []).append(row)
    return list(groups.values())


class StoredSegments:
    """Segments that the objects of a folder hold already, as the manifests there say.

    Parameters
    ----------
    folder : Path
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._places: dict[bytes, SegmentPlace] = {}
        self._intact: dict[str, bool] = {}
        with storage_errors(folder):
            manifests = sorted(folder.glob(f"*{MANIFEST_SUFFIX}"))
        for manifest in manifests:
            self._add(manifest)

    def place_of(self, key: bytes) -> SegmentPlace | None:
        """Return where a segment lies, by its hash, in an object that is whole."""
        place = self._places.get(key)
        return place if place is not None and self._is_intact(place) else None

    def _add(self, manifest: Path) -> None:
        try:
            source = FolderSource(manifest)
            try:
                tables = source.tables()
            finally:
                source.close()
        except CogsplatError as error:
            warnings.warn(
                f"{manifest}: cannot be read, so that nothing is shared with it: {error.message}",
                CogsplatWarning,
                stacklevel=4,
            )
            return
        for table, places in tables:
            for row in range(len(places)):
                place = SegmentPlace(
                    places.objects[row].tobytes(), int(places.sizes[row]), int(places.offsets[row])
                )
                self._places.setdefault(table.hash[row].tobytes(), place)

    def _is_intact(self, place: SegmentPlace) -> bool:
        name = place.key.hex()
        if name not in self._intact:
            self._intact[name] = has_object(self._folder, place.key, place.size)
        return self._intact[name]


def has_object(folder: Path, key: bytes, size: int) -> bool:
    """Whether a folder has the object of a key, of so many bytes, and it is not damaged."""
    path = folder / object_name(key)
    with storage_errors(path):
        try:
            status = path.lstat()
        except FileNotFoundError:
            return False
        if path.is_symlink() or not path.is_file() or status.st_size != size:
            return False
        return key_of(path.read_bytes()) == key
