import numpy as np
from cogs_samples import file_of

from cogsplat.formats.cogs.fetch_order import codebook_rows, ranges_to_decode, rows_of_chunk
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.scene_index import read_scene_index
from cogsplat.formats.storage.source import BytesSource


def index_of(profile):
    return read_scene_index(BytesSource(file_of(profile, 6000, 3, 500)), partial=False)


def test_a_whole_scene_is_asked_for_from_front_to_back():
    index = index_of("vq")
    chunks = range(len(index.chunks))
    ranges = ranges_to_decode(index, chunks, sh_degree=3, refine=True, extras=True)
    offsets = [offset for offset, _ in ranges]
    assert offsets == sorted(set(offsets))
    skipped = index.segments.kind >= 128
    assert len(ranges) == int((~skipped).sum())


def test_only_what_is_decoded_is_asked_for():
    index = index_of("vq")
    head = int(index.heads[4])
    assert rows_of_chunk(index, 4, sh_degree=0, refine=False, extras=False) == [head]
    rows = rows_of_chunk(index, 4, sh_degree=3, refine=True, extras=True)
    assert set(index.segments.owner[rows]) == {4}
    one = codebook_rows(index, rows, 1)
    three = codebook_rows(index, rows, 3)
    kinds = {SegmentKind(int(kind)) for kind in index.segments.kind[one]}
    assert SegmentKind.COLOUR_BAND1 in kinds
    assert SegmentKind.COLOUR_BAND2 not in kinds
    assert len(three) > len(one)
    assert len(set(three)) == len(three)


def test_later_chunks_come_later_where_there_is_much():
    index = index_of("transform")
    lengths = index.segments.length.copy()
    lengths[:] = 5 << 20
    large = type(index.segments)(
        index.segments.kind,
        index.segments.owner,
        lengths,
        index.segments.crc,
        index.segments.hash,
        index.segments.needs,
    )
    offsets = np.cumsum(lengths.astype(np.int64)) - lengths
    changed = type(index)(**{**vars(index), "segments": large, "offsets": offsets})
    order = [5, 0, 3]
    ranges = ranges_to_decode(changed, order, sh_degree=3, refine=True, extras=False)
    rows = [int(np.flatnonzero(offsets == offset)[0]) for offset, _ in ranges]
    owners = [int(index.segments.owner[row]) for row in rows]
    heads = [o for o, row in zip(owners, rows, strict=True) if row in index.heads]
    assert heads == order
