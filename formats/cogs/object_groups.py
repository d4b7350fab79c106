"""Grouping of segments into objects of a folder, and reuse of existing objects (SPEC 3.4)."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from cogsplat.codec.errors import CogsplatError, CogsplatWarning
from cogsplat.formats.storage.atomic import storage_errors

from .folder_map import MANIFEST_SUFFIX
from .folder_places import key_of, object_name
from .folder_source import FolderSource
from .index_tables import HASH_BYTES, SegmentTable
from .layout import CODEBOOK_KINDS
from .segment_rows import CHUNK_KINDS


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


IN_MANIFEST: Final = SegmentPlace(bytes(HASH_BYTES), 0, 0)
"""Place of a segment in the manifest itself (SPEC 3.4)."""


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
    books, chunks = set(CODEBOOK_KINDS), set(CHUNK_KINDS)
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
        # Places of each segment by its hash, then by the object's key.
        self._places: dict[bytes, dict[bytes, SegmentPlace]] = {}
        self._intact: dict[str, bool] = {}
        with storage_errors(folder):
            manifests = sorted(folder.glob(f"*{MANIFEST_SUFFIX}"))
        for manifest in manifests:
            self._add(manifest)

    def places_of(self, keys: Sequence[bytes]) -> list[SegmentPlace | None]:
        """Return the position of each segment of a group in undamaged objects; None for none.

        Where objects have equal segments, the object with the most of the group is chosen. So a
        folder that is written again keeps its places, and its pages their bytes.

        Parameters
        ----------
        keys : sequence of bytes
            Hash of each segment of the group.
        """
        known = [self._places[key] for key in keys if key in self._places]
        if not known:
            return [None] * len(keys)
        fewest = min(known, key=len)
        best = max(fewest, key=lambda each: sum(each in places for places in known))
        return [self._intact_place(self._places.get(key, {}), best) for key in keys]

    def _intact_place(self, places: dict[bytes, SegmentPlace], best: bytes) -> SegmentPlace | None:
        """Return the place in the object `best`, else in any object that is undamaged."""
        first = [places[best]] if best in places else []
        return next((place for place in (*first, *places.values()) if self._is_intact(place)), None)

    def _add(self, manifest: Path) -> None:
        """Add the segments of a manifest; warn and skip a manifest that cannot be read."""
        try:
            source = FolderSource(manifest)
            try:
                indexes = source.placed_segments()
            finally:
                source.close()
        except CogsplatError as error:
            warnings.warn(
                f"{manifest}: cannot be read, so no object is shared with it: {error.message}",
                CogsplatWarning,
                stacklevel=4,
            )
            return
        for segments in indexes:
            places = segments.places
            for row in range(len(places)):
                place = SegmentPlace(
                    places.objects[row].tobytes(), int(places.sizes[row]), int(places.offsets[row])
                )
                self._places.setdefault(segments.hashes[row].tobytes(), {})[place.key] = place

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
