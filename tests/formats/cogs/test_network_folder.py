"""Folders on a network: the same scene as the file, with ranges and without, whole or in part."""

from pathlib import Path

import pytest
from cogs_samples import assert_same, file_of
from fault_server import (
    Exchange,
    Fault,
    FaultServer,
    broken_after,
    no_ranges,
    right,
    serving,
    status,
)

import cogsplat
from cogsplat.codec.errors import CogsplatError, FormatError, TruncatedError
from cogsplat.formats.cogs.description_json import to_json
from cogsplat.formats.cogs.folder_map import FolderMap
from cogsplat.formats.cogs.network_folder import NetworkFolder
from cogsplat.formats.cogs.open_file import open_source
from cogsplat.formats.network.network_options import NetworkOptions
from cogsplat.tools.lab.conformance.reference_folders import MANIFEST, folder_of_file

VALID = Path(__file__).resolve().parents[2] / "vectors" / "valid"
PAGED = VALID / "pages.cogs"
DESCRIBED = VALID / "description.cogs"
QUICK = NetworkOptions(pause_seconds=0.001, retries=2)


@pytest.fixture(scope="module")
def data() -> bytes:
    return file_of("vq", 6000, 3, 500)


def of_folder(objects: dict[str, bytes], answered: Fault = right) -> Fault:
    """RangeResponse for the objects of a folder by their paths, with 404 for others."""

    async def fault(exchange: Exchange) -> None:
        name = exchange.asked.path.partition("?")[0].removeprefix("/scene/")
        if name not in objects:
            await status(404)(exchange)
            return
        exchange.server.data = objects[name]
        await answered(exchange)

    return fault


@pytest.mark.parametrize("answered", [right, no_ranges])
def test_a_folder_reads_as_its_file(data: bytes, answered: Fault) -> None:
    objects = folder_of_file(data)
    with serving(FaultServer(b"", always=of_folder(objects, answered))) as server:
        for url in (server.url("scene/"), server.url(f"scene/{MANIFEST}")):
            source = open_source(url)
            assert isinstance(source, NetworkFolder)
            assert source.read(0, source.size) == data
            assert source.read(1000, 70_000) == data[1000:71_000]
            source.close()
        with cogsplat.open(server.url("scene/")) as file:
            assert_same(file.decode(), cogsplat.decode(data))
            file.verify()


def test_one_chunk_takes_the_objects_that_it_needs(data: bytes) -> None:
    with serving(FaultServer(b"", always=of_folder(folder_of_file(data)))) as server:
        with cogsplat.open(server.url("scene/?key=1")) as file:
            file.decode([7], sh_degree=0)
            assert file.traffic is not None
            traffic = file.traffic
        asked = [asked.path for asked in server.asked]
    assert all(path.endswith("?key=1") for path in asked)
    # The manifest and the head.
    assert len(set(asked)) == len(asked) == traffic.requests == 2
    with cogsplat.open(data) as whole:
        lengths = whole.segments.length
        wanted = int(lengths[whole.chunk_rows(7).head])
        fine = whole.chunk_rows(7).refinement
        wanted += 0 if fine is None else int(lengths[fine])
    # Of the objects no more than that: tails and codebooks of colours lie in them too.
    assert traffic.received_bytes == len(folder_of_file(data)[MANIFEST]) + wanted
    assert traffic.received_bytes < sum(map(len, folder_of_file(data).values())) / 2


def test_manifests_of_another_length_are_refused() -> None:
    objects = folder_of_file(PAGED.read_bytes())
    for answered in (right, no_ranges):
        for change, code in ((-1, "file-truncated"), (1, "file-trailing")):
            manifest = (objects[MANIFEST] + b"x")[: len(objects[MANIFEST]) + change]
            with (
                serving(
                    FaultServer(b"", always=of_folder(objects | {MANIFEST: manifest}, answered))
                ) as server,
                pytest.raises(FormatError) as refused,
            ):
                open_source(server.url("scene/"), QUICK)
            assert refused.value.code == code


def test_each_page_is_asked_for_once_and_opening_asks_for_no_object() -> None:
    data = PAGED.read_bytes()
    objects = folder_of_file(data)
    found = FolderMap(objects[MANIFEST], "pages")
    pages = {found.page_range(page).name for page in found.pages_for(0, len(data))}
    with serving(FaultServer(b"", always=of_folder(objects))) as server:
        url = server.url(f"scene/{MANIFEST}")
        with (
            NetworkFolder(url, objects[MANIFEST], QUICK) as source,
            cogsplat.open(source) as file,
        ):
            assert server.asked == []
            file.decode([file.num_chunks - 1])
            chunk = [(asked.path, asked.first) for asked in server.asked]
            assert source.traffic.requests == 1 + len(chunk)
            file.decode()
        asked = [asked.path.removeprefix("/scene/") for asked in server.asked]
    assert len(chunk) == len(set(chunk))
    assert MANIFEST not in asked
    assert sorted(name for name in asked if name in pages) == sorted(pages)


def test_a_description_comes_with_the_manifest() -> None:
    data = DESCRIBED.read_bytes()
    objects = folder_of_file(data)
    with serving(FaultServer(b"", always=of_folder(objects))) as server:
        with cogsplat.open(server.url("scene/")) as file, cogsplat.open(data) as whole:
            found, expected = file.description(), whole.description()
            assert found is not None
            assert expected is not None
            assert to_json(found) == to_json(expected)
        assert {asked.path for asked in server.asked} == {f"/scene/{MANIFEST}"}


def test_a_description_damaged_on_the_way_is_asked_for_again() -> None:
    objects = folder_of_file(DESCRIBED.read_bytes())
    manifest = objects[MANIFEST]
    damaged = manifest[:-1] + bytes([manifest[-1] ^ 1])
    # The description is the last of the manifest.
    with serving(FaultServer(b"", always=of_folder(objects))) as server:
        url = server.url(f"scene/{MANIFEST}")
        with NetworkFolder(url, damaged, QUICK) as source, cogsplat.open(source) as file:
            assert file.description() is not None
            assert file.description_row is not None
            length = int(file.segments.length[file.description_row])
        (asked,) = server.asked
    assert (asked.path, asked.first) == (f"/scene/{MANIFEST}", len(manifest) - length)


def test_an_object_that_is_missing_spoils_no_other(data: bytes) -> None:
    objects = folder_of_file(data)
    with cogsplat.open(data) as whole:
        rows = [whole.chunk_rows(9).head, whole.chunk_rows(10).head]
        places = [(int(whole.offsets[row]), int(whole.segments.length[row])) for row in rows]
        found = FolderMap(objects[MANIFEST], "whole")
        gone, wrong = (found.object_ranges(*place)[0].name for place in places)
        expected = whole.decode([8, 11])
    broken = {name: x for name, x in objects.items() if name != gone}
    broken[wrong] += b"\0"
    with (
        serving(FaultServer(b"", always=of_folder(broken))) as server,
        cogsplat.open(server.url("scene/")) as file,
    ):
        with pytest.raises(TruncatedError, match=gone) as missing:
            file.decode([9])
        assert missing.value.code == "segment-missing"
        with pytest.raises(FormatError, match=wrong) as longer:
            file.decode([10])
        assert longer.value.code == "segment-object"
        assert_same(file.decode([8, 11]), expected)


def test_answers_that_break_off_are_asked_for_again() -> None:
    data = PAGED.read_bytes()
    objects = folder_of_file(data)
    fail = iter(range(1000))

    async def sometimes(exchange: Exchange) -> None:
        which = next(fail) % 3
        await (broken_after(100), status(503), right)[which](exchange)

    with serving(FaultServer(b"", always=of_folder(objects, sometimes))) as server:
        options = NetworkOptions(pause_seconds=0.001, retries=12)
        url = server.url(f"scene/{MANIFEST}")
        with NetworkFolder(url, objects[MANIFEST], options) as source:
            assert source.read(0, source.size) == data


def test_what_is_no_manifest_is_said(data: bytes) -> None:
    page = {MANIFEST: b"<!doctype html>" + bytes(200)}
    with serving(FaultServer(b"", always=of_folder(page))) as server:
        with pytest.raises(FormatError, match="markup") as refused:
            cogsplat.open(server.url("scene/"))
        assert refused.value.code == "not-cogs"
        with pytest.raises(CogsplatError) as gone:
            cogsplat.open(server.url("nothing/"))
        assert gone.value.code == "not-found"
