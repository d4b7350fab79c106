"""An index of 10^9 splats: a client at one place reads the pages on the way there alone."""

import zlib
from bisect import bisect_right

import numpy as np

from cogsplat.codec.partition.chunk_tree import chunk_tree
from cogsplat.codec.splats import SceneInfo
from cogsplat.formats.cogs import layout
from cogsplat.formats.cogs.index_tables import ChunkTable, SegmentTable
from cogsplat.formats.cogs.lazy_index import LazyIndex
from cogsplat.formats.cogs.root import Root
from cogsplat.formats.cogs.scene_index import read_root
from cogsplat.formats.cogs.writer import lay_out_index, plan_index

# As in cities in parts, whose chunks are smaller than those of other files.
_SPLATS = 2048
_CHUNKS = 10**9 // _SPLATS
_LENGTHS = (10_000, 6_000, 4_000)


class IndexOnly:
    """Source that has root and pages of a file, counts what is read, and has no segments."""

    name = "city"

    def __init__(self, parts, lengths):
        self.starts, self.data = [], []
        self.size = 0
        for part in parts:
            self.starts.append(self.size)
            self.data.append(part.index)
            self.size += len(part.index) + int(lengths[part.rows].sum())
        self.asked = []

    def read(self, offset, length):
        self.asked.append((offset, length))
        at = bisect_right(self.starts, offset) - 1
        first = offset - self.starts[at]
        found = self.data[at][first : first + length]
        # The first request goes beyond the root, into segments.
        return found.ljust(length, b"\0") if not offset else found

    def close(self):
        """Do nothing."""


def city():
    """Root and segment table of a balanced city; chunks of the layers halve their cells."""
    depth = _CHUNKS.bit_length() - 1
    cells = np.concatenate([np.arange(1 << level, 2 << level) for level in range(depth)])
    cells = np.concatenate([cells, np.arange(1 << depth, 2 << depth)])[:_CHUNKS]
    cells = cells[chunk_tree(cells).order()]
    rng = np.random.default_rng(5)
    low = rng.normal(size=(_CHUNKS, 3)).astype(np.float32)
    none = np.zeros(_CHUNKS, np.uint32)
    chunks = ChunkTable(
        none + _SPLATS,
        np.concatenate([low, low + 1], axis=1),
        rng.random(_CHUNKS),
        none + 1,
        cells.astype(np.uint32),
        none,
        none.astype(np.float32),
        none,
    )
    rows = 3 * _CHUNKS
    table = SegmentTable(
        np.tile(np.array([1, 7, 2], np.uint8), _CHUNKS),
        np.repeat(np.arange(_CHUNKS, dtype=np.uint32), 3),
        np.tile(np.array(_LENGTHS, np.uint32), _CHUNKS),
        rng.integers(0, 1 << 32, rows, np.uint32),
        rng.integers(0, 256, (rows, 16), np.uint8),
        np.zeros(rows, np.uint32),
    )
    box = np.array([-10.0] * 3 + [10.0] * 3)
    root = Root(
        "test", _CHUNKS * _SPLATS, 1, SceneInfo(), box, [], None, SegmentTable.zeros(0), chunks
    )
    return root, table


def test_a_place_of_a_city_takes_three_requests():
    root, table = city()
    parts = lay_out_index(root, table, plan_index(root, table))
    source = IndexOnly(parts, table.length.astype(np.int64))
    assert source.size > 8 * 10**9
    assert max(len(part.index) for part in parts[1:]) < 40_000
    for chunk in (0, 50_000, _CHUNKS - 1):
        source.asked.clear()
        index = LazyIndex(source, read_root(source, partial=False)).for_chunks([chunk])
        assert len(source.asked) <= 3
        assert source.asked[0] == (0, layout.FIRST_READ)
        assert sum(length for _, length in source.asked) <= 128 * 1024
        row = int(index.heads[chunk])
        assert index.segments.owner[row] == chunk
        assert index.chunks.splats[chunk] == _SPLATS
        assert int(index.offsets[row]) > 0
    assert zlib.crc32(parts[1].index) == int(index.root.pages.crc[0])
