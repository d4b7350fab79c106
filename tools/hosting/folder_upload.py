"""Upload of a COGS folder to a bucket: objects first, the manifest last (SPEC 3.4)."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass, field, replace
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
"""HTTP headers of objects, whose names are hashes of their content, so that they never change."""

MANIFEST_HEADERS: Final[Mapping[str, str]] = {
    "Content-Type": "application/octet-stream",
    "Cache-Control": "no-cache, no-transform",
}
"""HTTP headers of manifests: caches must ask the host for a new version."""

# Names of the objects of COGS folders; no other object of the bucket is ever deleted.
_OBJECT: Final = re.compile(rf"{SEGMENT_FOLDER}/[0-9a-f]{{32}}\.bin")


@dataclass(frozen=True)
class UploadPlan:
    """Objects that an upload writes, and whether it changes the bucket's manifest.

    Parameters
    ----------
    manifest : Path
        Path of the local manifest.
    objects : dict of str to int
        Size of each object to write, bytes, by name.
    num_existing : int
        Number of the folder's objects that the bucket already has.
    manifest_changes : bool
        Whether the bucket has no manifest of the local manifest's name, or a different one.
    """

    manifest: Path
    objects: dict[str, int]
    num_existing: int
    manifest_changes: bool

    @property
    def object_bytes(self) -> int:
        """Total size of the objects to write, bytes."""
        return sum(self.objects.values())


@dataclass(frozen=True)
class UnusedObjects:
    """Objects of a bucket that none of its manifests references.

    Parameters
    ----------
    sizes : dict of str to int
        Size of each unused object that is old enough to delete, bytes, by name.
    manifests : list of str
        Names of the bucket's manifests.
    num_recent : int
        Unused objects that are too new to delete.
    """

    sizes: dict[str, int] = field(default_factory=dict)
    manifests: list[str] = field(default_factory=list)
    num_recent: int = 0

    @property
    def names(self) -> list[str]:
        """Names of the unused objects that are old enough to delete."""
        return [*self.sizes]

    @property
    def size_bytes(self) -> int:
        """Total size of the unused objects that are old enough to delete, bytes."""
        return sum(self.sizes.values())


def plan_upload(source: FolderSource, folder: Path, bucket: Bucket) -> UploadPlan:
    """Compare a folder with a bucket, without writing.

    Parameters
    ----------
    source : FolderSource
        The open folder.
    folder : Path
        Path of the folder, or of one of its manifests.
    bucket : Bucket
        Destination.

    Raises
    ------
    StorageError
        See `Bucket`.
    """
    manifest = manifest_path(folder)
    missing = _missing_objects(source, bucket)
    return UploadPlan(
        manifest,
        missing,
        len(source.objects()) - len(missing),
        bucket.read(manifest.name) != _read_file(manifest),
    )


def _missing_objects(source: FolderSource, bucket: Bucket) -> dict[str, int]:
    """Return the sizes of the objects of a folder that a bucket lacks, by name."""
    existing = {entry.name: entry.size for entry in bucket.objects(SEGMENT_FOLDER)}
    # An object of another size is left over from an interrupted upload.
    return {name: size for name, size in source.objects().items() if existing.get(name) != size}


def upload_folder(
    plan: UploadPlan,
    source: FolderSource,
    bucket: Bucket,
    *,
    concurrency: int = 8,
    progress: Progress = silent,
) -> None:
    """Upload the objects of a plan, then the manifest.

    The manifest comes last, so that it never references a missing object. A repeated upload with a
    new plan skips the objects that were written. Objects that a concurrent `delete_unused` removes
    are written again, before the manifest and after it: later deletions see the manifest.

    Parameters
    ----------
    plan : UploadPlan
        Plan of `plan_upload`.
    source : FolderSource
        The open folder.
    bucket : Bucket
        Destination.
    concurrency : int
        Number of simultaneous writes.
    progress : Progress
        Called with ``("upload", objects done, objects)``.

    Raises
    ------
    FormatError
        ``object-hash``, ``segment-object``: a local object is damaged.
    TruncatedError
        ``segment-missing``: a local object is missing.
    StorageError
        See `Bucket`.
    """

    def upload_object(name: str) -> None:
        data = source.read_object(name)
        check_object(name, data, source.name)
        bucket.write(name, data, OBJECT_HEADERS)

    total = len(plan.objects) + plan.manifest_changes

    def upload_objects(names: Iterable[str]) -> None:
        pool = ThreadPoolExecutor(concurrency)
        try:
            futures = [pool.submit(upload_object, name) for name in names]
            for done, future in enumerate(as_completed(futures), start=1):
                future.result()
                progress("upload", min(done, total), total)
        finally:
            # After a failure, do not start further writes.
            pool.shutdown(cancel_futures=True)

    upload_objects(plan.objects)
    upload_objects(_missing_objects(source, bucket))
    if plan.manifest_changes:
        bucket.write(plan.manifest.name, _read_file(plan.manifest), MANIFEST_HEADERS)
        progress("upload", total, total)
        upload_objects(_missing_objects(source, bucket))


def find_unused(bucket: Bucket, *, older_than: timedelta) -> UnusedObjects:
    """Find the objects that no manifest of a bucket references, without deleting.

    Parameters
    ----------
    bucket : Bucket
        Bucket to search.
    older_than : timedelta
        Minimum age of an object to delete. Newer objects may belong to an upload in progress, and
        readers may still use the previous manifest.

    Raises
    ------
    DataError
        ``no-manifest``: the bucket has no manifest, or one that cannot be read.
    StorageError
        See `Bucket`.
    """
    # List objects before reading manifests, so that a concurrent upload's objects are not listed.
    objects = [entry for entry in bucket.objects(SEGMENT_FOLDER) if _OBJECT.fullmatch(entry.name)]
    manifests = [
        entry.name for entry in bucket.top_objects() if entry.name.endswith(MANIFEST_SUFFIX)
    ]
    if not manifests:
        raise DataError("no-manifest", f"{bucket.name}: has no manifest, expected at least one")
    referenced: set[str] = set()
    for name in manifests:
        data = bucket.read(name)
        if data is None:
            raise StorageError(
                "bucket-failed", f"{bucket.name}/{name}: was deleted, expected it to remain"
            )
        referenced |= _object_names(data, bucket, f"{bucket.name}/{name}")
    unused = [entry for entry in objects if entry.name not in referenced]
    latest = datetime.now(UTC) - older_than
    old = [entry for entry in unused if entry.modified <= latest]
    return UnusedObjects(
        {entry.name: entry.size for entry in old},
        manifests,
        len(unused) - len(old),
    )


def delete_unused(unused: UnusedObjects, bucket: Bucket, *, older_than: timedelta) -> UnusedObjects:
    """Delete the unused objects of `find_unused`, after reading all manifests again.

    The manifests are read again. Since `find_unused`, perhaps minutes ago if the user had to
    confirm, another upload may have written a manifest that references some of these objects.

    Parameters
    ----------
    unused : UnusedObjects
        Objects that may be deleted.
    bucket : Bucket
        Bucket that holds them.
    older_than : timedelta
        Minimum age, as in `find_unused`.

    Returns
    -------
    UnusedObjects
        Deleted objects.

    Raises
    ------
    CogsplatError
        See `find_unused`.
    """
    if not unused.names:
        return unused
    still = find_unused(bucket, older_than=older_than)
    sizes = {name: size for name, size in still.sizes.items() if name in unused.sizes}
    if sizes:
        bucket.delete([*sizes])
    return replace(still, sizes=sizes)


def _object_names(manifest: bytes, bucket: Bucket, where: str) -> set[str]:
    """Return the names of the objects that a manifest of a bucket references."""
    try:
        folder = FolderMap(manifest, where)
        folder.check_manifest_size(len(manifest))
        for page in folder.pages_for(0, folder.file_length):
            place = folder.page_range(page)
            data = bucket.read(place.name) or b""
            folder.add_page(page, data[place.offset : place.offset + place.length])
        return set(folder.objects())
    except CogsplatError as error:
        raise DataError(
            "no-manifest",
            f"{where}: cannot be read, expected it to list the objects in use: {error.message}",
        ) from error


def _read_file(path: Path) -> bytes:
    """Return the bytes of a local file."""
    with storage_errors(path), open_for_read(path) as file:
        return file.read()
