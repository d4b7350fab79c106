"""Whole examinations: a right server, one without ranges, damaged scenes, folders."""

from pathlib import Path

from fault_server import Exchange, FaultServer, no_ranges, right, serving, status
from running import SmallScene

import cogsplat
from cogsplat.formats.cogs.folder_writer import unpack_cogs
from cogsplat.tools.hosting.doctor import diagnose


def codes(url: str, **options: bool) -> tuple[set[str], list[str]]:
    found = diagnose(url, **options)  # type: ignore[arg-type]
    return {x.code for x in found.host}, [x.code for x in found.content]


def test_a_file_is_examined_and_read(small: SmallScene) -> None:
    data = small.cogs.read_bytes()
    with serving(FaultServer(data)) as server:
        found = diagnose(server.url())
        assert (found.folder, found.content, found.content_read) == (False, [], True)
        assert found.first_chunk_s is not None
        assert {x.code for x in found.host} >= {"cors-origin", "cache-missing"}
        asked = len(server.asked)
        quick = diagnose(server.url(), content=False)
        assert not quick.content_read
        assert len(server.asked) - asked < asked


def test_faults_of_the_scene_are_findings(small: SmallScene) -> None:
    data = bytearray(small.cogs.read_bytes())
    data[-1] ^= 1
    with serving(FaultServer(bytes(data))) as server:
        assert codes(server.url())[1] == ["segment-crc"]
    with serving(FaultServer(bytes(data[:-10]))) as server:
        host, content = codes(server.url())
        assert "http-length" in host
        assert "file-truncated" in content
    with serving(FaultServer(b"<!doctype html>" + bytes(9000))) as server:
        assert codes(server.url())[1] == ["not-cogs"]
    with serving(FaultServer(bytes(data), always=status(404))) as server:
        assert codes(server.url()) == ({"http-status"}, [])


def test_a_host_without_ranges_is_read_and_reported(small: SmallScene) -> None:
    with serving(FaultServer(small.cogs.read_bytes(), always=no_ranges)) as server:
        host, content = codes(server.url())
        assert "http-ranges-ignored" in host
        assert content == []


def test_folders_are_examined_by_an_object(small: SmallScene, tmp_path: Path) -> None:
    with cogsplat.open(small.cogs) as file:
        unpack_cogs(file, tmp_path / "scene")
    largest = max((tmp_path / "scene" / "segments").iterdir(), key=lambda x: x.stat().st_size)

    async def from_disk(exchange: Exchange) -> None:
        path = tmp_path / exchange.asked.path.lstrip("/")
        if not path.is_file():
            await status(404)(exchange)
            return
        exchange.server.data = path.read_bytes()
        await (right if "range" in exchange.asked.headers else no_ranges)(exchange)

    with serving(FaultServer(b"", always=from_disk)) as server:
        found = diagnose(server.url("scene/"))
        assert (found.folder, found.content) == (True, [])
        assert "cache-immutable" in {x.code for x in found.host}
        largest.unlink()
        assert set(codes(server.url("scene/manifest.cogsm"))[1]) == {"segment-missing"}
