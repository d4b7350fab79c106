import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cogsplat.codec.rate import segment_order
from cogsplat.codec.rate.segment_order import ChunkSegments, SegmentGain


def shares(*contribution):
    return segment_order.missing_shares(np.array(contribution, float))


def names(places):
    return [f"{p.kind.name.lower()}{'' if p.chunk < 0 else p.chunk}" for p in places]


def test_missing_shares_fall_to_nothing():
    assert shares(6, 3, 1).tolist() == pytest.approx([1, 0.4, 0.1, 0])
    assert shares(0, 0).tolist() == [1, 0.5, 0]
    assert shares().tolist() == [1]


def test_drops_of_heads_add_up_to_the_error_of_an_empty_picture():
    gains = segment_order.head_distortion_drops(shares(6, 3, 1))
    assert (np.diff(gains) < 0).all()
    assert gains.sum() == pytest.approx(segment_order.head_distortion_drops(shares(1)).sum())


def test_segments_are_ordered_by_error_drop_per_byte():
    chunks = [
        ChunkSegments(100, SegmentGain(1000, 1e-9), SegmentGain(100, 1.0)),
        ChunkSegments(100, SegmentGain(1000, 1e-8), SegmentGain(100, 1e-12)),
    ]
    found = names(segment_order.order_segments(chunks, shares(1, 1), 50))
    assert found == ["head0", "codebooks", "tail0", "head1", "refinement1", "refinement0", "tail1"]


def test_codebooks_come_when_their_tails_are_worth_it():
    chunks = [ChunkSegments(10, None, SegmentGain(10, 1e-4)) for _ in range(5)]
    assert names(segment_order.order_segments(chunks, shares(*[1] * 5), 10**9))[:6] == [
        "head0", "head1", "head2", "head3", "head4", "codebooks",
    ]  # fmt: skip
    assert names(segment_order.order_segments(chunks, shares(*[1] * 5), 0))[-1].startswith("tail")


def test_codebooks_without_tails_are_in_the_order():
    found = names(segment_order.order_segments([ChunkSegments(10, None, None)], shares(1), 7))
    assert found == ["head0", "codebooks"]
    assert names(segment_order.order_segments([], shares(), 7)) == ["codebooks"]
    assert segment_order.order_segments([], shares(), 0) == []


def test_a_head_without_gain_is_rated_with_the_heads_after_it():
    chunks = [ChunkSegments(100, SegmentGain(100, 1e-6), None)] + [
        ChunkSegments(100, None, None)
    ] * 2
    # The second chunk shows nothing, the third as much as the first.
    found = names(segment_order.order_segments(chunks, shares(1, 0, 1), 0))
    assert found == ["head0", "head1", "head2", "refinement0"]


PARTS = st.builds(
    SegmentGain, st.integers(1, 10**6), st.floats(0, 1, allow_subnormal=False)
) | st.none()  # fmt: skip


@settings(derandomize=True, deadline=None, max_examples=150)
@given(
    st.lists(st.tuples(st.integers(1, 10**6), PARTS, PARTS, st.floats(0, 1e6)), max_size=12),
    st.integers(0, 10**5),
)
def test_each_segment_occurs_once_after_those_it_needs(rows, codebooks):
    chunks = [ChunkSegments(head, refinement, tail) for head, refinement, tail, _ in rows]
    missing = shares(*(contribution for *_, contribution in rows))
    found = names(segment_order.order_segments(chunks, missing, codebooks))
    expected = [f"head{n}" for n in range(len(chunks))] + ["codebooks"] * bool(codebooks)
    expected += [f"refinement{n}" for n, c in enumerate(chunks) if c.refinement]
    expected += [f"tail{n}" for n, c in enumerate(chunks) if c.tail]
    assert sorted(found) == sorted(expected)
    assert [n for n in found if n.startswith("head")] == [f"head{n}" for n in range(len(chunks))]
    for place, name in enumerate(found):
        if name.startswith(("refinement", "tail")):
            number = name.removeprefix("refinement").removeprefix("tail")
            assert found.index(f"head{number}") < place
        if codebooks and name.startswith("tail"):
            assert found.index("codebooks") < place


def test_the_error_drop_of_a_tail_is_its_energy():
    rng = np.random.default_rng(1)
    coefficients = rng.normal(size=(20, 8, 3)).astype(np.float32)
    energy = rng.random(20)
    spread = np.zeros((15, 15))
    root = rng.normal(size=(15, 15))
    expected = energy @ np.square(coefficients.astype(float)).sum(axis=(1, 2)) / (4 * np.pi)
    assert segment_order.tail_distortion_drop(coefficients, energy, spread) == pytest.approx(
        expected
    )
    spread = root @ root.T
    expected = np.einsum(
        "n,nkc,kl,nlc->", energy, coefficients.astype(float), spread[:8, :8], coefficients
    )
    assert segment_order.tail_distortion_drop(coefficients, energy, spread) == pytest.approx(
        expected
    )
    assert segment_order.tail_distortion_drop(coefficients[:, :0], energy, spread) == 0


def test_measured_errors_stand_for_missing_shares():
    # Errors of no chunk, one chunk, two chunks (worse), and the whole, whose error is coding error.
    shares = segment_order.missing_shares_from_mse(np.array([0.16, 0.06, 0.065, 0.01]))
    np.testing.assert_allclose(np.diff(shares) <= 0, True)
    np.testing.assert_allclose(segment_order.head_distortion_drops(shares), [0.1, 0.0, 0.05])
    assert segment_order.missing_shares_from_mse(np.array([3.0, 0.0])).tolist() == [1.0, 0.0]
