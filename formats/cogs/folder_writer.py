"""One file into a folder of a manifest and segments, and back, byte for byte (SPEC 3.4)."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path

from cogsplat.codec.errors import StorageError, TruncatedError
from cogsplat.codec.progress import Progress, silent
from cogsplat.formats.storage.atomic import (
    atomic_write,
    check_output,
    storage_errors,
    sync_all,
)
from cogsplat.formats.storage.magic import MANIFEST_MAGIC

from . import layout
from .folder_map import (
    MANIFEST_NAME,
    MANIFEST_SUFFIX,
    SEGMENT_FOLDER,
    places,
    segment_name,
    with_magic,
)
from .reader import CogsFile
from .root import HASH_BYTES
from .verification import read_verified


@dataclass(frozen=True)
class Unpacked:
    """What was written into a folder.

    Parameters
    ----------
    manifest : Path
    manifest_bytes : int
    segments : int
        Of the file.
    written, written_bytes : int
        Objects that were not in the folder before, and their bytes.
    shared : int
        Segments whose object was there already, from another version of the scene or from another
        place of this one.
    """

    manifest: Path
    manifest_bytes: int
    segments: int
    written: int
    written_bytes: int
    shared: int


def manifest_of(file: CogsFile) -> bytes:
    """Return the manifest of a file: its preamble under another magic, its root and its pages.

    Raises
    ------
    TruncatedError
        ``file-truncated``: a partial file lacks pages.
    """
    first = file.read_bytes(0, layout.PREAMBLE_BYTES)
    root_end = layout.PREAMBLE_BYTES + layout.unpack_preamble(first, file.name).root_length
    parts = [with_magic(first, MANIFEST_MAGIC)]
    for place in places(root_end, file.root):
        start = max(place.start, layout.PREAMBLE_BYTES)
        parts.append(_exactly(file, start, place.segments - start))
    return b"".join(parts)


def unpack_cogs(
    file: CogsFile,
    folder: Path,
    *,
    name: str = MANIFEST_NAME,
    force: bool = False,
    progress: Progress = silent,
) -> Unpacked:
    """Write a file as a folder: its segments first, then the manifest.

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
    An object that is there is compared with the segment, and replaced where it differs: it is
    damaged, or half-written from before.
    """
    check_manifest_name(name)
    manifest = manifest_of(file)
    objects = folder / SEGMENT_FOLDER
    with storage_errors(folder):
        objects.mkdir(parents=True, exist_ok=True)
    if objects.is_symlink():
        raise StorageError("not-a-folder", f"{objects}: is a link, expected a folder")
    check_output(folder / name, force=force)
    written: list[Path] = []
    written_bytes = 0
    rows = [row for row in range(len(file.segments)) if file.is_present(row)]
    for done, row in enumerate(rows, start=1):
        data = read_verified(file, row)
        path = folder / segment_name(file.segments.hash[row].tobytes())
        if not _is_stored(path, data):
            _write_object(path, data)
            written.append(path)
            written_bytes += len(data)
        progress("unpack", done, len(rows))
    sync_all(written)
    # Last, so that no manifest names what is not there.
    with atomic_write(folder / name, force=force) as out:
        out.write(manifest)
    count = len(written)
    return Unpacked(
        folder / name, len(manifest), len(rows), count, written_bytes, len(rows) - count
    )


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


def _write_object(path: Path, data: memoryview) -> None:
    with storage_errors(path):
        # What a link leads to is not of this folder and stays as it is.
        if path.is_symlink():
            path.unlink()
    with atomic_write(path, force=True, durable=False) as out:
        out.write(data)


def _is_stored(path: Path, data: memoryview) -> bool:
    """Whether a file has these bytes; one of another kind is none."""
    with storage_errors(path):
        try:
            status = path.lstat()
        except FileNotFoundError:
            return False
        if path.is_symlink() or not path.is_file() or status.st_size != len(data):
            return False
        digest = hashlib.sha256(path.read_bytes()).digest()[:HASH_BYTES]
        return digest.hex() == path.stem
