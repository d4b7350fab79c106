import dataclasses
import zlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import FormatError, UnsupportedError
from cogsplat.codec.splats import SceneInfo
from cogsplat.formats.cogs import root as cogs_root
from cogsplat.formats.cogs.canonical_msgpack import pack, unpack
from cogsplat.formats.cogs.index_tables import (
    ChunkTable,
    IndexTables,
    PageTable,
    SegmentTable,
    pack_page,
)
from cogsplat.formats.cogs.page_tree import PagePlace, read_page
from cogsplat.formats.cogs.root import CodebookEntry, Root


def segments(rows, seed=1):
    rng = np.random.default_rng(seed)
    words = rng.integers(1, 1 << 32, (4, rows), np.uint32)
    kind = rng.integers(1, 7, rows).astype(np.uint8)
    hashes = rng.integers(0, 256, (rows, 16), np.uint8)
    return SegmentTable(kind, words[0], words[1], words[2], hashes, words[3])


def chunks(rows, seed=1, *, layers=False):
    rng = np.random.default_rng(seed)
    box = np.sort(rng.normal(size=(rows, 2, 3)), axis=1).reshape(rows, 6).astype(np.float32)
    numbers = rng.integers(0, 9, (3, rows), np.uint32) if layers else np.zeros((3, rows), np.uint32)
    splats = rng.integers(1, 1000, rows).astype(np.uint32)
    quality = rng.uniform(1, 100, rows) if layers else np.zeros(rows)
    until = rng.integers(0, 9, rows, np.uint32) * layers
    return ChunkTable(splats, box, rng.random(rows), *numbers, quality.astype(np.float32), until)


def pages(rows):
    rng = np.random.default_rng(rows)
    numbers = rng.integers(1, 1 << 20, (6, rows), np.uint32)
    box = np.sort(rng.normal(size=(rows, 2, 3)), axis=1).reshape(rows, 6).astype(np.float32)
    return PageTable(
        numbers[0], numbers[1], numbers[2], numbers[2] // 3, np.full(rows, 1 << 40, np.uint64),
        numbers[3], box, rng.random(rows), numbers[4],
    )  # fmt: skip


def camera():
    rotation = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    return Camera(640, 480, 500.5, 499.5, 320.0, 240.0, rotation, np.array([1.0, 2.0, 3.0]),
                  target=np.array([4.0, 5.0, -2.5]))  # fmt: skip


def root(**changes):
    plain = Root(
        writer="test",
        splats=1000,
        sh_degree=2,
        info=SceneInfo((1e6, -2.5, 0.1), "LUF", "linear", 0.1, antialiased=True),
        box=np.array([-1.0, -2.0, -3.0, 1.0, 2.0, 3.0]),
        codebooks=[CodebookEntry("shape", 65536), CodebookEntry("colour", 1)],
        first_view=camera(),
        segments=segments(7),
        chunks=chunks(3, layers=True),
        pages=pages(2),
        up=np.array([0.0, -0.6, 0.8]),
        core_box=np.array([-1.0, -1.5, -2.0, 0.5, 0.5, 3.0]),
    )
    return dataclasses.replace(plain, **changes)


ABSENT = {"first_view": None, "up": None, "core_box": None, "pages": PageTable.zeros(0)}


def again(value):
    return cogs_root.parse_root(unpack(pack(cogs_root.root_map(value)), "root"), "root")


def assert_tables(actual, expected):
    for field in dataclasses.fields(expected):
        found, wanted = getattr(actual, field.name), getattr(expected, field.name)
        assert found.dtype == wanted.dtype
        assert np.array_equal(found, wanted), field.name


def test_roots_come_back():
    expected = root()
    actual = again(expected)
    for name in ("writer", "splats", "sh_degree", "info", "codebooks"):
        assert getattr(actual, name) == getattr(expected, name), name
    for name in ("box", "up", "core_box"):
        assert np.array_equal(getattr(actual, name), getattr(expected, name)), name
    assert_tables(actual.segments, expected.segments)
    assert_tables(actual.chunks, expected.chunks)
    assert_tables(actual.pages, expected.pages)
    assert actual.first_view is not None
    for field in dataclasses.fields(Camera):
        if field.name != "name":
            found = getattr(actual.first_view, field.name)
            assert np.array_equal(found, getattr(expected.first_view, field.name))


def test_what_is_not_there_stays_away():
    value = cogs_root.root_map(root(**ABSENT, chunks=chunks(3)))
    assert ABSENT.keys() & value.keys() == set()
    assert list(value["chunks"]) == ["splats", "box", "contribution"]
    actual = again(root(**ABSENT, chunks=chunks(3)))
    assert (actual.first_view, actual.up, actual.core_box, len(actual.pages)) == (
        None, None, None, 0
    )  # fmt: skip
    assert not actual.chunks.layer.any()


def test_tables_of_no_rows():
    actual = again(root(segments=SegmentTable.zeros(0), chunks=chunks(0)))
    assert (len(actual.segments), len(actual.chunks)) == (0, 0)
    assert actual.segments.hash.shape == (0, 16)
    assert actual.chunks.box.shape == (0, 6)


def test_pages_are_checked_against_their_row():
    tables = IndexTables(segments(4), chunks(2), pages(2))
    data = pack_page(tables)
    place = PagePlace((0,), 500, len(data), zlib.crc32(data), tables.extent, 7, 3, False)
    index = read_page(place, data, "file")
    for name in ("segments", "chunks", "pages"):
        assert_tables(getattr(index.tables, name), getattr(tables, name))
    first, second = index.pages()
    assert first.start == 500 + len(data) + int(tables.segments.length.sum(dtype=np.uint64))
    assert second.start == first.end
    assert (first.first_segment, first.first_chunk) == (11, 5)
    assert second.first_chunk == 5 + first.extent.chunks
    for name in ("segments", "chunks", "span", "splats"):
        extent = dataclasses.replace(tables.extent, **{name: getattr(tables.extent, name) + 1})
        with pytest.raises(FormatError) as caught:
            read_page(dataclasses.replace(place, extent=extent), data, "file")
        assert caught.value.code == "page-entry"
    with pytest.raises(FormatError) as caught:
        read_page(dataclasses.replace(place, path=(0, 0, 0)), data, "file")
    assert caught.value.code == "root-value"


TYPES = [None, True, 0, -1, 1 << 40, 0.5, "x", b"xyz", [], [0.0] * 3, {}, {"a!": 1}]


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_any_value_in_any_place_is_read_or_refused(data):
    value = cogs_root.root_map(root())
    place = value
    while True:
        key = data.draw(st.sampled_from(sorted(place)))
        inner = place[key]
        if isinstance(inner, list) and inner and isinstance(inner[0], dict):
            inner = inner[0]
        if isinstance(inner, dict) and data.draw(st.booleans()):
            place = inner
            continue
        if data.draw(st.booleans()):
            del place[key]
        else:
            place[key] = data.draw(st.sampled_from(TYPES))
        break
    refusal = None
    try:
        cogs_root.parse_root(unpack(pack(value), "root"), "root")
    except (FormatError, UnsupportedError) as error:
        refusal = error
    if refusal is not None:
        assert refusal.code.startswith(("root-", "codebook-unknown", "colour-space-unknown"))
        assert refusal.message.startswith("root")
