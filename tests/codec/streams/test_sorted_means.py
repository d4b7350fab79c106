import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cogsplat.codec.errors import FormatError
from cogsplat.codec.geometry import morton
from cogsplat.codec.streams import sorted_means

checked = settings(derandomize=True, deadline=None, max_examples=150)
axis_code = st.integers(0, morton.MAX_LEVELS - 1)
code63 = st.integers(0, 2**63 - 1)


def interleaved(x, y, z):
    """Bit by bit: bit b of x, y and z becomes bit 3b, 3b + 1 and 3b + 2."""
    out = 0
    for bit in range(21):
        for axis, value in enumerate((x, y, z)):
            out |= (value >> bit & 1) << (3 * bit + axis)
    return out


def packed(codes):
    """Classes and bits of ascending codes through one big integer (SPEC 6.5)."""
    classes, stream, length, before = [], 0, 0, 0
    for code in codes:
        delta, before = code - before, code
        classes.append(delta.bit_length())
        rest = max(delta.bit_length() - 1, 0)
        stream |= (delta & ((1 << rest) - 1)) << length
        length += rest
    return classes, stream.to_bytes((length + 7) // 8, "little")


def planes_of(codes):
    classes, bits = packed(codes)
    return np.array(classes, np.uint8), np.frombuffer(bits, np.uint8)


@checked
@given(st.lists(st.tuples(axis_code, axis_code, axis_code), max_size=20))
def test_interleaving_matches_a_loop_over_bits(rows):
    codes = np.array(rows, np.uint32).reshape(-1, 3)
    actual = morton.interleave(codes)
    assert actual.dtype == np.uint64
    assert actual.tolist() == [interleaved(*row) for row in rows]
    np.testing.assert_array_equal(morton.deinterleave(actual), codes)


def test_every_single_bit_goes_to_its_place_and_back():
    for axis in range(3):
        codes = np.zeros((21, 3), np.uint32)
        codes[:, axis] = 1 << np.arange(21)
        actual = morton.interleave(codes)
        assert actual.tolist() == [1 << (3 * bit + axis) for bit in range(21)]
        np.testing.assert_array_equal(morton.deinterleave(actual), codes)
    full = np.full((1, 3), morton.MAX_LEVELS - 1, np.uint32)
    assert morton.interleave(full).tolist() == [2**63 - 1]


@checked
@given(st.lists(code63, max_size=40))
def test_packing_matches_a_big_integer(codes):
    codes = sorted(codes)
    classes, bits = sorted_means.pack_deltas(np.array(codes, np.uint64))
    assert (classes.tolist(), bits.tobytes()) == packed(codes)
    assert classes.dtype == bits.dtype == np.uint8


@checked
@given(st.lists(st.one_of(code63, st.integers(0, 300)), max_size=40))
def test_unpacking_matches_what_was_packed(codes):
    codes = sorted(codes)
    classes, bits = planes_of(codes)
    assert sorted_means.bits_length(classes, "here") == len(bits)
    assert sorted_means.unpack_deltas(classes, bits, "here").tolist() == codes


def test_every_width_at_every_bit_offset():
    for offset in range(8):
        for width in range(63):
            # `offset` deltas of one bit each come first, then one of `width` bits, then one more.
            deltas = [3] * offset + [(1 << width) | ((1 << width) - 1) // 3, 2]
            codes = np.cumsum(deltas, dtype=np.uint64)
            if int(codes[-1]) < 2**63:
                classes, bits = planes_of(codes.tolist())
                np.testing.assert_array_equal(sorted_means.unpack_deltas(classes, bits, ""), codes)


def test_sorted_duplicates_and_nothing_at_all():
    same = np.full(5, 2**63 - 1, np.uint64)
    classes, bits = sorted_means.pack_deltas(same)
    assert classes.tolist() == [63, 0, 0, 0, 0]
    assert len(bits) == 8
    np.testing.assert_array_equal(sorted_means.unpack_deltas(classes, bits, ""), same)
    for codes in ([], [0], [0, 0, 0]):
        classes, bits = sorted_means.pack_deltas(np.array(codes, np.uint64))
        assert classes.tolist() == [0] * len(codes)
        assert bits.size == 0
        assert sorted_means.bits_length(classes, "") == 0
        assert sorted_means.unpack_deltas(classes, bits, "").tolist() == codes


@pytest.mark.parametrize("top", [64, 65, 255])
def test_classes_above_63_are_refused(top):
    with pytest.raises(FormatError, match="head 3: class") as caught:
        sorted_means.bits_length(np.array([1, top], np.uint8), "head 3")
    assert (caught.value.code, caught.value.clause) == ("morton-class", "6.5")


def test_bits_behind_the_last_difference_are_refused():
    for total in range(1, 17):
        classes = np.full(total, 2, np.uint8)
        bits = np.zeros((total + 7) // 8, np.uint8)
        sorted_means.unpack_deltas(classes, bits, "")
        for spare in range(total, 8 * len(bits)):
            broken = bits.copy()
            broken[spare // 8] |= 1 << spare % 8
            with pytest.raises(FormatError) as caught:
                sorted_means.unpack_deltas(classes, broken, "")
            assert caught.value.code == "morton-padding"


@pytest.mark.parametrize("count", [2, 3, 4, 5, 100])
def test_sums_beyond_63_bits_are_refused_even_where_they_wrap(count):
    # Differences of 2^62 to 2^63 - 1: four of the least, or three of the most, wrap past 64 bits.
    for fill in (0, 255):
        classes = np.full(count, 63, np.uint8)
        length = sorted_means.bits_length(classes, "")
        bits = np.full(length, fill, np.uint8)
        if fill and 62 * count % 8:
            bits[-1] = (1 << 62 * count % 8) - 1
        with pytest.raises(FormatError) as caught:
            sorted_means.unpack_deltas(classes, bits, "here")
        assert caught.value.code == "morton-range"
