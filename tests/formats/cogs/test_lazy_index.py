"""Files of many index pages over a network: opened by the root, pages read as they are needed."""

from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest
from cogs_samples import assert_same, encoded
from fault_server import FaultServer, serving

import cogsplat
from cogsplat.codec.errors import FormatError
from cogsplat.formats.cogs import scene_writer as cogs
from cogsplat.formats.cogs.known_chunks import known_chunks
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.lazy_index import LazyIndex
from cogsplat.formats.cogs.scene_index import read_root, read_scene_index
from cogsplat.formats.cogs.writer import lay_out
from cogsplat.formats.storage.source import BytesSource
from cogsplat.tools.lab.conformance import valid

COPIES = 300


@cache
def file_of_copies(profile="vq", tails_last=False):
    """Return a file of several pages: a scene's chunks many times over."""
    made = encoded(profile)
    root, segments = cogs.build_root(made, "samples"), cogs.segments(made)
    chunks = len(root.chunks)
    own = {SegmentKind.HEAD, SegmentKind.TAIL, SegmentKind.REFINEMENT}
    shared = [part for part in segments if part.kind not in own]
    parts = [
        replace(part, owner=part.owner + copy * chunks)
        for copy in range(COPIES)
        for part in segments
        if part.kind in own
    ]
    parts.sort(key=lambda part: (tails_last and part.kind == SegmentKind.TAIL, part.owner))
    table = type(root.chunks)(
        *(np.concatenate([getattr(root.chunks, f.name)] * COPIES) for f in fields(root.chunks))
    )
    many = replace(root, splats=root.splats * COPIES, chunks=table)
    return b"".join(lay_out(many, [*shared, *parts]))


@pytest.fixture(params=[False, True], ids=["together", "tails-last"])
def data(request):
    return file_of_copies(tails_last=request.param)


def test_opening_reads_the_root_alone(data):
    with serving(FaultServer(data)) as server, cogsplat.open(server.url()) as file:
        assert len(file.root.pages) > 2
        assert file.num_chunks == file.complete_chunks() == len(cogsplat.open(data).chunks)
        assert [(asked.first, asked.end) for asked in server.asked] == [(0, 65536)]


def test_a_chunk_takes_its_page_and_its_segments():
    data = file_of_copies()
    last = cogsplat.open(data).num_chunks - 1
    with serving(FaultServer(data)) as server:
        for chunk in (0, last // 2, last):
            with cogsplat.open(server.url()) as file:
                found = file.decode([chunk])
                assert file.traffic.requests <= 3
                assert file.traffic.received_bytes < len(data) // 3
            assert_same(found, cogsplat.open(data).decode([chunk]))


def test_chunks_of_several_pages_are_those_of_a_local_file(data):
    local = cogsplat.open(data)
    chunks = [local.num_chunks - 3, 1, local.num_chunks // 3]
    with serving(FaultServer(data)) as server, cogsplat.open(server.url()) as file:
        assert_same(file.decode(chunks), local.decode(chunks))
        assert_same(
            file.decode(chunks, sh_degree=0, refine=False),
            local.decode(chunks, sh_degree=0, refine=False),
        )
        parts = list(file.decode_parts(chunks, max_splats=1))
        assert_same(parts[2], local.decode(chunks[2:]))
        with file.stream(priority=lambda chunk: 1.0 if chunk == 7 else -1.0) as updates:
            assert_same(list(updates)[-1].splats, local.decode([7]))


def test_tables_are_those_of_the_whole_index(data):
    whole = read_scene_index(BytesSource(data), partial=False)
    with serving(FaultServer(data)) as server, cogsplat.open(server.url()) as file:
        file.decode([4])
        for name in ("segments", "chunks"):
            ours, theirs = getattr(file, name), getattr(whole, name)
            for column in fields(theirs):
                assert np.array_equal(getattr(ours, column.name), getattr(theirs, column.name))
        assert np.array_equal(file.offsets, whole.offsets)
        assert isinstance(file._pages, LazyIndex)
        index = file._pages.whole()
        for name in ("heads", "tails", "refinements", "attributes"):
            assert np.array_equal(getattr(index, name), getattr(whole, name))
        assert (index.cameras, list(index.layers)) == (whole.cameras, list(whole.layers))
        assert index.codebooks == whole.codebooks
        assert file.select(splats=1000) == cogsplat.open(data).select(splats=1000)
        assert_same(file.decode(), cogsplat.open(data).decode())


def test_a_damaged_page_is_found_when_it_is_read():
    data = file_of_copies()
    position = cogsplat.open(data)
    index = read_scene_index(BytesSource(data), partial=False)
    second = int(index.offsets[len(index.root.segments)]) - 1
    broken = data[:second] + bytes([data[second] ^ 1]) + data[second + 1 :]
    last = position.num_chunks - 1
    with serving(FaultServer(broken)) as server, cogsplat.open(server.url()) as file:
        assert_same(file.decode([last]), position.decode([last]))
        first_of_page = len(index.root.chunks)
        with pytest.raises(FormatError) as caught:
            file.decode([first_of_page])
        assert caught.value.code == "page-crc"


def test_chunks_that_are_not_there_are_misuse():
    data = file_of_copies()
    with (
        serving(FaultServer(data)) as server,
        cogsplat.open(server.url()) as file,
        pytest.raises(ValueError, match="expected 0 to"),
    ):
        file.decode([file.num_chunks])


def test_an_unread_page_counts_as_one_chunk():
    data = next(v.data for v in valid.valid() if v.name == "pages-tree")
    source = BytesSource(data)
    lazy = LazyIndex(source, read_root(source, partial=False))
    known = known_chunks(lazy.for_chunks([0]))
    assert known.numbers.tolist() == [0, 1, 5, 6]
    assert [page and page.path for page in known.pages] == [None, (0,), (1,), (2,)]
    assert known.splats.tolist() == [5, 6 + 7 + 8 + 9, 4, 3]
    assert known.parents.tolist() == [-1, 0, 0, 0]
    # Chunk 4 is below the second page of the first page.
    known = known_chunks(lazy.for_chunks([4]))
    assert known.numbers.tolist() == [0, 1, 2, 4, 5, 6]
    assert known.cells.tolist() == [1, 2, 4, 5, 3, 3]
    assert known.parents.tolist() == [-1, 0, 1, 1, 0, 0]
    assert known_chunks(lazy.whole()).pages == [None] * 7
