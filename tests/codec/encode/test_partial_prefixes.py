from itertools import pairwise

import numpy as np
import oracle
import pytest
from encoding import encode, unseen

from cogsplat.codec.encode.partial_prefixes import decode_partial_prefixes, received_parts
from cogsplat.codec.rate.segment_order import OrderedKind
from cogsplat.codec.scoring.contribution import score

_PREFIXES = (1, 2, 4, 6)


@pytest.fixture(scope="module")
def encoded():
    splats = oracle.scene(6, n=600)
    scores = score(splats, [oracle.camera(0.3 * k) for k in range(3)])
    return encode(splats, scores, unseen(chunk_splats=50, quality_db=45.0))


def test_what_has_arrived_stays(encoded):
    states = received_parts(encoded)
    assert len(states) == len(encoded.chunks) - 1
    for before, behind in pairwise(states):
        assert before.refined <= behind.refined
        assert before.tailed <= behind.tailed
    for chunks, state in enumerate(states, start=1):
        assert state.refined | state.tailed <= set(range(chunks))
    # Some of both comes before the last head, and not at once.
    for name in ("refined", "tailed"):
        assert len({getattr(state, name) for state in states}) > 1


def test_half_the_bytes_between_two_heads_have_arrived(encoded):
    places = encoded.ordered_segments()
    heads = [number for number, place in enumerate(places) if place.kind is OrderedKind.HEAD]
    for state, (first, last) in zip(received_parts(encoded), pairwise(heads), strict=True):
        between = places[first + 1 : last]
        half = sum(encoded.segment_bytes(place) for place in between) / 2
        size = 0
        for place in between:
            size += encoded.segment_bytes(place)
            if place.kind is OrderedKind.REFINEMENT:
                assert (place.chunk in state.refined) == (size <= half)
            if place.kind is OrderedKind.TAIL:
                assert (place.chunk in state.tailed) == (size <= half)


def test_the_bytes_of_all_places_are_those_of_all_payloads(encoded):
    payloads = [payload for book in encoded.codebooks for payload in book.payloads]
    for chunk in encoded.chunks:
        parts = chunk.payloads
        payloads += [parts.head, parts.refinement or b"", parts.tail or b""]
    found = sum(encoded.segment_bytes(place) for place in encoded.ordered_segments())
    assert found == sum(len(payload) for payload in payloads)


def test_chunks_differ_from_the_whole_where_something_is_missing(encoded):
    states = received_parts(encoded)
    for chunks, prefix in zip(
        _PREFIXES, decode_partial_prefixes(encoded, _PREFIXES, 10_000), strict=True
    ):
        start = 0
        for number, chunk in enumerate(encoded.chunks[:chunks]):
            run = slice(start, start + chunk.splats)
            start = run.stop
            refines = chunk.payloads.refinement is not None
            is_whole = not refines or number in states[chunks - 1].refined
            for name in ("means", "scales", "opacities", "sh0"):
                found, whole = getattr(prefix, name)[run], getattr(encoded.decoded, name)[run]
                if is_whole:
                    np.testing.assert_array_equal(found, whole)
                np.testing.assert_allclose(found, whole, atol=4.0)
            if not is_whole:
                assert any(
                    (getattr(prefix, name)[run] != getattr(encoded.decoded, name)[run]).any()
                    for name in ("means", "scales", "opacities", "sh0")
                )
            has_tail = number in states[chunks - 1].tailed
            shown = encoded.decoded.shN[run] if has_tail else 0.0
            np.testing.assert_array_equal(
                prefix.shN[run], np.broadcast_to(shown, prefix.shN[run].shape)
            )
        assert len(prefix) == start


def test_long_prefixes_are_those_of_the_whole(encoded):
    short, long = decode_partial_prefixes(encoded, (1, 6), 100)
    assert np.shares_memory(long.means, encoded.decoded.means)
    assert not np.shares_memory(short.means, encoded.decoded.means)
    np.testing.assert_array_equal(long.shN, encoded.decoded.shN[: len(long)])


@pytest.mark.parametrize("profile", ["vq", "near-lossless"])
def test_chunks_without_refinements_have_their_shapes_at_once(profile):
    splats = oracle.scene(6, n=200)
    made = encode(splats, None, unseen(profile=profile, chunk_splats=50))
    (prefix,) = decode_partial_prefixes(made, (2,), 1000)
    for name in ("means", "scales", "quats", "opacities", "sh0"):
        whole = getattr(made.decoded, name)[:100]
        np.testing.assert_array_equal(getattr(prefix, name), whole)
