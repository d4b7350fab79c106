import io
from pathlib import Path

import pytest
from cogs_samples import assert_same, file_of
from fault_server import FaultServer, right, serving

import cogsplat
from cogsplat.codec.errors import FormatError, StorageError
from cogsplat.formats.cogs.folder_source import FolderSource
from cogsplat.formats.cogs.folder_writer import unpack_cogs
from cogsplat.formats.cogs.open_file import open_scene, open_source, with_open_scene
from cogsplat.formats.network.range_source import RangeSource
from cogsplat.formats.storage.source import BytesSource, FileSource


@pytest.fixture(scope="module")
def data():
    return file_of("vq", 6000, 3, 500)


def test_paths_and_urls(data, tmp_path):
    (tmp_path / "a.cogs").write_bytes(data)
    source = open_source(tmp_path / "a.cogs")
    assert isinstance(source, FileSource)
    source.close()
    with serving(FaultServer(data)) as server:
        source = open_source(server.url())
        assert isinstance(source, RangeSource)
        source.close()


def test_a_url_gives_the_same_as_a_file(data, kernels):
    whole = cogsplat.decode(data)
    with serving(FaultServer(data)) as server:
        assert_same(cogsplat.decode(server.url()), whole)
        with cogsplat.open(server.url()) as file:
            assert_same(file.decode([2, 0]), cogsplat.open(data).decode([2, 0]))
            assert_same(cogsplat.open(data).decode(threads=2), whole)
            parts = list(file.decode_parts(max_splats=1000))
            assert sum(len(part) for part in parts) == len(whole)
            assert_same(next(iter(file.iter_chunks())), parts[0], slice(500))
        with cogsplat.open(server.url(), size_bytes=len(data) // 2) as file:
            assert_same(file.decode(), cogsplat.decode(data, size_bytes=len(data) // 2))


def test_a_whole_scene_takes_its_bytes_once_and_few_requests(data):
    with serving(FaultServer(data)) as server, cogsplat.open(server.url()) as file:
        assert file.traffic.requests == 1
        file.decode()
        assert file.traffic.requests <= 4
        assert file.traffic.received_bytes <= len(data)
    with cogsplat.open(data) as file:
        assert file.traffic is None


def test_an_index_that_came_damaged_is_fetched_once_more(data):
    async def damaged(exchange):
        exchange.server.data, kept = data[:100] + b"??" + data[102:], exchange.server.data
        await right(exchange)
        exchange.server.data = kept

    with serving(FaultServer(data, [damaged])) as server:
        with open_scene(server.url()) as file:
            assert file.root.splats == 6000
        assert "cache-control" not in server.asked[0].headers
        assert server.asked[1].headers["cache-control"] == "no-cache"
    with serving(FaultServer(data, always=damaged)) as server, pytest.raises(FormatError) as caught:
        open_scene(server.url())
    assert caught.value.code == "root-crc"
    assert len(server.asked) == 2


def test_an_open_file_that_changes_says_so(data):
    with serving(FaultServer(data)) as server, cogsplat.open(server.url()) as file:
        server.data = file_of("vq", 5000, 3, 500)
        with pytest.raises(StorageError, match="changed while it was read") as caught:
            file.decode()
    assert caught.value.code == "source-changed"


def test_damaged_segments_are_fetched_once_more(data):
    async def stale(exchange):
        fresh = "cache-control" in exchange.asked.headers
        await right(exchange) if fresh else await damaged(exchange)

    async def damaged(exchange):
        part = exchange.part[:-1] + bytes([exchange.part[-1] ^ 1])
        await exchange.send(206, exchange.stated(), part)

    with serving(FaultServer(data, [right], stale)) as server, cogsplat.open(server.url()) as file:
        assert_same(file.decode(), cogsplat.decode(data))
        assert file.traffic.requests < 8


def test_what_is_done_with_a_place_is_done_twice_at_most(data):
    done = []

    def work(file):
        done.append(file)
        raise StorageError("source-changed", "again")

    with serving(FaultServer(data)) as server, pytest.raises(StorageError):
        with_open_scene(work, server.url())
    assert len(done) == 2
    with pytest.raises(StorageError):
        with_open_scene(work, data)
    assert len(done) == 3


def test_paths_are_files_folders_or_manifests(tmp_path: Path) -> None:
    data = file_of("vq")
    path, folder = tmp_path / "a.cogs", tmp_path / "a"
    path.write_bytes(data)
    with cogsplat.open(path) as file:
        unpack_cogs(file, folder)
    for given, kind in {
        path: FileSource,
        folder: FolderSource,
        folder / "manifest.cogsm": FolderSource,
    }.items():
        for form in (given, str(given)):
            source = open_source(form)
            assert isinstance(source, kind)
            assert source.size == len(data)
            source.close()
    own = BytesSource(data)
    assert open_source(own) is own
    assert open_source(io.BytesIO(data)).read(0, 8) == data[:8]


def test_folders_without_a_manifest_are_refused(tmp_path: Path) -> None:
    with pytest.raises(StorageError) as refused:
        open_source(tmp_path)
    assert refused.value.code == "not-found"
    (tmp_path / "manifest.cogsm").write_bytes(b"ply" + bytes(100))
    with pytest.raises(FormatError, match="a PLY file") as broken:
        open_source(tmp_path)
    assert broken.value.code == "not-cogs"
