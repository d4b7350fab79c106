import hashlib
import os

import pytest
from cogs_samples import assert_same, file_of
from fault_server import FaultServer, serving

import cogsplat
from cogsplat.formats.network.segment_cache import SegmentCache


def key_of(data):
    return hashlib.sha256(data).digest()[:16]


def test_what_is_kept_is_what_its_name_says(tmp_path):
    cache = SegmentCache(tmp_path / "kept", 1 << 20)
    assert cache.get(key_of(b"a")) is None
    cache.put(key_of(b"a"), b"a")
    assert cache.has(key_of(b"a"))
    assert cache.get(key_of(b"a")) == b"a"
    # A file that states another's hash keeps nothing.
    cache.put(key_of(b"b"), b"evil")
    assert not cache.has(key_of(b"b"))
    (tmp_path / "kept" / key_of(b"a").hex()).write_bytes(b"damaged")
    assert cache.get(key_of(b"a")) is None


def test_the_least_recently_used_go(tmp_path):
    cache = SegmentCache(tmp_path, 10_000)
    parts = [bytes([number]) * 1000 for number in range(30)]
    for number, part in enumerate(parts):
        cache.put(key_of(part), part)
        os.utime(tmp_path / key_of(part).hex(), (number, number))
    kept = [number for number, part in enumerate(parts) if cache.has(key_of(part))]
    assert len(kept) <= 13
    assert kept == list(range(30 - len(kept), 30))


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root writes everywhere")
def test_a_folder_that_cannot_be_written_is_no_fault(tmp_path):
    tmp_path.chmod(0o500)
    cache = SegmentCache(tmp_path / "kept", 1 << 20)
    cache.put(key_of(b"a"), b"a")
    assert cache.get(key_of(b"a")) is None


def test_a_scene_is_fetched_once(tmp_path):
    data = file_of("vq", 6000, 3, 500)
    network = cogsplat.NetworkOptions(cache=tmp_path / "kept")
    whole = cogsplat.decode(data)
    with serving(FaultServer(data)) as server:
        for _ in range(2):
            assert_same(cogsplat.decode(server.url(), network=network), whole)
        with (
            cogsplat.open(server.url("copy"), network=network) as file,
            file.stream() as updates,
        ):
            assert sum(len(update.splats) for update in updates if update.is_complete) == 6000
    asked = [asked.first for asked in server.asked]
    # The second and third time the first request alone, which says that nothing has changed.
    assert asked[-2:] == [0, 0]
    assert asked.count(0) == 3
