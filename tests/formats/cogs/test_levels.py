"""Files with levels and with chunks that end, from the writer to the reader."""

from dataclasses import replace

import numpy as np
import pytest
from levelled import STEP, levelled_file, levelled_scene

from cogsplat.codec.segments.prefix_compensation import Compensation, Layer
from cogsplat.formats.cogs import scene_writer as cogs
from cogsplat.formats.cogs.findings import findings
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.reader import open_cogs
from cogsplat.formats.cogs.verification import checks
from cogsplat.formats.cogs.writer import lay_out
from cogsplat.formats.storage.source import BytesSource


@pytest.fixture(scope="module")
def file():
    with open_cogs(BytesSource(levelled_file())) as opened:
        yield opened


class Counting(BytesSource):
    """Source over bytes that records the range of each read."""

    def __init__(self, data):
        super().__init__(data)
        self.reads = []

    def read(self, offset, length):
        self.reads.append((offset, length))
        return super().read(offset, length)


def test_levels_have_the_opacities_that_were_given(file):
    _, expected = levelled_scene()
    for level, chunks in enumerate(expected):
        found = file.decode(level=level)
        wanted = np.concatenate(list(chunks.values()))
        np.testing.assert_allclose(found.opacities, np.clip(wanted, -12, 12), atol=STEP * 0.51)
    assert len(file.decode()) == len(file.decode(level=2))
    np.testing.assert_array_equal(file.decode().opacities, file.decode(level=2).opacities)


def test_layers_and_levels_stand_in_the_root(file):
    assert file.chunks.layer.tolist() == [0, 0, 1, 1, 2, 2]
    assert file.chunks.until.tolist() == [0, 4, 6, 0, 0, 0]
    assert [(level.chunks, level.scale) for level in file.root.levels] == [
        (2, 4.0), (4, 2.0), (6, 1.0),
    ]  # fmt: skip
    assert file.root.splats == int(file.chunks.splats.sum())


def test_a_level_reads_what_it_draws_and_nothing_else():
    for level, drawn in enumerate([{0, 1}, {0, 2, 3}, {0, 3, 4, 5}]):
        source = Counting(levelled_file())
        with open_cogs(source) as file:
            source.reads.clear()
            file.decode(level=level)
            rows = {int(offset): row for row, offset in enumerate(file.offsets)}
            segments = [rows[offset] for offset, _ in source.reads]
            owners = {
                int(file.segments.owner[row])
                for row in segments
                if file.segments.kind[row] in (SegmentKind.HEAD, SegmentKind.OPACITIES)
            }
            opacities = [row for row in segments if file.segments.kind[row] == 8]
        assert owners == drawn
        assert len(opacities) == [0, 1, 2][level]


def test_prefixes_leave_out_what_has_ended(file):
    data = levelled_file()
    ends = np.cumsum([0, *file.chunks.splats.tolist()])
    whole = file.decode(range(6))
    for count, drawn in [(2, [0, 1]), (3, [0, 1, 2]), (4, [0, 2, 3]), (6, [0, 3, 4, 5])]:
        head = file.chunk_rows(count - 1).head
        size = int(file.offsets[head] + file.segments.length[head])
        with open_cogs(BytesSource(data[:size]), partial=True) as part:
            assert part.complete_chunks() == count
            found = part.decode(refine=False)
            assert part.select() == drawn
        coarse = file.decode(range(6), refine=False)
        rows = np.concatenate([np.arange(ends[c], ends[c + 1]) for c in drawn])
        np.testing.assert_array_equal(found.means, coarse.means[rows])
    assert len(whole) == ends[-1]


def test_chunks_asked_for_by_number_are_given_though_they_ended(file):
    assert len(file.decode([1])) == int(file.chunks.splats[1])
    assert file.select(chunks=(0, 3)) == [0, 1, 2]
    assert file.select() == [0, 3, 4, 5]
    assert file.select(splats=int(file.chunks.splats[:3].sum())) == [0, 1, 2]
    assert [len(part) for part in file.iter_chunks()] == file.chunks.splats[[0, 3, 4, 5]].tolist()
    parts = list(file.decode_parts(max_splats=1))
    assert sum(map(len, parts)) == len(file.decode())


def test_levels_that_are_not_there_are_misuse(file):
    for level in (-1, 3):
        with pytest.raises(ValueError, match="level"):
            file.decode(level=level)


def test_a_verifier_reads_the_opacities_of_every_level(file):
    names = [check.what for check in checks(file) if "opacities" in check.what]
    assert names == [
        "opacities of chunk 0 at level 1", "opacities of chunk 0 at level 2",
        "opacities of chunk 3 at level 2",
    ]  # fmt: skip
    file.verify()
    assert findings(BytesSource(levelled_file())) == []


def test_compensation_counts_ended_chunks_and_leaves_out_their_rows():
    made, _ = levelled_scene()
    counts = np.array([chunk.splats for chunk in made.chunks], np.int64)
    shifts = np.arange(1, 6, dtype=np.int8)
    layer = Layer(
        shifts, 2 * shifts, np.zeros((5, 2), np.uint8), np.zeros((0, 2), np.int8),
        np.zeros(0, np.uint8),
    )  # fmt: skip
    given = replace(made, compensation=Compensation((layer,), counts), levels=(), chunks=[
        replace(chunk, opacities=()) for chunk in made.chunks
    ])  # fmt: skip
    data = b"".join(lay_out(cogs.build_root(given, "samples"), cogs.segments(given)))
    with open_cogs(BytesSource(data)) as file:
        head = file.chunk_rows(4).head
        size = int(file.offsets[head] + file.segments.length[head])
    with open_cogs(BytesSource(data[:size]), partial=True) as part:
        assert part.complete_chunks() == 5
        plain, found = part.decode(), part.decode(compensate=True)
    drawn = [0, 2, 3, 4]
    added = np.repeat(shifts[drawn].astype(np.float32), counts[drawn])
    np.testing.assert_array_equal(found.scales, plain.scales + added[:, None] / np.float32(128))
    np.testing.assert_array_equal(found.opacities, plain.opacities + 2 * added / np.float32(16))
