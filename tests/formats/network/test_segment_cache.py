import hashlib
import os
import subprocess
import sys
from pathlib import Path

import pytest
from cogs_samples import assert_same, file_of
from fault_server import FaultServer, serving

import cogsplat
from cogsplat.codec.errors import CogsplatWarning
from cogsplat.formats.network.segment_cache import SegmentCache

posix_only = pytest.mark.skipif(os.name != "posix", reason="POSIX files")


def key_of(data):
    return hashlib.sha256(data).digest()[:16]


def path_of(folder, data):
    return folder / "cogsplat-segments" / f"{key_of(data).hex()}.segment"


def test_what_is_kept_is_what_its_name_says(tmp_path):
    cache = SegmentCache(tmp_path / "kept", 1 << 20)
    assert cache.get(key_of(b"a"), 1) is None
    cache.put(key_of(b"a"), b"a")
    assert cache.has(key_of(b"a"), 1)
    assert not cache.has(key_of(b"a"), 2)
    assert cache.get(key_of(b"a"), 1) == b"a"
    # A file that states another's hash keeps nothing.
    cache.put(key_of(b"b"), b"evil")
    assert not cache.has(key_of(b"b"), 4)
    path_of(tmp_path / "kept", b"a").write_bytes(b"b")
    assert cache.get(key_of(b"a"), 1) is None


def test_the_least_recently_used_go(tmp_path):
    cache = SegmentCache(tmp_path, 10_000)
    parts = [bytes([number]) * 1000 for number in range(30)]
    for number, part in enumerate(parts):
        cache.put(key_of(part), part)
        os.utime(path_of(tmp_path, part), (number, number))
    kept = [number for number, part in enumerate(parts) if cache.has(key_of(part), 1000)]
    assert len(kept) <= 13
    assert kept == list(range(30 - len(kept), 30))


def full_of_others(folder):
    """Put files that are not ours beside the segments, which are over the limit."""
    others = ["report.docx", "cogsplat-segments/notes.txt", "cogsplat-segments/CACHEDIR.TAG"]
    others += [f"cogsplat-segments/{key_of(b'x').hex()}", "cogsplat-segments/a.segment"]
    cache = SegmentCache(folder, 20_000)
    cache.put(key_of(b"first"), b"first")
    for name in others:
        if not (folder / name).exists():
            (folder / name).write_bytes(b"precious" * 4000)
    cut = [bytes([number]) * 5000 for number in range(30)]
    for part in cut:
        cache.put(key_of(part), part)
    assert any(not cache.has(key_of(part), 5000) for part in cut)
    return [folder / name for name in others]


def test_only_segments_are_counted_and_removed(tmp_path):
    assert all(path.exists() for path in full_of_others(tmp_path))
    # 20,000 bytes of segments, whatever lies beside them.
    segments = list((tmp_path / "cogsplat-segments").glob("????*.segment"))
    assert len(segments) >= 3


def test_a_folder_of_others_is_no_cache(tmp_path):
    (tmp_path / "cogsplat-segments").mkdir()
    (tmp_path / "cogsplat-segments/notes.txt").write_bytes(b"precious")
    cache = SegmentCache(tmp_path, 10)
    with pytest.warns(CogsplatWarning, match="is no cache of cogsplat"):
        cache.put(key_of(b"a"), b"a")
    # Said once.
    cache.put(key_of(b"b"), b"b")
    assert [path.name for path in (tmp_path / "cogsplat-segments").iterdir()] == ["notes.txt"]


@posix_only
def test_a_folder_that_is_a_link_is_no_cache(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "cogsplat-segments").symlink_to(tmp_path / "elsewhere")
    with pytest.warns(CogsplatWarning, match="are not cached"):
        SegmentCache(tmp_path, 10).put(key_of(b"a"), b"a")
    assert list((tmp_path / "elsewhere").iterdir()) == []


@posix_only
def test_links_pipes_and_large_files_under_the_names_of_segments_are_misses(tmp_path):
    cache = SegmentCache(tmp_path, 100)
    cache.put(key_of(b"first"), b"first")
    target = tmp_path / "target"
    target.write_bytes(b"a")
    path_of(tmp_path, b"a").symlink_to(target)
    os.mkfifo(path_of(tmp_path, b"b"))
    with path_of(tmp_path, b"c").open("wb") as file:
        file.truncate(3 << 30)
    path_of(tmp_path, b"d").mkdir()
    for data in (b"a", b"b", b"c", b"d"):
        assert not cache.has(key_of(data), 1)
        # Opening the pipe would wait for its other end.
        assert cache.get(key_of(data), 1) is None
    target.write_bytes(b"precious")
    with pytest.warns(CogsplatWarning, match="is a link"):
        cache.put(key_of(b"a"), b"a")
    for number in range(50):
        part = bytes([number]) * 10
        cache.put(key_of(part), part)
    # The large file is a regular one under a segment's name, and counts; the others do not.
    assert not path_of(tmp_path, b"c").exists()
    assert path_of(tmp_path, b"b").exists()
    assert target.read_bytes() == b"precious"


def test_files_that_another_process_removes_first_are_no_fault(tmp_path, monkeypatch):
    cache = SegmentCache(tmp_path, 1000)
    scandir = os.scandir

    class Removing:
        """Entries of a folder that another process empties between the listing and its use."""

        def __init__(self, path):
            self.entries = scandir(path)

        def __enter__(self):
            return self

        def __exit__(self, *exc_info):
            self.entries.close()

        def __iter__(self):
            for entry in list(self.entries):
                if entry.name.endswith(".segment"):
                    Path(entry.path).unlink()
                yield entry

    for number in range(200):
        part = bytes([number]) * 100
        cache.put(key_of(part), part)
        if number == 5:
            monkeypatch.setattr(os, "scandir", Removing)
    assert (tmp_path / "cogsplat-segments").is_dir()


_PUTS = """
import hashlib, sys
from pathlib import Path
from cogsplat.formats.network.segment_cache import SegmentCache
cache = SegmentCache(Path(sys.argv[1]), 5000)
for number in range(120):
    part = bytes([number % 256, int(sys.argv[2])]) * 200
    key = hashlib.sha256(part).digest()[:16]
    cache.put(key, part)
    found = cache.get(key, len(part))
    assert found in (None, part)
"""


def test_processes_that_share_a_small_cache_never_fail(tmp_path):
    words = [sys.executable, "-W", "error", "-c", _PUTS, str(tmp_path)]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    processes = [subprocess.Popen([*words, str(number % 2)], **pipes) for number in range(4)]
    assert [process.communicate()[0] for process in processes] == [""] * 4
    assert [process.returncode for process in processes] == [0] * 4


def test_a_folder_that_cannot_be_made_is_no_fault(tmp_path):
    tmp_path = tmp_path / "file"
    tmp_path.touch()
    cache = SegmentCache(tmp_path / "kept", 1 << 20)
    with pytest.warns(CogsplatWarning, match="are not cached"):
        cache.put(key_of(b"a"), b"a")
    assert cache.get(key_of(b"a"), 1) is None


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
