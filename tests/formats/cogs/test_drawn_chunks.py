"""Which chunks prefixes and levels draw."""

import numpy as np
import pytest

from cogsplat.formats.cogs.drawn_chunks import drawn_chunks, first_level, later_levels
from cogsplat.formats.cogs.index_tables import ChunkTable
from cogsplat.formats.cogs.root import Level


def table(until):
    count = len(until)
    none = np.zeros(count, np.uint32)
    box = np.zeros((count, 6), np.float32)
    quality = np.zeros(count, np.float32)
    until = np.array(until, np.uint32)
    return ChunkTable(none + 1, box, np.zeros(count), none, none, none, quality, until)


def test_prefixes_draw_what_has_not_ended():
    chunks = table([2, 4, 0, 0])
    assert [drawn_chunks(chunks, count) for count in range(5)] == [
        [], [0], [1], [1, 2], [2, 3],
    ]  # fmt: skip


@pytest.mark.parametrize("seed", range(4))
def test_levels_that_draw_a_chunk_are_counted_as_their_prefixes_say(seed):
    rng = np.random.default_rng(seed)
    count = 12
    ends = [*sorted(rng.choice(np.arange(1, count), 3, replace=False).tolist()), count]
    levels = [Level(int(end), 8.0 / 2**k) for k, end in enumerate(ends)]
    # Chunk c may end from c + 2 on.
    until = [int(rng.integers(c + 2, count + 1)) if c < count - 2 and rng.random() < 0.6 else 0
             for c in range(count)]  # fmt: skip
    chunks = table(until)
    drawn = [drawn_chunks(chunks, level.chunks) for level in levels]
    later = later_levels(levels, chunks, 0)
    for chunk in range(count):
        having = [k for k, level in enumerate(levels) if chunk < level.chunks]
        drawing = [k for k in having if chunk in drawn[k]]
        assert first_level(levels, chunk) == having[0]
        assert later[chunk] == max(len(drawing) - 1, 0)
        # One run of levels, from the first that has the chunk.
        assert drawing == having[: len(drawing)]


def test_without_levels_no_level_draws_a_chunk_again():
    assert later_levels([], table([0, 3, 0]), 0).tolist() == [0, 0, 0]
