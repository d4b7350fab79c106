"""Grouping of segments into objects of a folder, and reuse of existing objects (SPEC 3.4)."""

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

# Segment kinds that belong to one chunk.
_CHUNK_KINDS: Final = (
    SegmentKind.HEAD,
    SegmentKind.REFINEMENT,
    SegmentKind.TAIL,
    SegmentKind.OPACITIES,
    SegmentKind.ATTRIBUTES,
)


@dataclass(frozen=True)
class SegmentPlace:
    """Position of a segment within an object.

    Parameters
    ----------
    key : bytes
        First 16 bytes of the object's SHA-256.
    size : int
        Length of the object, bytes.
    offset : int
        Offset of the segment within the object, bytes.
    """

    key: bytes
    size: int
    offset: int


def group_segments(table: SegmentTable) -> list[list[int]]:
    """Group segments into objects: one per chunk, one for all codebooks.

    Every other segment is an object of its own. Decoding a chunk takes at most two objects.

    Parameters
    ----------
    table : SegmentTable
        Segments of the root and of all pages.

    Returns
    -------
    list of list of int
        Rows of each object's segments, in file order.
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
    """Segments in the existing objects of a folder, according to its manifests.

    Parameters
    ----------
    folder : Path
        Folder with manifests and objects.
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
        """Return the position of a segment, by its hash, in an undamaged object; None for none."""
        place = self._places.get(key)
        return place if place is not None and self._is_intact(place) else None

    def _add(self, manifest: Path) -> None:
        """Add the segments of a manifest; warn and skip a manifest that cannot be read."""
        try:
            source = FolderSource(manifest)
            try:
                tables = source.tables()
            finally:
                source.close()
        except CogsplatError as error:
            warnings.warn(
                f"{manifest}: cannot be read, so no object is shared with it: {error.message}",
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
        """Whether the object of a segment is undamaged; checked once per object."""
        name = place.key.hex()
        if name not in self._intact:
            self._intact[name] = has_object(self._folder, place.key, place.size)
        return self._intact[name]


def has_object(folder: Path, key: bytes, size: int) -> bool:
    """Whether a folder has an object with a hash and a length, undamaged.

    Parameters
    ----------
    folder : Path
        Folder of the manifest.
    key : bytes
        First 16 bytes of the object's SHA-256.
    size : int
        Length of the object, bytes.
    """
    path = folder / object_name(key)
    with storage_errors(path):
        try:
            status = path.lstat()
        except FileNotFoundError:
            return False
        if path.is_symlink() or not path.is_file() or status.st_size != size:
            return False
        return key_of(path.read_bytes()) == key
