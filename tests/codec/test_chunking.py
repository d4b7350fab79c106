import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cogsplat.codec.chunking import (
    DEFAULT_LARGEST,
    FIRST_SPLATS,
    MAX_CHUNK_SPLATS,
    plan_chunks,
)


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
    if splats // largest > 20_000:
        splats %= 20_000
    found = sizes(splats, largest)
    assert all(1 <= size <= largest for size in found)
    # They grow; only the rest at the end may be smaller.
    assert found[:-1] == sorted(found[:-1])
    if len(found) > 1:
        assert found[0] == min(FIRST_SPLATS, largest)
        # A rest of less than half the chunk before joins it, unless that would be too large.
        assert 2 * found[-1] >= found[-2] or found[-2] + found[-1] > largest


def test_each_is_half_as_large_again():
    growing = [1024, 1536, 2304, 3456, 5184, 7776, 11664, *[16384] * 4, 1520]
    assert sizes(100_000) == growing


def test_nothing_and_little():
    assert sizes(0) == []
    assert sizes(1) == [1]
    assert sizes(1024) == [1024]
    assert sizes(1025) == [1025]
    assert sizes(1535) == [1535]
    assert sizes(1536) == [1024, 512]


def test_the_largest_is_kept_even_by_a_small_rest():
    assert sizes(1001, 1000) == [1000, 1]
    assert sizes(5, 1) == [1] * 5
    assert sizes(5, 2) == [2, 2, 1]
    assert sizes(10, 3) == [3, 3, 3, 1]


@pytest.mark.parametrize("largest", [0, -1, MAX_CHUNK_SPLATS + 1])
def test_limits_out_of_range_are_refused(largest):
    with pytest.raises(ValueError, match="expected 1 to"):
        plan_chunks(10, largest)
    assert DEFAULT_LARGEST <= MAX_CHUNK_SPLATS
