"""Buckets, and what their errors are called."""

import sys

import pytest
from obstore.store import MemoryStore

from cogsplat.codec.errors import MissingExtraError, StorageError
from cogsplat.tools.hosting import object_store
from cogsplat.tools.hosting.object_store import Bucket


def test_objects_are_listed_read_and_deleted() -> None:
    bucket = Bucket("memory", store=MemoryStore())
    bucket.write("a.cogsm", b"one", {"Cache-Control": "no-cache"})
    bucket.write("segments/b.bin", b"two", {})
    assert [x.name for x in bucket.top_objects()] == ["a.cogsm"]
    (inner,) = bucket.objects("segments")
    assert (inner.name, inner.size) == ("segments/b.bin", 3)
    assert bucket.read("segments/b.bin") == b"two"
    bucket.delete(["segments/b.bin"])
    assert bucket.read("segments/b.bin") is None


def test_a_bucket_of_more_than_any_scene_needs_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    bucket = Bucket("memory", store=MemoryStore())
    for name in ("a", "b", "c"):
        bucket.write(f"segments/{name}", b"12345", {})
    monkeypatch.setattr(object_store, "_MAX_OBJECTS", 2)
    with pytest.raises(StorageError, match="more than 2 objects") as many:
        list(bucket.objects("segments"))
    monkeypatch.setattr(object_store, "_MAX_READ_BYTES", 4)
    with pytest.raises(StorageError, match="more than 4 bytes") as long:
        bucket.read("segments/a")
    assert (many.value.code, long.value.code) == ("bucket-failed", "bucket-failed")


def test_settings_that_are_none_are_refused() -> None:
    with pytest.raises(StorageError) as refused:
        Bucket("s3://bucket", {"no such setting": "0"})
    assert refused.value.code == "bucket-address"


def test_without_the_extra_it_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "obstore.store", None)
    with pytest.raises(MissingExtraError) as refused:
        Bucket("s3://bucket")
    assert refused.value.code == "needs-cloud"
