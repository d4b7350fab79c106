import numpy as np
import oracle
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cogsplat.codec.segments.prefix_compensation import (
    Compensation,
    Layer,
    code_bits,
    pack_codes,
    packed_bytes,
    unpack_codes,
)


def _layer(scales, opacities, strengths, book=(), codes=()):
    return Layer(
        np.array(scales, np.int8),
        np.array(opacities, np.int8),
        np.array(strengths, np.uint8).reshape(-1, 2),
        np.array(book, np.int8).reshape(-1, 2),
        np.array(codes, np.uint8),
    )


@pytest.fixture
def compensation():
    first = _layer([64], [32], [64, 64], [[0, 0], [128 - 1, -16]], [0, 1])
    second = _layer([32, 16, 8], [16, 16, 16], [[32, 16], [64, 64], [64, 0]], [[-64, 8]], [0, 0, 0])
    return Compensation((first, second), np.array([2, 2, 1, 3, 2]))


def shifts(compensation, chunks):
    """Return what is added to the first chunks of a scene."""
    return compensation.shifts_of(np.arange(chunks), np.full(chunks, chunks, np.int64))


def test_shifts_of_a_layer_are_its_chunks_and_its_codes(compensation):
    expected = [[0.5, 2.0], [0.5 + 127 / 128, 1.0]]
    np.testing.assert_array_equal(shifts(compensation, 1), np.array(expected, np.float32))
    expected = [
        [0.25, 1.0],
        [0.25 + 127 / 256, 1.0 - 0.25],
        [0.125 - 0.5, 1.5],
        [0.125 - 0.5, 1.5],
        [0.0625 - 0.5, 1.0],
    ]
    np.testing.assert_array_equal(shifts(compensation, 3), np.array(expected, np.float32))


def test_between_layers_shifts_pass_from_one_to_the_other(compensation):
    one, three = shifts(compensation, 1), shifts(compensation, 3)
    two = shifts(compensation, 2)
    # Two of the three splats that the second layer adds are there.
    part = np.float32(2 / 3)
    np.testing.assert_array_equal(two[:2], one + (three[:2] - one) * part)
    np.testing.assert_array_equal(two[2:], three[2:4])
    # Behind the last layer it is undone: three of five splats more are there.
    four = shifts(compensation, 4)
    np.testing.assert_array_equal(four[:5], three + (0 - three) * np.float32(3 / 5))
    np.testing.assert_array_equal(four[5:], 0)


def test_before_the_first_layer_its_shifts_hold():
    late = Compensation((_layer([1, 2], [3, 4], [0] * 4),), np.array([1, 1, 1]))
    np.testing.assert_array_equal(shifts(late, 1), shifts(late, 2)[:1])


def test_apply_adds_in_float32(compensation):
    splats = oracle.scene(3, n=5)
    splats.opacities[1] = np.inf
    found = compensation.apply(splats, 3)
    added = shifts(compensation, 3)
    np.testing.assert_array_equal(found.scales, splats.scales + added[:, :1])
    np.testing.assert_array_equal(found.opacities, splats.opacities + added[:, 1])
    assert found.opacities[1] == np.inf
    assert found.scales.dtype == found.opacities.dtype == np.float32
    assert found.means is splats.means


def test_nothing_is_added_to_the_whole_or_to_none(compensation):
    whole, none = oracle.scene(1, n=10), oracle.scene(1, n=0)
    assert compensation.apply(whole, 5) is whole
    assert compensation.apply(none, 0) is none
    without = Compensation((), np.array([5, 5]))
    half = oracle.scene(1, n=5)
    assert without.apply(half, 1) is half


@pytest.mark.parametrize("chunks", [-1, 2, 6])
def test_other_splats_are_refused(compensation, chunks):
    with pytest.raises(ValueError, match="splats of"):
        compensation.apply(oracle.scene(1, n=5), chunks)


@given(st.lists(st.integers(0, 255), max_size=40), st.integers(0, 8))
def test_codes_are_packed_as_they_come(values, bits):
    codes = np.array(values, np.uint8) & np.uint8((1 << bits) - 1)
    packed = pack_codes(codes, bits)
    assert len(packed) == packed_bytes(len(codes), bits)
    np.testing.assert_array_equal(unpack_codes(packed, bits, len(codes)), codes)
    # Independent of numpy: one integer, lowest code first.
    number = sum(int(code) << (bits * place) for place, code in enumerate(codes))
    assert int.from_bytes(packed, "little") == number


def test_codes_of_no_bits_take_no_room():
    # A file may state any number of splats in a few bytes.
    codes = unpack_codes(b"", 0, 1 << 40)
    assert codes.shape == (1 << 40,)
    assert codes.dtype == np.uint8
    assert codes.strides == (0,)


def test_bits_of_a_book():
    assert [code_bits(rows) for rows in (0, 1, 2, 3, 4, 5, 8, 9, 256)] == [
        0,
        0,
        1,
        2,
        2,
        3,
        3,
        4,
        8,
    ]


def test_chunks_are_shifted_as_in_prefixes_of_their_own(compensation):
    chunks, prefixes = np.array([0, 2, 3]), np.array([2, 4, 5])
    splats = oracle.scene(2, n=6)
    splats.opacities[-1] = np.float32(-0.0)
    found = compensation.apply_per_chunk(splats, chunks, prefixes)
    two, four = shifts(compensation, 2), shifts(compensation, 4)
    np.testing.assert_array_equal(found.scales[:2], splats.scales[:2] + two[:2, :1])
    np.testing.assert_array_equal(found.opacities[2], splats.opacities[2] + four[4, 1])
    # Nothing is added in the whole scene: bits stay.
    assert found.scales[3:].tobytes() == splats.scales[3:].tobytes()
    assert found.opacities[3:].tobytes() == splats.opacities[3:].tobytes()
    assert found.means is splats.means


def test_each_chunk_in_the_prefix_of_all_is_the_prefix(compensation):
    splats = oracle.scene(2, n=8)
    whole = compensation.apply(splats, 4)
    each = compensation.apply_per_chunk(splats, np.arange(4), np.full(4, 4))
    np.testing.assert_array_equal(whole.scales, each.scales)
    np.testing.assert_array_equal(whole.opacities, each.opacities)


def test_splats_of_other_chunks_are_refused(compensation):
    with pytest.raises(ValueError, match="5 splats of 2 chunks, expected the 3"):
        compensation.apply_per_chunk(oracle.scene(1, n=5), np.array([0, 2]), np.array([3, 3]))
