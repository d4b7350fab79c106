import random
import threading
from dataclasses import replace

import numpy as np
import pytest
from cogs_samples import assert_same, encoded, file_of

from cogsplat.codec.errors import Cancelled, FormatError, LimitError, TruncatedError
from cogsplat.codec.splats import concatenate
from cogsplat.codec.streams import decoding_tiers
from cogsplat.formats.cogs import scene_writer as cogs
from cogsplat.formats.cogs.decoded_rows import scratch_bytes
from cogsplat.formats.cogs.reader import open_cogs
from cogsplat.formats.cogs.scene_index import read_scene_index
from cogsplat.formats.cogs.writer import lay_out
from cogsplat.formats.storage.limits import Limits
from cogsplat.formats.storage.source import BytesSource, FileSource, PrefixSource

PROFILES = ("transform", "vq", "near-lossless")


@pytest.fixture(params=PROFILES)
def data(request):
    return file_of(request.param)


def ends_of(file):
    return np.cumsum([0, *file.chunks.splats.tolist()])


class Counting(BytesSource):
    """Source over bytes that records the range of each read."""

    def __init__(self, data):
        super().__init__(data)
        self.reads = []
        self.closed = 0

    def read(self, offset, length):
        self.reads.append((offset, length))
        return super().read(offset, length)

    def close(self):
        self.closed += 1


class Dribbling(BytesSource):
    """Puts each range together from small pieces of odd sizes, as a slow connection does."""

    def read(self, offset, length):
        sizes = random.Random(offset + length)
        out, end = b"", offset + length
        while offset < end:
            piece = min(sizes.choice([1, 2, 3, 7, 1000]), end - offset)
            out += super().read(offset, piece)
            offset += piece
        return out


def test_how_bytes_arrive_does_not_matter(data):
    with open_cogs(BytesSource(data)) as whole, open_cogs(Dribbling(data)) as file:
        assert_same(file.decode(), whole.decode())


def test_opening_reads_the_first_64_kib_once(data):
    source = Counting(data)
    with open_cogs(source):
        assert source.reads == [(0, min(65536, len(data)))]
    assert source.closed == 1


def test_a_chunk_reads_only_what_it_needs(data):
    source = Counting(data)
    with open_cogs(source) as file:
        source.reads.clear()
        file.decode([2], sh_degree=0)
        wanted = {int(file.segment_rows(1, 2)[0])}
        for book, entry in enumerate(file.root.codebooks):
            if entry.attribute == "shape":
                wanted |= set(file.segment_rows(3, book))
        lengths = file.segments.length
        assert set(source.reads) == {(int(file.offsets[r]), int(lengths[r])) for r in wanted}
        assert len(source.reads) == len(wanted)


def test_codebooks_are_read_once(data):
    source = Counting(data)
    with open_cogs(source) as file:
        file.decode()
        source.reads.clear()
        file.decode()
        assert len(source.reads) == 2 * file.num_chunks


@pytest.mark.parametrize("threads", [2, 5])
def test_threads_change_nothing(data, threads):
    with open_cogs(BytesSource(data)) as file:
        assert_same(file.decode(threads=threads), file.decode(threads=1))


def test_chunks_in_random_order_are_rows_of_the_whole(data):
    with open_cogs(BytesSource(data)) as file:
        whole, ends = file.decode(), ends_of(file)
        order = list(range(file.num_chunks))
        random.Random(5).shuffle(order)
        assert len(order) >= 5
        for chunk in order:
            assert_same(file.decode([chunk]), whole, slice(ends[chunk], ends[chunk + 1]))
        rows = np.concatenate([np.arange(ends[c], ends[c + 1]) for c in order])
        assert_same(file.decode(order), whole, rows)
        for chunk, splats in enumerate(file.iter_chunks()):
            assert_same(splats, whole, slice(ends[chunk], ends[chunk + 1]))


@pytest.mark.parametrize("max_splats", [1, 150, 10_000])
def test_parts_joined_are_the_whole(data, max_splats):
    with open_cogs(BytesSource(data)) as file:
        whole, calls = file.decode(), []
        parts = list(
            file.decode_parts(max_splats=max_splats, progress=lambda *call: calls.append(call))
        )
        assert_same(concatenate(parts), whole)
        largest = int(file.chunks.splats.max())
        assert all(len(part) <= max(max_splats, largest) for part in parts)
        assert len(calls) == len(parts)
        assert calls[-1] == ("decode", file.num_chunks, file.num_chunks)
        some = list(file.decode_parts([1, 0], sh_degree=0, refine=False, max_splats=max_splats))
        assert_same(concatenate(some), file.decode([1, 0], sh_degree=0, refine=False))
        assert list(file.decode_parts([])) == []


def test_a_file_that_is_too_large_as_a_whole_gives_no_part(data):
    with open_cogs(BytesSource(data), limits=Limits(splats=200)) as file:
        assert file.root.splats > 200
        with pytest.raises(LimitError) as refused:
            next(file.decode_parts(max_splats=10))
    assert refused.value.code == "too-many-splats"


def test_several_threads_may_decode_one_file(data):
    with open_cogs(BytesSource(data)) as file, open_cogs(BytesSource(data)) as other:
        whole, found = other.decode(), []
        start = threading.Barrier(3)

        def work():
            start.wait(10)
            found.append(file.decode(threads=2))

        workers = [threading.Thread(target=work) for _ in range(3)]
        for worker in workers:
            worker.start()
        for worker in workers:
            worker.join()
        assert len(found) == 3
        for splats in found:
            assert_same(splats, whole)


def test_selected_chunks_are_whole_and_enough(data):
    with open_cogs(BytesSource(data)) as file:
        ends = ends_of(file).tolist()
        total = ends[-1]
        for splats in (0, 1, ends[1], ends[1] + 1, total, total + 1):
            selected = file.select(splats=splats)
            count = len(selected)
            assert selected == list(range(count))
            assert ends[count] >= min(splats, total)
            assert count == 0 or ends[count - 1] < splats
        second = ends[2] - ends[1]
        assert file.select(chunks=(1, None), splats=second) == [1]
        assert file.select(chunks=(1, None), splats=second + 1) == [1, 2]


def test_selected_ranges_may_be_open(data):
    with open_cogs(BytesSource(data)) as file:
        count = file.num_chunks
        assert file.select() == file.select(chunks=(None, None)) == list(range(count))
        assert file.select(chunks=(2, None)) == list(range(2, count))
        assert file.select(chunks=(None, 2)) == [0, 1]
        assert file.select(chunks=(2, 2)) == []
        for chunks in ((0, count + 1), (3, 2), (-1, 2)):
            with pytest.raises(ValueError, match=f"^chunks .* within 0:{count}"):
                file.select(chunks=chunks)
        with pytest.raises(ValueError, match="splats -1"):
            file.select(splats=-1)


def test_selected_objects_are_those_that_are_there():
    # Objects 3 and 7 take turns in the table of chunks.
    made = encoded("vq")
    labelled = [replace(chunk, object=(3, 7)[k % 2]) for k, chunk in enumerate(made.chunks)]
    made = replace(made, chunks=labelled)
    data = b"".join(lay_out(cogs.build_root(made, "samples"), cogs.segments(made)))
    with open_cogs(BytesSource(data)) as file:
        every = list(range(file.num_chunks))
        assert file.select(objects=[3]) == every[::2]
        assert file.select(objects=[7, 3, 7]) == every
        assert file.select(objects=[]) == []
        assert file.select(objects=iter([7]), chunks=(1, 4)) == [1, 3]
        assert file.select(objects=[7], splats=1) == [1]
        with pytest.raises(ValueError, match="object 5, expected one of 3, 7"):
            file.select(objects=[3, 5])


def test_a_file_without_objects_says_so(data):
    with open_cogs(BytesSource(data)) as file:
        assert file.select(objects=[0]) == list(range(file.num_chunks))
        with pytest.raises(ValueError, match="object 3, expected a file with chunks of one object"):
            file.select(objects=[3])


def test_a_size_ends_the_source(data):
    with open_cogs(BytesSource(data)) as file:
        whole = file.decode()
    for share in (0.4, 0.7, 1.0, 2.0):
        size = int(share * len(data))
        with (
            open_cogs(BytesSource(data), size_bytes=size) as part,
            open_cogs(PrefixSource(BytesSource(data), size), partial=True) as expected,
        ):
            assert part.source_bytes == min(size, len(data))
            assert part.select() == list(range(expected.complete_chunks()))
            assert_same(part.decode(), expected.decode())
            assert share < 1 or len(part.decode()) == len(whole)
    with pytest.raises(ValueError, match="size_bytes -1"):
        open_cogs(BytesSource(data), size_bytes=-1)


def test_a_hundred_cuts_decode_to_complete_chunks_or_are_refused(data):
    with open_cogs(BytesSource(data)) as file:
        whole, coarse, ends = file.decode(), file.decode(refine=False), ends_of(file)
        head_ends = [
            int(file.offsets[row] + file.segments.length[row])
            for row in (file.segment_rows(1, chunk)[0] for chunk in range(file.num_chunks))
        ]
    first = read_scene_index(BytesSource(data), partial=False).offsets[0]
    for length in random.Random(6).sample(range(len(data)), 100):
        source = PrefixSource(BytesSource(data), length)
        with pytest.raises(TruncatedError):
            open_cogs(source)
        if length < first:
            with pytest.raises(TruncatedError):
                open_cogs(source, partial=True)
            continue
        with open_cogs(source, partial=True) as part:
            splats = part.decode()
            chunks = part.complete_chunks()
            assert len(splats) == ends[chunks]
            assert chunks == sum(end <= length for end in head_ends[: chunks + 1])
            for chunk in range(chunks):
                rows = slice(ends[chunk], ends[chunk + 1])
                given = whole if part.has_refinement(chunk) else coarse
                for name in ("means", "scales", "quats", "opacities", "sh0"):
                    assert np.array_equal(getattr(splats, name)[rows], getattr(given, name)[rows])
                expected = whole.shN[rows] if part.has_tail(chunk) else np.zeros(1, np.float32)
                assert (splats.shN[rows] == expected).all()


def test_a_part_says_what_it_lacks(data):
    length = len(data) // 5
    with open_cogs(BytesSource(data[:length]), partial=True) as part:
        assert part.missing_bytes == len(data) - length
        last = part.num_chunks - 1
        assert part.complete_chunks() <= last
        with pytest.raises(TruncatedError) as caught:
            part.decode([last])
        assert caught.value.code == "file-truncated"
        with pytest.raises(TruncatedError):
            part.verify()


def test_numbers_outside_the_file_are_misuse(data):
    with open_cogs(BytesSource(data)) as file:
        for chunk in (-1, file.num_chunks):
            with pytest.raises(ValueError, match="chunk"):
                file.decode([chunk])
        with pytest.raises(ValueError, match="degree"):
            file.decode(sh_degree=4)
        with pytest.raises(ValueError, match="threads"):
            file.decode(threads=-1)


def test_no_chunks_are_no_rows(data):
    with open_cogs(BytesSource(data)) as file:
        assert len(file.decode([])) == 0
        assert file.decode([]).sh_degree == 3


def test_what_a_caller_allows_is_not_exceeded(data):
    with open_cogs(BytesSource(data)) as file:
        whole = file.decode()
    size = whole.nbytes
    with open_cogs(BytesSource(data), limits=Limits(decoded_bytes=size // 2)) as file:
        with pytest.raises(LimitError) as caught:
            file.decode()
        assert caught.value.code == "decoded-size"
        assert len(file.decode([0], sh_degree=0)) > 0
    with open_cogs(BytesSource(data), limits=Limits(decoded_bytes=4 * size)) as file:
        assert_same(file.decode(), whole)


def test_the_limit_counts_codebooks():
    data = file_of("vq")
    with open_cogs(BytesSource(data)) as file:
        file.decode([0], sh_degree=1)
        books = sum(book.nbytes for book in file._codebooks.values())
        # Beside its arrays the one chunk takes its working memory.
        row = file.decode([0], sh_degree=1).nbytes
        row += scratch_bytes(int(file.chunks.splats[0]), 1, file.root)
    assert books > 0
    for spare, fits in ((0, True), (-1, False)):
        limits = Limits(decoded_bytes=books + row + spare)
        with open_cogs(BytesSource(data), limits=limits) as file:
            if fits:
                file.decode([0], sh_degree=1)
            else:
                with pytest.raises(LimitError):
                    file.decode([0], sh_degree=1)


def test_a_flipped_bit_spoils_its_segment_alone(data):
    with open_cogs(BytesSource(data)) as file:
        head = file.segment_rows(1, 3)[0]
        at = int(file.offsets[head]) + 5
        whole, ends = file.decode(), ends_of(file)
    broken = data[:at] + bytes([data[at] ^ 16]) + data[at + 1 :]
    with open_cogs(BytesSource(broken)) as file:
        for chunk in range(file.num_chunks):
            if chunk == 3:
                with pytest.raises(FormatError) as caught:
                    file.decode([3])
                assert (caught.value.code, caught.value.offset) == ("segment-crc", at - 5)
            else:
                assert_same(file.decode([chunk]), whole, slice(ends[chunk], ends[chunk + 1]))
        for threads in (1, 4):
            with pytest.raises(FormatError):
                file.decode(threads=threads)


def test_a_file_that_changes_under_the_reader(data, tmp_path):
    path = tmp_path / "a.cogs"
    path.write_bytes(data)
    with open_cogs(FileSource(path)) as file:
        path.write_bytes(data[: len(data) // 2])
        with pytest.raises(TruncatedError) as caught:
            file.decode()
        assert caught.value.code == "source-changed"
    path.write_bytes(data)
    with open_cogs(FileSource(path)) as file:
        path.write_bytes(data[:-50] + bytes(50))
        with pytest.raises(FormatError) as caught:
            file.decode()
        assert caught.value.code == "segment-crc"


@pytest.mark.parametrize("threads", [1, 3])
def test_progress_counts_and_cancels(data, threads):
    calls = []
    with open_cogs(BytesSource(data)) as file:
        file.decode(threads=threads, progress=lambda *call: calls.append(call))
        count = file.num_chunks
        assert calls == [("decode", done, count) for done in range(1, count + 1)]

        def stop(stage, done, total):
            raise Cancelled

        with pytest.raises(Cancelled):
            file.decode(threads=threads, progress=stop)
        assert len(file.decode(threads=threads)) == file.root.splats


def test_verify_looks_at_codebooks_that_nobody_needs():
    from cogsplat.formats.cogs.layout import SegmentKind
    from cogsplat.formats.cogs.writer import Segment
    from cogsplat.tools.lab.conformance import handmade_streams as handmade
    from cogsplat.tools.lab.conformance.file_builder import (
        ChunkRow,
        Draft,
        Group,
        build,
        pack_streams,
        root_keys,
    )

    book = Segment(SegmentKind.SHAPE_CODEBOOK, 0, pack_streams(handmade.shape_codebook(4, 1)))
    head = Segment(SegmentKind.HEAD, 0, pack_streams(handmade.random_head(2, 1)))
    # Five rows are stated and four are there; no chunk uses them.
    root = root_keys(2, 0, codebooks=[{"attribute": "shape", "rows": 5}])
    data = build(Draft(root, [Group([book, head], [ChunkRow(2)])]))
    with open_cogs(BytesSource(data)) as file:
        assert len(file.decode()) == 2
        with pytest.raises(FormatError) as caught:
            file.verify()
        assert caught.value.code == "stream-rows"


def test_a_page_that_is_not_there_hides_its_chunks():
    from cogsplat.tools.lab.conformance import valid

    data = next(v.data for v in valid.valid() if v.name == "pages")
    with open_cogs(BytesSource(data)) as file:
        total = file.num_chunks
        assert len(file.page_bytes) == 3
    index = read_scene_index(BytesSource(data), partial=False)
    cut = int(index.offsets[2]) + 1
    with open_cogs(BytesSource(data[:cut]), partial=True) as part:
        assert part.num_chunks < total
        with pytest.raises(TruncatedError) as caught:
            part.decode([total - 1])
        assert caught.value.code == "file-truncated"
        with pytest.raises(ValueError, match="expected 0 to 4"):
            part.decode([total])


def test_parts_count_once_towards_loading_kernels(monkeypatch):
    counted = []
    monkeypatch.setattr(decoding_tiers, "load_if_worthwhile", counted.append)
    with open_cogs(BytesSource(file_of("transform"))) as file:
        assert sum(map(len, file.decode_parts(max_splats=1))) == file.root.splats
        assert counted == [file.root.splats]
