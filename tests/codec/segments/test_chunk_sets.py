import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cogsplat.codec.segments.chunk_sets import equivalent_prefixes, has_all_parents


def _slow(chunks, parents, splats):
    """Follow the words of SPEC 8.5: try prefixes from the longest down."""

    def descends(other, chunk):
        while other not in (-1, chunk):
            other = parents[other]
        return other == chunk

    end = max(chunks) + 1
    found = []
    for chunk in chunks:
        held = sum(splats[c] for c in chunks if descends(c, chunk))
        fits = (
            m
            for m in range(end, 0, -1)
            if sum(splats[c] for c in range(m) if descends(c, chunk)) <= held
        )
        found.append(next(fits))
    return found


@st.composite
def _trees(draw):
    count = draw(st.integers(1, 12))
    parents = [-1] + [draw(st.integers(0, chunk - 1)) for chunk in range(1, count)]
    splats = draw(st.lists(st.integers(1, 9), min_size=count, max_size=count))
    held: list[int] = [0]
    for chunk in range(1, count):
        if parents[chunk] in held and draw(st.booleans()):
            held.append(chunk)
    return held, np.array(parents), np.array(splats)


@given(_trees())
def test_prefixes_follow_the_words_of_the_specification(tree):
    chunks, parents, splats = tree
    assert has_all_parents(chunks, parents)
    found = equivalent_prefixes(chunks, parents, splats)
    assert found.tolist() == _slow(chunks, parents.tolist(), splats.tolist())
    assert (found > chunks).all()


@given(_trees())
def test_of_a_prefix_all_chunks_have_its_length(tree):
    _, parents, splats = tree
    for count in range(1, len(parents) + 1):
        found = equivalent_prefixes(range(count), parents, splats)
        assert found.tolist() == [count] * count


def test_no_chunks_have_no_prefixes():
    assert not len(equivalent_prefixes([], np.array([-1, 0]), np.array([1, 1])))


@pytest.mark.parametrize(("chunks", "closed"), [([0, 2], False), ([0, 1, 2], True), ([1], False)])
def test_a_closed_set_has_the_parents(chunks, closed):
    assert has_all_parents(chunks, np.array([-1, 0, 1])) is closed
