"""One file into a folder of a manifest and objects, and back, byte for byte (SPEC 3.4)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from cogsplat.codec.errors import StorageError, TruncatedError
from cogsplat.codec.progress import Progress, silent
from cogsplat.formats.storage.atomic import atomic_write, check_output, storage_errors, sync_all
from cogsplat.formats.storage.magic import MANIFEST_MAGIC

from . import layout
from .folder_map import MANIFEST_NAME, MANIFEST_SUFFIX, places, with_magic
from .folder_places import SEGMENT_FOLDER, Places, key_of, object_name, pack_places
from .object_groups import SegmentPlace, StoredSegments, group_segments, has_object
from .reader import CogsFile
from .root import HASH_BYTES
from .verification import read_verified

# Sizes of objects are 32 bits (SPEC 3.4).
_MOST_OBJECT_BYTES: Final = (1 << 32) - 1


@dataclass(frozen=True)
class Unpacked:
    """What was written into a folder.

    Parameters
    ----------
    manifest : Path
    manifest_bytes : int
    segments : int
        Of the file, those that are there.
    written, written_bytes : int
        Objects that were not in the folder before, and their bytes.
    shared : int
        Objects that were there already, from another version of the scene.
    """

    manifest: Path
    manifest_bytes: int
    segments: int
    written: int
    written_bytes: int
    shared: int


def build_manifest(file: CogsFile, found: Sequence[SegmentPlace]) -> bytes:
    """Return the manifest of a file: preamble, root and pages, and where the segments lie.

    Parameters
    ----------
    file : CogsFile
    found : sequence of SegmentPlace
        Of each segment, in the order of the file.

    Raises
    ------
    TruncatedError
        ``file-truncated``: a partial file lacks pages.
    """
    first = file.read_bytes(0, layout.PREAMBLE_BYTES)
    root_end = layout.PREAMBLE_BYTES + layout.unpack_preamble(first, file.name).root_length
    parts = [with_magic(first, MANIFEST_MAGIC)]
    table = Places(
        np.frombuffer(b"".join(place.key for place in found), np.uint8).reshape(-1, HASH_BYTES),
        np.array([place.size for place in found], np.uint32),
        np.array([place.offset for place in found], np.uint32),
    )
    counts = [len(file.root.segments), *(page.segments for page in file.root.pages)]
    row = 0
    for place, count in zip(places(root_end, file.root), counts, strict=True):
        start = max(place.start, layout.PREAMBLE_BYTES)
        parts.append(_exactly(file, start, place.segments - start))
        parts.append(pack_places(table.rows(slice(row, row + count))))
        row += count
    return b"".join(parts)


def unpack_cogs(
    file: CogsFile,
    folder: Path,
    *,
    name: str = MANIFEST_NAME,
    force: bool = False,
    progress: Progress = silent,
) -> Unpacked:
    """Write a file as a folder: its objects first, then the manifest.

    Parameters
    ----------
    file : CogsFile
        Of a partial one, the segments that are there are written; all pages must be there.
    folder : Path
        Made where it is not there. Objects that it has already are kept.
    name : str
        Of the manifest; several in one folder are versions that share segments.
    force : bool
        Replace an existing manifest.
    progress : Progress
        Called with ``("unpack", segments done, segments)``.

    Returns
    -------
    Unpacked

    Raises
    ------
    ValueError
        A name that is no file name or does not end in ``.cogsm``.
    TargetExistsError
        ``exists``: the manifest is there and `force` is not set.
    StorageError
        The folder cannot be written; ``not-a-folder``: ``segments`` is a link.
    FormatError
        ``segment-crc``, ``segment-hash``.

    Notes
    -----
    The segments of a chunk are joined in one object, and those of all codebooks, but a segment that
    another manifest of the folder has is left in its object. An object that is there is compared
    with what it should hold, and replaced where it differs: it is damaged, or half-written from
    before. A manifest beside that cannot be read gives a `CogsplatWarning`.
    """
    check_manifest_name(name)
    objects = folder / SEGMENT_FOLDER
    with storage_errors(folder):
        objects.mkdir(parents=True, exist_ok=True)
    if objects.is_symlink():
        raise StorageError("not-a-folder", f"{objects}: is a link, expected a folder")
    check_output(folder / name, force=force)
    # What is missing of a part lies in an object of its own, wherever that is.
    found = [
        SegmentPlace(key.tobytes(), int(length), 0)
        for key, length in zip(file.segments.hash, file.segments.length, strict=True)
    ]
    # Refused before anything is written where pages are not there.
    build_manifest(file, found)
    stored = StoredSegments(folder)
    present = [row for row in range(len(found)) if file.is_present(row)]
    there = set(present)
    written: dict[bytes, int] = {}
    used: set[bytes] = set()
    done = 0
    for rows in group_segments(file.segments):
        group = [row for row in rows if row in there]
        new = []
        for row in group:
            place = stored.place_of(found[row].key)
            if place is None:
                new.append(row)
            else:
                found[row] = place
                used.add(place.key)
        for part in _objects(file, new):
            data = b"".join(bytes(read_verified(file, row)) for row in part)
            key, offset = key_of(data), 0
            for row in part:
                found[row] = SegmentPlace(key, len(data), offset)
                offset += int(file.segments.length[row])
            if key not in used and not has_object(folder, key, len(data)):
                _write_object(folder / object_name(key), data)
                written[key] = len(data)
            used.add(key)
        done += len(group)
        if group:
            progress("unpack", done, len(present))
    sync_all([folder / object_name(key) for key in written])
    manifest = build_manifest(file, found)
    # Last, so that no manifest names what is not there.
    with atomic_write(folder / name, force=force) as out:
        out.write(manifest)
    return Unpacked(
        folder / name,
        len(manifest),
        len(present),
        len(written),
        sum(written.values()),
        len(used) - len(written),
    )


def _objects(file: CogsFile, rows: Sequence[int]) -> list[list[int]]:
    """Cut segments that are joined where an object would become larger than one may be."""
    parts: list[list[int]] = []
    size = _MOST_OBJECT_BYTES
    for row in rows:
        size += int(file.segments.length[row])
        if size > _MOST_OBJECT_BYTES:
            parts.append([])
            size = int(file.segments.length[row])
        parts[-1].append(row)
    return parts


def pack_cogs(
    file: CogsFile, path: Path, *, force: bool = False, progress: Progress = silent
) -> int:
    """Write one file of what an open one holds, of a folder above all, byte for byte.

    Parameters
    ----------
    file : CogsFile
        Of a partial one, what stands before the first segment that is missing is written.
    path : Path
    force : bool
        Replace an existing file.
    progress : Progress
        Called with ``("pack", segments done, segments)``.

    Returns
    -------
    int
        Bytes written.

    Raises
    ------
    FormatError
        ``segment-crc``, ``segment-hash``, ``segment-object``.
    StorageError
        The file cannot be written.
    """
    position = 0
    with atomic_write(path, force=force) as out:
        for row in range(len(file.segments)):
            offset = int(file.offsets[row])
            if not file.is_present(row):
                return position
            # What lies between segments is the root or a page.
            out.write(_exactly(file, position, offset - position))
            out.write(read_verified(file, row))
            position = offset + int(file.segments.length[row])
            progress("pack", row + 1, len(file.segments))
        if not file.missing_bytes:
            out.write(_exactly(file, position, file.file_length - position))
            position = file.file_length
    return position


def check_manifest_name(name: str) -> None:
    """Refuse the name of a manifest that could lead elsewhere or stand for something else.

    Raises
    ------
    ValueError
        It has a separator, a drive or characters that no name has, or does not end in ``.cogsm``.
    """
    plain = name.isprintable() and not {*name} & {*'/\\:*?"<>|'}
    if not plain or not name.endswith(MANIFEST_SUFFIX) or name == MANIFEST_SUFFIX:
        raise ValueError(f"manifest {name!r}, expected a file name that ends in {MANIFEST_SUFFIX}")


def _exactly(file: CogsFile, offset: int, length: int) -> bytes:
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
    with storage_errors(path):
        # What a link leads to is not of this folder and stays as it is.
        if path.is_symlink():
            path.unlink()
    with atomic_write(path, force=True, durable=False) as out:
        out.write(data)
