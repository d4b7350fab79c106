"""Upload a folder of a manifest and objects: objects first, the manifest last (SPEC 3.4)."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final

from cogsplat.codec.errors import CogsplatError, DataError, StorageError
from cogsplat.codec.progress import Progress, silent
from cogsplat.formats.cogs.folder_map import MANIFEST_SUFFIX, FolderMap
from cogsplat.formats.cogs.folder_places import SEGMENT_FOLDER, check_object
from cogsplat.formats.cogs.folder_source import FolderSource, manifest_path
from cogsplat.formats.storage.atomic import open_for_read, storage_errors

from .object_store import Bucket

OBJECT_HEADERS: Final[Mapping[str, str]] = {
    "Content-Type": "application/octet-stream",
    "Cache-Control": "public, max-age=31536000, immutable, no-transform",
}
"""What objects are served with: they never change under their names."""

MANIFEST_HEADERS: Final[Mapping[str, str]] = {
    "Content-Type": "application/octet-stream",
    "Cache-Control": "no-cache, no-transform",
}
"""What manifests are served with: caches ask whether there is a new one."""

# Whatever else is in the bucket is not ours to delete.
_OBJECT: Final = re.compile(rf"{SEGMENT_FOLDER}/[0-9a-f]{{32}}\.bin")


@dataclass(frozen=True)
class Plan:
    """What an upload will do.

    Parameters
    ----------
    manifest : Path
    objects : dict of str to int
        Bytes of the objects to write, by their names.
    there : int
        Objects that the bucket has already.
    manifest_changes : bool
        Whether the bucket has no manifest of that name, or another one.
    """

    manifest: Path
    objects: dict[str, int]
    there: int
    manifest_changes: bool

    @property
    def object_bytes(self) -> int:
        """Bytes of the objects to write."""
        return sum(self.objects.values())


@dataclass(frozen=True)
class Unused:
    """Objects of a bucket that no manifest there needs.

    Parameters
    ----------
    names : list of str
    size_bytes : int
    manifests : list of str
        The manifests that were read.
    recent : int
        Objects that no manifest needs either, and that are too new to be deleted.
    """

    names: list[str] = field(default_factory=list)
    size_bytes: int = 0
    manifests: list[str] = field(default_factory=list)
    recent: int = 0


def plan_upload(source: FolderSource, folder: Path, bucket: Bucket) -> Plan:
    """Compare a folder with what a bucket has; nothing is written.

    Parameters
    ----------
    source : FolderSource
        The folder.
    folder : Path
        Its path, or that of one of its manifests.
    bucket : Bucket

    Raises
    ------
    StorageError
        See `Bucket`.
    """
    manifest = manifest_path(folder)
    there = {entry.name: entry.size for entry in bucket.objects(SEGMENT_FOLDER)}
    # One of another length is what an upload left that broke off.
    missing = {name: size for name, size in source.objects().items() if there.get(name) != size}
    return Plan(
        manifest,
        missing,
        len(source.objects()) - len(missing),
        bucket.read(manifest.name) != _bytes_of(manifest),
    )


def upload(
    plan: Plan,
    source: FolderSource,
    bucket: Bucket,
    *,
    concurrency: int = 8,
    progress: Progress = silent,
) -> None:
    """Write what a plan lists; begun again, it goes on where it ended.

    Parameters
    ----------
    plan : Plan
    source : FolderSource
        What it was made of.
    bucket : Bucket
    concurrency : int
        Objects that are written at once.
    progress : Progress
        Called with ``("upload", objects done, objects)``.

    Raises
    ------
    FormatError
        ``object-hash``, ``segment-object``: a damaged object is not sent.
    TruncatedError
        ``segment-missing``.
    StorageError
        See `Bucket`. The manifest is written after all objects, so that it never names what is not
        there.
    """

    def send(name: str) -> None:
        data = source.read_object(name)
        check_object(name, data, source.name)
        bucket.write(name, data, OBJECT_HEADERS)

    total = len(plan.objects) + plan.manifest_changes
    pool = ThreadPoolExecutor(concurrency)
    try:
        sent = [pool.submit(send, name) for name in plan.objects]
        for done, future in enumerate(as_completed(sent), start=1):
            future.result()
            progress("upload", done, total)
    finally:
        # After a failure nothing more is begun.
        pool.shutdown(cancel_futures=True)
    if plan.manifest_changes:
        bucket.write(plan.manifest.name, _bytes_of(plan.manifest), MANIFEST_HEADERS)
        progress("upload", total, total)


def find_unused(bucket: Bucket, *, older_than: timedelta) -> Unused:
    """Return the objects that no manifest of a bucket needs; nothing is deleted.

    Parameters
    ----------
    bucket : Bucket
    older_than : timedelta
        Objects that were written later are left: an upload may be under way, and readers may still
        have the manifest before.

    Raises
    ------
    DataError
        ``no-manifest``: the bucket has none, so that nothing says what is needed.
    CogsplatError
        A manifest cannot be read; then nothing is known to be unused.
    StorageError
        See `Bucket`.
    """
    # Objects first: one that is written after this list is on none that is deleted.
    objects = [entry for entry in bucket.objects(SEGMENT_FOLDER) if _OBJECT.fullmatch(entry.name)]
    manifests = [
        entry.name for entry in bucket.top_objects() if entry.name.endswith(MANIFEST_SUFFIX)
    ]
    if not manifests:
        raise DataError("no-manifest", f"{bucket.name}: has no manifest, expected one or more")
    needed: set[str] = set()
    for name in manifests:
        data = bucket.read(name)
        if data is None:
            raise StorageError(
                "bucket-failed", f"{bucket.name}/{name}: went away, expected it there"
            )
        needed |= _names_in(data, f"{bucket.name}/{name}")
    unused = [entry for entry in objects if entry.name not in needed]
    latest = datetime.now(UTC) - older_than
    old = [entry for entry in unused if entry.modified <= latest]
    return Unused(
        [entry.name for entry in old],
        sum(entry.size for entry in old),
        manifests,
        len(unused) - len(old),
    )


def delete_unused(unused: Unused, bucket: Bucket) -> None:
    """Delete what `find_unused` found; raises as `Bucket`."""
    names: Sequence[str] = unused.names
    if names:
        bucket.delete(names)


def _names_in(manifest: bytes, where: str) -> set[str]:
    """Return the objects that a manifest needs."""
    try:
        found = FolderMap(manifest, where)
        found.check_manifest_size(len(manifest))
        for page in found.pages_for(0, found.file_length):
            found.add_page(page.page, manifest[page.offset : page.offset + page.length])
        return set(found.objects())
    except CogsplatError as error:
        raise DataError(
            "no-manifest",
            f"{where}: cannot be read, so that nothing can be said to be unused: {error.message}",
        ) from error


def _bytes_of(path: Path) -> bytes:
    with storage_errors(path), open_for_read(path) as file:
        return file.read()
