"""Files whose heads are coarse: whole, without refinements, in part, and checked."""

from dataclasses import replace
from functools import cache

import cogs_samples
import numpy as np
import pytest
from encoding import encode, unseen

from cogsplat.codec.encode.partial_prefixes import decode_partial_prefixes
from cogsplat.codec.errors import FormatError
from cogsplat.codec.scoring.contribution import zero_scores
from cogsplat.formats.cogs import scene_writer
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.reader import open_cogs
from cogsplat.formats.cogs.writer import lay_out
from cogsplat.formats.storage.source import BytesSource

N = 1500
REFINABLE = ("means", "scales", "opacities", "sh0")


@cache
def encoded(refine=True):
    rng = np.random.default_rng(7)
    contribution = rng.exponential(size=N) ** 2
    scores = replace(
        zero_scores(N),
        contribution=contribution.astype(np.float64),
        energy=(contribution / contribution.sum() * 0.1).astype(np.float64),
    )
    config = unseen(chunk_splats=300, prune=None, refine=refine, quality_db=45.0, compensate=False)
    return encode(cogs_samples.scene(N), scores, config)


@cache
def file_of(refine=True):
    made = encoded(refine)
    root = scene_writer.build_root(made, "samples")
    return b"".join(lay_out(root, scene_writer.segments(made)))


def rows_of(splats, start, stop):
    return [getattr(splats, name)[start:stop].tobytes() for name in REFINABLE]


def test_heads_are_smaller_and_their_values_coarser():
    whole, coarse, once = (
        open_cogs(BytesSource(data)).decode(refine=refine)
        for data, refine in ((file_of(), True), (file_of(), False), (file_of(False), True))
    )
    source = cogs_samples.scene(N)
    for name in REFINABLE:
        assert not np.array_equal(getattr(whole, name), getattr(coarse, name))
    assert np.array_equal(whole.quats, coarse.quats)

    def missed(splats):
        """Return the mean distance of means to the source's nearest."""
        apart = splats.means[:, None, :] - source.means[None, :, :]
        return float(np.sqrt(np.square(apart).sum(axis=2).min(axis=1)).mean())

    assert missed(whole) < 1.2 * missed(once)
    assert missed(coarse) > 1.5 * missed(whole)
    heads = [
        sum(len(chunk.payloads.head) for chunk in encoded(refine).chunks)
        for refine in (True, False)
    ]
    assert heads[0] < 0.8 * heads[1]
    assert len(file_of()) < 1.15 * len(file_of(False))


def test_nothing_is_refined_where_that_was_not_asked():
    assert all(chunk.payloads.refinement is None for chunk in encoded(False).chunks)
    with open_cogs(BytesSource(file_of(False))) as file:
        assert SegmentKind.REFINEMENT not in file.segments.kind
        assert all(map(file.has_refinement, range(file.num_chunks)))
        cogs_samples.assert_same(file.decode(refine=False), file.decode())


def test_a_part_is_refined_as_far_as_it_goes():
    data = file_of()
    with open_cogs(BytesSource(data)) as file:
        whole, coarse = file.decode(), file.decode(refine=False)
        ends = np.cumsum([0, *file.chunks.splats])
    seen = set()
    for length in range(3000, len(data), len(data) // 40):
        with open_cogs(BytesSource(data[:length]), partial=True) as part:
            chunks = part.complete_chunks()
            splats, alone = part.decode(), part.decode(refine=False)
            for chunk in range(chunks):
                refined = part.has_refinement(chunk)
                seen.add(refined)
                run = ends[chunk], ends[chunk + 1]
                assert rows_of(splats, *run) == rows_of(whole if refined else coarse, *run)
                assert rows_of(alone, *run) == rows_of(coarse, *run)
    assert seen == {True, False}


def test_chunks_one_by_one_are_those_of_the_whole():
    with open_cogs(BytesSource(file_of())) as file:
        for refine in (True, False):
            whole = file.decode(refine=refine)
            start = 0
            for part in file.iter_chunks(refine=refine):
                cogs_samples.assert_same(part, whole, slice(start, start + len(part)))
                start += len(part)
            assert start == N
            for threads in (1, 3):
                cogs_samples.assert_same(file.decode(refine=refine, threads=threads), whole)


def test_kernels_read_the_same(kernels):
    with open_cogs(BytesSource(file_of())) as file:
        file.verify()
        for refine in (True, False):
            found = file.decode(refine=refine)
            assert rows_of(found, 0, N) == read_before(refine)


@cache
def read_before(refine):
    with open_cogs(BytesSource(file_of())) as file:
        return rows_of(file.decode(refine=refine), 0, N)


def test_boxes_hold_coarse_splats_too():
    made = encoded()
    shrunk = list(made.chunks)
    with open_cogs(BytesSource(file_of())) as file:
        coarse = file.decode([0], refine=False).means
        fine = file.decode([0]).means
    # A box around the refined means alone, just short of the coarse ones.
    low, high = fine.min(axis=0), fine.max(axis=0)
    assert (coarse.min(axis=0) < low).any() or (coarse.max(axis=0) > high).any()
    shrunk[0] = replace(shrunk[0], box=np.concatenate([low, high]).astype(np.float64))
    wrong = replace(made, chunks=shrunk)
    data = b"".join(
        lay_out(scene_writer.build_root(wrong, "samples"), scene_writer.segments(wrong))
    )
    with open_cogs(BytesSource(data)) as file, pytest.raises(FormatError) as caught:
        file.verify()
    assert caught.value.code == "chunk-box"


def test_prefixes_as_they_arrive_are_those_of_a_file_cut_between_two_heads():
    made, data = encoded(), file_of()
    segments = scene_writer.segments(made)
    sizes = [len(segment.payload) for segment in segments]
    ends = len(data) - sum(sizes) + np.cumsum(sizes)
    heads = [row for row, part in enumerate(segments) if part.kind == SegmentKind.HEAD]
    prefixes = range(1, len(made.chunks))
    for chunks, prefix in zip(prefixes, decode_partial_prefixes(made, prefixes, N), strict=True):
        # The end of its last head, and of what stands before the next one.
        half = (ends[heads[chunks - 1]] + ends[heads[chunks] - 1]) // 2
        with open_cogs(BytesSource(data), size_bytes=int(half)) as part:
            cogs_samples.assert_same(part.decode(), prefix)
