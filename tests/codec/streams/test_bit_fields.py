import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cogsplat.codec.errors import FormatError
from cogsplat.codec.streams import bit_fields

checked = settings(derandomize=True, deadline=None, max_examples=200)
WIDTHS = st.integers(0, bit_fields.MAX_WIDTH)


def as_one_number(values, widths):
    """Fields one behind the other in one large integer, written little-endian."""
    total, number = 0, 0
    for value, width in zip(values, widths, strict=True):
        number |= (value & ((1 << width) - 1)) << total
        total += width
    return number.to_bytes(-(-total // 8), "little")


@checked
@given(st.lists(st.tuples(WIDTHS, st.integers(0, 2**64 - 1)), max_size=60))
def test_fields_stand_one_behind_the_other(fields):
    widths = np.array([width for width, _ in fields], np.uint8)
    values = np.array([value for _, value in fields], np.uint64)
    packed = bit_fields.pack(values, widths)
    assert packed.tobytes() == as_one_number(values.tolist(), widths.tolist())
    assert len(packed) == bit_fields.packed_bytes(widths)
    out = bit_fields.unpack(packed, widths, "plane")
    assert out.tolist() == [value & ((1 << width) - 1) for width, value in fields]


@pytest.mark.parametrize("offset", range(8))
def test_every_width_is_read_at_every_offset(offset):
    for width in range(bit_fields.MAX_WIDTH + 1):
        widths = np.array([offset, width, width, 1], np.uint8)
        top = (1 << width) - 1
        values = [0, top, 0x2AAAAAAAAAAAAAAA & top, 1]
        packed = np.frombuffer(as_one_number(values, widths.tolist()), np.uint8)
        assert bit_fields.unpack(packed, widths, "plane").tolist() == values


def test_no_fields_and_fields_of_no_width_take_no_byte():
    for count in (0, 1, 9):
        widths = np.zeros(count, np.uint8)
        packed = bit_fields.pack(np.full(count, 7, np.uint64), widths)
        assert len(packed) == bit_fields.packed_bytes(widths) == 0
        assert bit_fields.unpack(packed, widths, "plane").tolist() == [0] * count


def test_lengths_of_many_rows_do_not_wrap():
    assert bit_fields.packed_bytes(np.full(1 << 18, 45, np.uint8)) == 45 << 15


@checked
@given(st.lists(WIDTHS, min_size=1, max_size=20), st.integers(0, 7))
def test_padding_that_is_set_is_refused(widths, bit):
    widths = np.array(widths, np.uint8)
    used = int(widths.sum()) % 8
    packed = bit_fields.pack(np.zeros(len(widths), np.uint64), widths)
    if not len(packed) or not used:
        return
    packed[-1] = 1 << bit
    if bit < used:
        assert bit_fields.unpack(packed, widths, "plane 3").sum() > 0
        return
    with pytest.raises(FormatError, match="plane 3") as caught:
        bit_fields.unpack(packed, widths, "plane 3")
    assert (caught.value.code, caught.value.clause) == ("bits-padding", "6.15")
