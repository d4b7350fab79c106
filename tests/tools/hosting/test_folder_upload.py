"""Uploads into a bucket in memory: what is sent, in what order, what is deleted, what goes on."""

from collections.abc import Callable, Mapping
from contextlib import closing
from datetime import timedelta
from pathlib import Path

import pytest
from obstore.store import MemoryStore
from running import SmallScene

import cogsplat
from cogsplat.codec.errors import CogsplatError, DataError, FormatError, StorageError
from cogsplat.formats.cogs.folder_source import FolderSource
from cogsplat.formats.cogs.folder_writer import unpack_cogs
from cogsplat.tools.hosting.folder_upload import (
    MANIFEST_HEADERS,
    OBJECT_HEADERS,
    delete_unused,
    find_unused,
    plan_upload,
    upload_folder,
)
from cogsplat.tools.hosting.object_store import Bucket

NOW = timedelta(0)
VECTORS = Path(__file__).resolve().parents[2] / "vectors" / "valid"


class Recorded(Bucket):
    """A bucket that records writes, and fails after a number of objects."""

    def __init__(self, store: MemoryStore, most: int = 1000) -> None:
        super().__init__("memory", store=store)
        self.written: list[tuple[str, Mapping[str, str]]] = []
        self.most = most

    def write(self, name: str, data: bytes, headers: Mapping[str, str]) -> None:
        if len(self.written) >= self.most:
            raise StorageError("bucket-failed", f"{name}: no more")
        super().write(name, data, headers)
        self.written.append((name, headers))


@pytest.fixture
def folder(small: SmallScene, tmp_path: Path) -> Path:
    with cogsplat.open(small.cogs) as file:
        unpack_cogs(file, tmp_path / "scene")
    return tmp_path / "scene"


def put(folder: Path, bucket: Bucket, concurrency: int = 4) -> int:
    with closing(FolderSource(folder)) as source:
        plan = plan_upload(source, folder, bucket)
        upload_folder(plan, source, bucket, concurrency=concurrency)
        return len(plan.objects)


def test_objects_come_first_and_the_manifest_last(folder: Path) -> None:
    bucket = Recorded(MemoryStore())
    count = put(folder, bucket)
    names = [name for name, _ in bucket.written]
    assert names[-1] == "manifest.cogsm"
    assert sorted(names[:-1]) == sorted(f"segments/{p.name}" for p in folder.glob("segments/*"))
    assert count == len(names) - 1
    assert all(headers == OBJECT_HEADERS for _, headers in bucket.written[:-1])
    assert bucket.written[-1][1] == MANIFEST_HEADERS
    for path in folder.rglob("*"):
        if path.is_file():
            assert bucket.read(path.relative_to(folder).as_posix()) == path.read_bytes()
    assert put(folder, bucket) == 0
    assert len(bucket.written) == count + 1


def test_an_upload_that_broke_off_goes_on(folder: Path) -> None:
    store = MemoryStore()
    with pytest.raises(StorageError):
        put(folder, Recorded(store, most=3), concurrency=1)
    bucket = Recorded(store)
    assert bucket.read("manifest.cogsm") is None
    # An object that was cut is written anew.
    whole = next(iter(bucket.objects("segments")))
    bucket.write(whole.name, b"cut", {})
    bucket.written.clear()
    total = len(list(folder.glob("segments/*")))
    assert put(folder, bucket) == total - 2
    assert bucket.written[-1][0] == "manifest.cogsm"


def test_damage_is_not_sent(folder: Path) -> None:
    largest = max(folder.glob("segments/*"), key=lambda path: path.stat().st_size)
    largest.write_bytes(bytes(largest.stat().st_size))
    bucket = Recorded(MemoryStore())
    with pytest.raises(FormatError):
        put(folder, bucket)
    assert bucket.read("manifest.cogsm") is None
    assert bucket.read(f"segments/{largest.name}") is None


def test_pages_of_a_manifest_are_in_use_with_all_that_they_list(tmp_path: Path) -> None:
    folder = tmp_path / "scene"
    cogsplat.unpack(VECTORS / "pages.cogs", folder)
    bucket = Recorded(MemoryStore())
    put(folder, bucket)
    assert find_unused(bucket, older_than=NOW).names == []
    with closing(FolderSource(folder)) as source:
        page = next(iter(source.page_objects()))
    bucket.delete([page])
    # What a missing page lists is not known, so nothing may be deleted.
    with pytest.raises(DataError) as refused:
        find_unused(bucket, older_than=NOW)
    assert refused.value.code == "no-manifest"
    assert put(folder, bucket) == 1
    assert find_unused(bucket, older_than=NOW).names == []


def test_only_segments_that_no_manifest_needs_are_deleted(
    folder: Path, small: SmallScene, tmp_path: Path
) -> None:
    bucket = Recorded(MemoryStore())
    put(folder, bucket)
    bucket.write("segments/notes.txt", b"mine", {})
    bucket.write("segments/deeper/" + "0" * 32 + ".bin", b"mine", {})
    assert find_unused(bucket, older_than=NOW).names == []
    stray = "segments/" + "0" * 32 + ".bin"
    bucket.write(stray, b"left", {})
    recent = find_unused(bucket, older_than=timedelta(hours=1))
    assert (recent.names, recent.num_recent) == ([], 1)
    found = find_unused(bucket, older_than=NOW)
    assert (found.names, found.size_bytes, found.manifests) == ([stray], 4, ["manifest.cogsm"])
    delete_unused(found, bucket, older_than=NOW)
    assert bucket.read(stray) is None
    assert bucket.read("segments/notes.txt") == b"mine"
    # A second version needs its own; the first version's stay.
    again = tmp_path / "again.cogs"
    cogsplat.encode(cogsplat.read(small.ply), again, quality=35.0, preset="fast")
    with cogsplat.open(again) as file:
        unpack_cogs(file, folder, name="second.cogsm")
    put(folder / "second.cogsm", bucket)
    assert find_unused(bucket, older_than=NOW).names == []
    bucket.delete(["manifest.cogsm"])
    unused = find_unused(bucket, older_than=NOW)
    assert unused.names
    delete_unused(unused, bucket, older_than=NOW)
    assert put(folder / "second.cogsm", bucket) == 0


class Interleaved(Recorded):
    """A bucket in which something else happens before a manifest is written."""

    def __init__(self, store: MemoryStore, happens: Callable[[], object]) -> None:
        super().__init__(store)
        self.happens = happens

    def write(self, name: str, data: bytes, headers: Mapping[str, str]) -> None:
        if name.endswith(".cogsm"):
            self.happens()
        super().write(name, data, headers)


@pytest.fixture
def unused_bucket(folder: Path, small: SmallScene, tmp_path: Path) -> MemoryStore:
    """The objects of `folder` without its manifest, as after its deletion, and another scene."""
    store = MemoryStore()
    bucket = Recorded(store)
    put(folder, bucket)
    bucket.delete(["manifest.cogsm"])
    other = tmp_path / "other.cogs"
    cogsplat.encode(cogsplat.read(small.ply), other, quality=30.0, preset="fast")
    cogsplat.unpack(other, tmp_path / "other")
    (tmp_path / "other" / "manifest.cogsm").rename(tmp_path / "other" / "other.cogsm")
    put(tmp_path / "other" / "other.cogsm", bucket)
    assert find_unused(bucket, older_than=NOW).names
    return store


def is_complete(folder: Path, bucket: Bucket) -> bool:
    return all(bucket.read(f"segments/{path.name}") for path in folder.glob("segments/*"))


def test_objects_that_an_upload_reuses_meanwhile_are_not_deleted(
    folder: Path, unused_bucket: MemoryStore
) -> None:
    """Found unused, then named by the manifest of an upload, then to be deleted."""
    bucket = Recorded(unused_bucket)
    found = find_unused(bucket, older_than=NOW)
    assert put(folder, bucket) == 0
    assert delete_unused(found, bucket, older_than=NOW).names == []
    assert is_complete(folder, bucket)


def test_objects_deleted_between_plan_and_upload_are_written_again(
    folder: Path, unused_bucket: MemoryStore
) -> None:
    bucket = Recorded(unused_bucket)
    with closing(FolderSource(folder)) as source:
        plan = plan_upload(source, folder, bucket)
        assert not plan.objects
        found = find_unused(bucket, older_than=NOW)
        assert delete_unused(found, bucket, older_than=NOW).names == found.names
        upload_folder(plan, source, bucket)
    assert is_complete(folder, bucket)
    assert bucket.written[-1][0] == "manifest.cogsm"


def test_objects_deleted_just_before_the_manifest_are_written_again(
    folder: Path, unused_bucket: MemoryStore
) -> None:
    other = Recorded(unused_bucket)
    found = find_unused(other, older_than=NOW)
    bucket = Interleaved(unused_bucket, lambda: delete_unused(found, other, older_than=NOW))
    put(folder, bucket)
    assert is_complete(folder, bucket)


@pytest.mark.parametrize("manifest", [None, b"", b"no manifest"])
def test_a_bucket_without_a_readable_manifest_has_no_unused_objects(
    folder: Path, manifest: bytes | None
) -> None:
    bucket = Recorded(MemoryStore())
    put(folder, bucket)
    bucket.delete(["manifest.cogsm"])
    if manifest is not None:
        bucket.write("other.cogsm", manifest, {})
    with pytest.raises(DataError) as refused:
        find_unused(bucket, older_than=NOW)
    assert refused.value.code == "no-manifest"


def test_paged_manifests_name_all_their_objects(tmp_path: Path) -> None:
    path = Path(__file__).resolve().parents[2] / "vectors" / "valid" / "pages.cogs"
    with cogsplat.open(path) as file:
        unpack_cogs(file, tmp_path / "scene")
    bucket = Recorded(MemoryStore())
    put(tmp_path / "scene", bucket)
    assert find_unused(bucket, older_than=NOW).names == []


@pytest.mark.parametrize("url", ["http://example.org/a", "bucket", "s3://", "ftp://a/b"])
def test_other_addresses_are_no_buckets(url: str) -> None:
    with pytest.raises(CogsplatError) as refused:
        Bucket(url)
    assert refused.value.code == "bucket-address"
