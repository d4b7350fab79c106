"""Unpack an open file into a folder of manifest and objects, and pack it again (SPEC 3.4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, Final

import numpy as np

from cogsplat.codec.errors import StorageError, TruncatedError
from cogsplat.codec.progress import Progress, silent
from cogsplat.formats.storage.atomic import atomic_write, check_output, storage_errors, sync_all
from cogsplat.formats.storage.magic import MANIFEST_MAGIC

from . import layout
from .folder_map import MANIFEST_NAME, MANIFEST_SUFFIX, with_magic
from .folder_places import SEGMENT_FOLDER, PlaceTable, key_of, object_name, pack_places
from .index_tables import HASH_BYTES
from .layout import SegmentKind
from .object_groups import (
    IN_MANIFEST,
    SegmentPlace,
    StoredSegments,
    group_segments,
    has_object,
)
from .reader import CogsFile
from .verification import read_verified

# Longest description that the manifest holds, bytes.
_MOST_INSIDE: Final = 16384

# Lengths of objects have 32 bits (SPEC 3.4).
_MAX_OBJECT_BYTES: Final = (1 << 32) - 1


@dataclass(frozen=True)
class Unpacked:
    """Result of unpacking a file: its manifest, and counts of its objects.

    Parameters
    ----------
    manifest : Path
        Written manifest.
    manifest_bytes : int
        Length of the manifest, bytes.
    segments : int
        Number of segments present in the file.
    written, written_bytes : int
        Number and total length of written objects.
    shared : int
        Number of existing objects used, from another version of the scene.
    """

    manifest: Path
    manifest_bytes: int
    segments: int
    written: int
    written_bytes: int
    shared: int


@dataclass(frozen=True)
class FolderIndex:
    """Manifest of a folder, and the objects of its pages.

    Parameters
    ----------
    manifest : bytes
        Preamble, root, places of the root's segments and pages, and the segments in the manifest.
    pages : sequence of bytes
        Each page with its table of places.
    """

    manifest: bytes
    pages: Sequence[bytes]


def build_index(file: CogsFile, found: Sequence[SegmentPlace]) -> FolderIndex:
    """Return the manifest of a file and the objects of its pages.

    Parameters
    ----------
    file : CogsFile
        Open file.
    found : sequence of SegmentPlace
        Position of each segment, in file order.

    Raises
    ------
    TruncatedError
        ``file-truncated``: a partial file lacks pages.
    """
    first = file.read_bytes(0, layout.PREAMBLE_BYTES)
    root_end = layout.PREAMBLE_BYTES + layout.unpack_preamble(first, file.name).root_length
    pages: list[bytes] = []
    # Places of the pages that each index lists, by its path: last pages first, below their index.
    places: dict[tuple[int, ...], list[SegmentPlace]] = {each.path: [] for each in file.indices}
    for each in reversed(file.indices):
        rows = slice(each.first_segment, each.first_segment + len(each.tables.segments))
        places[each.path] = [*found[rows], *reversed(places[each.path])]
        if each.path:
            index = _read_exactly(file, each.start, each.end - each.start)
            pages.append(index + _packed(places[each.path]))
            key = key_of(pages[-1])
            places[each.path[:-1]].append(SegmentPlace(key, len(pages[-1]), 0))
    missing = file.first_missing_page
    if missing is not None:
        _read_exactly(file, missing.start, missing.length)
    own = range(len(file.root.segments))
    inside = [bytes(read_verified(file, at)) for at in own if found[at] == IN_MANIFEST]
    root = _read_exactly(file, layout.PREAMBLE_BYTES, root_end - layout.PREAMBLE_BYTES)
    head = with_magic(first, MANIFEST_MAGIC)
    return FolderIndex(b"".join([head, root, _packed(places[()]), *inside]), pages[::-1])


def _packed(places: Sequence[SegmentPlace]) -> bytes:
    """Return a table of places."""
    table = PlaceTable(
        np.frombuffer(b"".join(place.key for place in places), np.uint8).reshape(-1, HASH_BYTES),
        np.array([place.size for place in places], np.uint32),
        np.array([place.offset for place in places], np.uint32),
    )
    return pack_places(table)


def unpack_cogs(
    file: CogsFile,
    folder: Path,
    *,
    name: str = MANIFEST_NAME,
    force: bool = False,
    progress: Progress = silent,
) -> Unpacked:
    """Write a file as a folder: objects first, then the manifest.

    Parameters
    ----------
    file : CogsFile
        Open file. A partial one must have all pages; its present segments are written.
    folder : Path
        Output folder, created if missing. Existing objects are kept and shared.
    name : str
        File name of the manifest. Several manifests in one folder are versions that share objects.
    force : bool
        Whether to replace an existing manifest.
    progress : Progress
        Callback, called with ``("unpack", segments done, segments)``.

    Returns
    -------
    Unpacked
        Manifest, and counts of written and shared objects.

    Raises
    ------
    ValueError
        `name` is not a file name that ends in ``.cogsm``.
    TargetExistsError
        ``exists``: the manifest exists and `force` is not set.
    StorageError
        The folder cannot be written; ``not-a-folder``: ``segments`` is a link.
    FormatError
        ``segment-crc``, ``segment-hash``.

    Notes
    -----
    The segments of a chunk form one object, those of all codebooks another, each page with
    its places one more. The description is in the manifest. A segment that another manifest of the
    folder lists stays in its existing object. Existing objects are compared
    with their hash, and damaged or half-written ones replaced. Another manifest that cannot be read
    gives a `CogsplatWarning`.
    """
    check_manifest_name(name)
    objects = folder / SEGMENT_FOLDER
    with storage_errors(folder):
        objects.mkdir(parents=True, exist_ok=True)
    if objects.is_symlink():
        raise StorageError("not-a-folder", f"{objects}: is a link, expected a folder")
    check_output(folder / name, force=force)
    # Missing segments of a partial file get an object of their own.
    found = [
        SegmentPlace(key.tobytes(), int(length), 0)
        for key, length in zip(file.segments.hash, file.segments.length, strict=True)
    ]
    # Fails for missing pages before anything is written.
    build_index(file, found)
    stored = StoredSegments(folder)
    present = [row for row in range(len(found)) if file.is_present(row)]
    there = set(present)
    written: dict[bytes, int] = {}
    used: set[bytes] = set()

    def keep_object(data: bytes) -> bytes:
        """Write an object that the folder lacks; return its key."""
        key = key_of(data)
        if key not in used and not has_object(folder, key, len(data)):
            _write_object(folder / object_name(key), data)
            written[key] = len(data)
        used.add(key)
        return key

    done = 0
    for rows in group_segments(file.segments):
        group = [row for row in rows if row in there]
        new = []
        places = stored.places_of([found[row].key for row in group])
        for row, place in zip(group, places, strict=True):
            if _belongs_in_manifest(file, row):
                found[row] = IN_MANIFEST
            elif place is None:
                new.append(row)
            else:
                found[row] = place
                used.add(place.key)
        for part in _split_objects(file, new):
            data = b"".join(bytes(read_verified(file, row)) for row in part)
            key, offset = keep_object(data), 0
            for row in part:
                found[row] = SegmentPlace(key, len(data), offset)
                offset += int(file.segments.length[row])
        done += len(group)
        if group:
            progress("unpack", done, len(present))
    index = build_index(file, found)
    for page in index.pages:
        keep_object(page)
    sync_all([folder / object_name(key) for key in written])
    # Written last, so that a manifest never lists a missing object.
    with atomic_write(folder / name, force=force) as out:
        out.write(index.manifest)
    return Unpacked(
        folder / name,
        len(index.manifest),
        len(present),
        len(written),
        sum(written.values()),
        len(used) - len(written),
    )


def _belongs_in_manifest(file: CogsFile, row: int) -> bool:
    """Whether a segment is stored in the manifest: the description, so that a title changes alone.

    With the limit the manifest stays below `MAX_MANIFEST_BYTES`: a root of 16 KiB lists at most 494
    segments and pages, so its table of places takes at most 12 KB.
    """
    return (
        row < len(file.root.segments)
        and file.segments.kind[row] == SegmentKind.DESCRIPTION
        and int(file.segments.length[row]) <= _MOST_INSIDE
    )


def _split_objects(file: CogsFile, rows: Sequence[int]) -> list[list[int]]:
    """Split the segments of an object into several objects of at most 4 GiB."""
    parts: list[list[int]] = []
    size = _MAX_OBJECT_BYTES
    for row in rows:
        size += int(file.segments.length[row])
        if size > _MAX_OBJECT_BYTES:
            parts.append([])
            size = int(file.segments.length[row])
        parts[-1].append(row)
    return parts


def pack_cogs(
    file: CogsFile, path: Path, *, force: bool = False, progress: Progress = silent
) -> int:
    """Write an open file, usually of a folder, as one COGS file with the same bytes.

    Parameters
    ----------
    file : CogsFile
        Open file. A partial one is written up to its first missing segment.
    path : Path
        Output file.
    force : bool
        Whether to replace an existing file.
    progress : Progress
        Callback, called with ``("pack", segments done, segments)``.

    Returns
    -------
    int
        Length of the written file, bytes.

    Raises
    ------
    FormatError
        ``segment-crc``, ``segment-hash``, ``segment-object``.
    StorageError
        The file cannot be written.
    """
    with atomic_write(path, force=force) as out:
        return copy_cogs(file, out, progress=progress)


def copy_cogs(file: CogsFile, out: BinaryIO, *, progress: Progress = silent) -> int:
    """Write the bytes of an open file, each segment checked; return their number.

    Parameters
    ----------
    file : CogsFile
        Open file. A partial one is written up to its first missing segment.
    out : BinaryIO
        Open output file.
    progress : Progress
        Callback, called with ``("pack", segments done, segments)``.

    Raises
    ------
    FormatError
        ``segment-crc``, ``segment-hash``, ``segment-object``.
    """
    position = 0
    for row in range(len(file.segments)):
        offset = int(file.offsets[row])
        if not file.is_present(row):
            return position
        # The root or a page lies between segments.
        out.write(_read_exactly(file, position, offset - position))
        out.write(read_verified(file, row))
        position = offset + int(file.segments.length[row])
        progress("pack", row + 1, len(file.segments))
    if not file.missing_bytes:
        out.write(_read_exactly(file, position, file.file_length - position))
        position = file.file_length
    return position


def check_manifest_name(name: str) -> None:
    """Refuse a manifest name that is not a plain file name ending in ``.cogsm``.

    Raises
    ------
    ValueError
        The name has a separator, a drive letter or forbidden characters, or another ending.
    """
    plain = name.isprintable() and not {*name} & {*'/\\:*?"<>|'}
    if not plain or not name.endswith(MANIFEST_SUFFIX) or name == MANIFEST_SUFFIX:
        raise ValueError(f"manifest {name!r}, expected a file name that ends in {MANIFEST_SUFFIX}")


def _read_exactly(file: CogsFile, offset: int, length: int) -> bytes:
    """Return `length` stored bytes of a file, or raise ``file-truncated``."""
    data = file.read_bytes(offset, length)
    if len(data) != length:
        raise TruncatedError(
            "file-truncated",
            f"{file.name}: {len(data)} bytes at byte {offset}, expected {length}",
            clause="3.3",
            offset=offset + len(data),
            needed=offset + length,
        )
    return data


def _write_object(path: Path, data: bytes) -> None:
    """Write an object of a folder, in place of an existing file or link."""
    with storage_errors(path):
        # A link is removed instead of followed: its target is not part of the folder.
        if path.is_symlink():
            path.unlink()
    with atomic_write(path, force=True, durable=False) as out:
        out.write(data)
