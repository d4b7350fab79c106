"""Buckets, and what their errors are called."""

import sys

import pytest
from obstore.store import MemoryStore

from cogsplat.codec.errors import MissingExtraError, StorageError
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


def test_settings_that_are_none_are_refused() -> None:
    with pytest.raises(StorageError) as refused:
        Bucket("s3://bucket", {"no such setting": "0"})
    assert refused.value.code == "bucket-address"


def test_without_the_extra_it_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "obstore.store", None)
    with pytest.raises(MissingExtraError) as refused:
        Bucket("s3://bucket")
    assert refused.value.code == "needs-cloud"
