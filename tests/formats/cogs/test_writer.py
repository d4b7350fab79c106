import dataclasses
import hashlib
import zlib

import numpy as np
import pytest

from cogsplat.codec.errors import DataError, StorageError
from cogsplat.codec.partition.chunk_tree import chunk_tree
from cogsplat.codec.partition.nested_cells import parents
from cogsplat.codec.segments.attributes import AttributeType
from cogsplat.codec.segments.view_shares import ViewTable
from cogsplat.codec.splats import SceneInfo
from cogsplat.formats.cogs import layout, writer
from cogsplat.formats.cogs import root as cogs_root
from cogsplat.formats.cogs.index_tables import ChunkTable, SegmentTable
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.reader import open_cogs
from cogsplat.formats.cogs.root import Root
from cogsplat.formats.cogs.scene_index import read_scene_index
from cogsplat.formats.cogs.segment_rows import CHUNK_KINDS
from cogsplat.formats.cogs.view_table_segment import pack_view_table
from cogsplat.formats.cogs.writer import Segment, lay_out, write_cogs
from cogsplat.formats.storage.source import BytesSource


def root(count, degree=1, *, layers=False, **changes):
    numbers = np.arange(count, dtype=np.uint32)
    none = np.zeros(count, np.uint32)
    extra = numbers + 1 if layers else none
    box = np.tile(np.array([-1, -1, -1, 1, 1, 1], np.float32), (count, 1))
    quality = extra.astype(np.float32) % 100
    falling = numbers[::-1].astype(np.float64)
    table = ChunkTable(none + 2, box, falling, extra, extra, extra, quality, none)
    plain = Root(
        "writer",
        2 * count,
        degree,
        SceneInfo(),
        np.zeros(6),
        [],
        None,
        SegmentTable.zeros(0),
        table,
    )
    return dataclasses.replace(plain, **changes)


def parts(count, tails=True):
    """Heads, each with its tail three heads later: what the container does not look into."""
    out = []
    for chunk in range(count):
        out.append(Segment(SegmentKind.HEAD, chunk, b"h%d" % chunk))
        if tails and chunk >= 3:
            out.append(Segment(SegmentKind.TAIL, chunk - 3, b"tail %d" % (chunk - 3)))
    return out


def index_of(data):
    return read_scene_index(BytesSource(data), partial=False)


def check(data, root_given, segments):
    """Read a file back and compare all that was given."""
    index = index_of(data)
    # Each index lists the segments of its chunks, the root all others, in the order given.
    starts = [each.first_chunk for each in index.indices]

    def number_of_index(segment):
        if segment.kind not in CHUNK_KINDS:
            return 0
        return int(np.searchsorted(starts, segment.owner, side="right")) - 1

    segments = sorted(segments, key=number_of_index)
    assert len(index.segments) == len(segments)
    assert index.segments.kind.tolist() == [s.kind for s in segments]
    assert index.segments.owner.tolist() == [s.owner for s in segments]
    for row, segment in enumerate(segments):
        start = int(index.offsets[row])
        found = data[start : start + int(index.segments.length[row])]
        assert found == segment.payload
        assert zlib.crc32(found) == index.segments.crc[row]
        assert hashlib.sha256(found).digest()[:16] == index.segments.hash[row].tobytes()
        assert index.segments.needs[row] == sum(1 << need for need in segment.needs)
    for name in ("splats", "box", "contribution", "layer", "cell", "object", "quality"):
        assert np.array_equal(getattr(index.chunks, name), getattr(root_given.chunks, name))
    assert index.all_chunks == len(root_given.chunks)
    root_length = len(data) - len(data[64:])
    assert root_length == 64
    assert 64 + int.from_bytes(data[12:16], "little") <= layout.MAX_ROOT_END
    assert int.from_bytes(data[16:24], "little") == len(data)
    return index


@pytest.mark.parametrize("layers", [False, True])
@pytest.mark.parametrize("count", [0, 1, 5, 90])
def test_a_small_file_has_no_pages(count, layers):
    made = root(count, layers=layers)
    data = b"".join(lay_out(made, parts(count)))
    assert check(data, made, parts(count)).indices[1:] == []


@pytest.mark.parametrize("count", [400, 2000])
def test_a_large_file_has_pages_and_a_root_of_16_kib(count):
    made = root(count, layers=True)
    data = b"".join(lay_out(made, parts(count)))
    index = check(data, made, parts(count))
    assert 1 <= len(index.root.pages) <= 8
    assert index.root.pages.length.max() <= 65536


def test_every_count_around_the_first_page():
    """The root fills up, one row too many opens a page, and nothing is lost on the way."""
    seen = set()
    for count in range(120, 230):
        made = root(count, degree=0)
        data = b"".join(lay_out(made, parts(count, tails=False)))
        index = check(data, made, parts(count, tails=False))
        seen.add(len(index.root.pages))
        if count > 190:
            room = layout.MAX_ROOT_END - 64 - int.from_bytes(data[12:16], "little")
            assert room < 3600
    assert seen == {0, 1}


def test_every_count_around_the_second_page(monkeypatch):
    monkeypatch.setattr(writer, "_PAGE_TARGET", 2048)
    pages = []
    for count in range(180, 260):
        made = root(count, degree=0)
        data = b"".join(lay_out(made, parts(count, tails=False)))
        index = check(data, made, parts(count, tails=False))
        pages.append(len(index.root.pages))
        assert (index.root.pages.length <= 2048).all()
    assert pages == sorted(pages)
    assert {0, 1, 2, 3} <= set(pages)


def test_many_segments_make_larger_pages_not_more():
    count = 120_000
    segments = [Segment(SegmentKind.HEAD, chunk, b"x") for chunk in range(count)]
    made = root(count, degree=0)
    index = index_of(b"".join(lay_out(made, segments)))
    assert 64 < len(index.root.pages) <= layout.MAX_PAGES
    assert index.root.pages.length.max() <= layout.MAX_PAGE_BYTES
    assert len(index.chunks) == count


def test_a_long_first_view_and_codebooks_leave_less_room():
    entries = [cogs_root.CodebookEntry("shape", 100)] * 32
    books = [Segment(SegmentKind.SHAPE_CODEBOOK, i, b"book", ()) for i in range(32)]
    made = root(300, degree=0, writer="w" * 255, codebooks=entries)
    segments = [*books, *parts(300, tails=False)]
    data = b"".join(lay_out(made, segments))
    assert len(check(data, made, segments).root.pages)


def test_segments_of_unknown_kinds_can_be_written():
    segments = [*parts(2), Segment(200, 9, b"skip me")]
    made = root(2)
    check(b"".join(lay_out(made, segments)), made, segments)


@pytest.mark.parametrize(
    "changes",
    [
        {"info": SceneInfo(axes="XYZ")},
        {"info": SceneInfo(colour_space="cmyk")},
        {"info": SceneInfo(kernel_px=-1.0)},
        {"info": SceneInfo(origin=(0.0, float("nan"), 0.0))},
        {"writer": "x" * 256},
        {"sh_degree": 4},
        {"box": np.array([1.0, 0, 0, 0, 0, 0])},
    ],
)
def test_what_no_reader_accepts_is_not_written(tmp_path, changes):
    with pytest.raises(DataError) as caught:
        write_cogs(root(2, **changes), parts(2), tmp_path / "a.cogs")
    assert caught.value.code == "bad-scene-info"
    assert list(tmp_path.iterdir()) == []


def test_too_many_segments_are_misuse(monkeypatch):
    monkeypatch.setattr(layout, "MAX_SEGMENTS", 4)
    with pytest.raises(ValueError, match="at most 4"):
        lay_out(root(4), parts(4))


def test_files_are_written_whole_and_replaced_only_when_told(tmp_path):
    path = tmp_path / "a.cogs"
    size = write_cogs(root(3), parts(3), path)
    data = path.read_bytes()
    assert size == len(data)
    assert data == b"".join(lay_out(root(3), parts(3)))
    with pytest.raises(StorageError) as caught:
        write_cogs(root(4), parts(4), path)
    assert caught.value.code == "exists"
    assert path.read_bytes() == data
    write_cogs(root(4), parts(4), path, force=True)
    assert path.read_bytes() != data
    assert [p.name for p in tmp_path.iterdir()] == ["a.cogs"]


def cells_of(count):
    """Cells of a binary tree in the order of the pages."""
    cells = np.arange(1, count + 1, dtype=np.uint32)
    return cells[chunk_tree(cells).order()]


def cut_root(count):
    made = root(count)
    return dataclasses.replace(made, chunks=dataclasses.replace(made.chunks, cell=cells_of(count)))


@pytest.mark.parametrize("count", [65, 400, 9000])
def test_pages_of_a_cut_scene_follow_its_cells(count):
    made = cut_root(count)
    index = check(b"".join(lay_out(made, parts(count))), made, parts(count))
    assert len(index.indices) == 1 or len(index.root.chunks) == 64
    for each in index.indices[1:]:
        above = index.at(each.path[:-1])
        row = each.path[-1]
        below = slice(each.first_chunk, each.first_chunk + each.tables.extent.chunks)
        cells = index.chunks.cell[below].tolist()
        cell = int(above.tables.pages.cell[row])
        assert all(cell in [each >> k for k in range(32)] for each in cells)
        assert above.tables.pages.contribution[row] == index.chunks.contribution[below].sum()
    found = parents(index.chunks.cell, index.subtrees)
    assert (index.chunks.cell[found[1:]] == index.chunks.cell[1:] // 2).all()


def test_a_root_that_cannot_list_its_chunks_leaves_some_to_a_first_page():
    made = dataclasses.replace(cut_root(400), attributes=[AttributeType("x" * 250, "u1", 0)] * 30)
    with pytest.raises(DataError):
        lay_out(made, parts(400))
    kinds = [AttributeType(f"{i:0250}", "u1", 0) for i in range(30)]
    made = dataclasses.replace(made, attributes=kinds)
    index = check(b"".join(lay_out(made, parts(400))), made, parts(400))
    assert 0 < len(index.root.chunks) < 64
    assert len(index.root.chunks) + int(index.root.pages.chunks[0]) == 64


def test_view_tables_are_split_over_the_indices():
    count = 400
    made = cut_root(count)
    rng = np.random.default_rng(3)
    codes = rng.integers(1, 240, (3, count), np.uint8)
    codes[1, 64:] = 0
    table = ViewTable(np.ones((3, 3), np.float32), codes)
    given = [*parts(count)[:1], Segment(131, 0, pack_view_table(table)), *parts(count)[1:]]
    data = b"".join(lay_out(made, given))
    with open_cogs(BytesSource(data)) as file:
        assert file.segments.kind[1] == SegmentKind.VIEW_TABLE
        for each in file.indices:
            own = slice(each.first_chunk, each.first_chunk + len(each.tables.chunks))
            found = file.view_table(each.path)
            assert found.codes[:, : own.stop - own.start].tolist() == codes[:, own].tolist()
            for row, page in enumerate(each.pages(), start=own.stop - own.start):
                below = slice(page.first_chunk, page.first_chunk + page.extent.chunks)
                sums = table.shares[:, below].sum(axis=1)
                np.testing.assert_allclose(found.shares[:, row], sums, rtol=0.26)
