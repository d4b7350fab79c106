from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cogsplat.codec.order.chunk_plan import (
    DEFAULT_CHUNK_SPLATS,
    FIRST_SPLATS,
    plan_chunks,
    sort_runs,
)
from cogsplat.codec.streams.payload_limits import MAX_CHUNK_SPLATS


def sizes(splats, *largest):
    chunks = plan_chunks(splats, *largest)
    position = 0
    for chunk in chunks:
        assert chunk.start == position < chunk.stop
        assert chunk.step is None
        position = chunk.stop
    assert position == splats
    return [chunk.stop - chunk.start for chunk in chunks]


@settings(derandomize=True, deadline=None, max_examples=300)
@given(st.integers(0, 200_000), st.one_of(st.integers(1, 2000), st.integers(1, MAX_CHUNK_SPLATS)))
def test_chunks_cover_all_rows_once_within_their_limit(splats, largest):
    if splats // largest > 40_000:
        splats %= 40_000
    found = sizes(splats, largest)
    assert all(1 <= size <= largest for size in found)
    growing = []
    size = float(FIRST_SPLATS)
    while size < largest:
        growing.append(int(size))
        size *= 1.5
    if splats > sum(growing):
        even = found[len(growing) :]
        assert found[: len(growing)] == growing or found[: len(growing) - 1] == growing[:-1]
        assert not even or max(even) - min(even) <= 1
    else:
        # Only the last chunk may deviate: it is shorter, or includes a short rest.
        assert found[:-1] == growing[: max(len(found) - 1, 0)]


def test_each_is_larger_than_the_one_before_and_the_rest_is_even():
    assert sizes(100_000)[:7] == [1024, 1536, 2304, 3456, 5184, 7776, 11664]
    assert sizes(100_000)[7:] == [13411, 13411, 13411, 13411, 13412]


def test_nothing_and_little():
    assert sizes(0) == []
    assert sizes(1) == [1]
    assert sizes(1024) == [1024]
    assert sizes(1025) == [1025]
    assert sizes(1535) == [1535]
    assert sizes(1536) == [1024, 512]


def test_the_largest_is_kept_and_no_run_is_tiny():
    assert sizes(201, 200) == [100, 101]
    assert sizes(5, 1) == [1] * 5
    assert sizes(5, 2) == [1, 2, 2]
    assert sizes(10, 3) == [2, 3, 2, 3]


@pytest.mark.parametrize("largest", [0, -1, MAX_CHUNK_SPLATS + 1])
def test_limits_out_of_range_are_refused(largest):
    with pytest.raises(ValueError, match="expected 1 to"):
        plan_chunks(10, largest)
    assert DEFAULT_CHUNK_SPLATS <= MAX_CHUNK_SPLATS


@pytest.mark.parametrize("chunks", [3, 2])
def test_runs_of_chunks_are_sorted_behind_the_first(chunks):
    rng = np.random.default_rng(1)
    rows, priority = rng.permutation(40_000), rng.random(40_000)
    found = sort_runs(rows, priority, run_chunks=chunks)
    ends = [run.stop for run in plan_chunks(40_000)]
    assert found[: ends[0]].tolist() == rows[: ends[0]].tolist()
    bounds = [*ends[:-1:chunks], 40_000]
    assert len(bounds) > 3
    for start, stop in pairwise(bounds):
        assert sorted(found[start:stop]) == sorted(rows[start:stop])
        assert (np.diff(priority[found[start:stop]]) <= 0).all()
    assert sort_runs(found, priority, run_chunks=chunks).tolist() == found.tolist()


def test_few_rows_stay_and_ties_too():
    none = np.zeros(0, np.int64)
    assert sort_runs(none, np.zeros(5)).tolist() == []
    rows = np.arange(5000)[::-1]
    assert sort_runs(rows, np.zeros(5000)).tolist() == rows.tolist()
