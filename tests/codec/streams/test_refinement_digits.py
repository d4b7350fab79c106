"""Digits: a head's coarse codes and the digits of its refinement are the codes on the fine grid."""

import numpy as np
import pytest

from cogsplat.codec.errors import FormatError
from cogsplat.codec.streams import grid_planes, kinds, records, refinement_digits
from cogsplat.codec.streams.grid import Grid
from cogsplat.codec.streams.records import Attribute, Kind, Stream
from cogsplat.codec.streams.stream_inputs import Inputs

f32 = np.float32
ROWS = 200
RADICES = (1, 3, 16)
FINE = Grid(np.array([-1, 0, 2], f32), np.array([0.5, 7, 2.5], f32), np.array([9, 700, 4001]))


def stored(stream):
    """Return a stream as a reader finds it."""
    (found,) = records.unpack(memoryview(records.pack([stream])), "chunk 7", ROWS)
    return found


def coarse_grid(radices=RADICES):
    factors = np.array(radices)
    return Grid(FINE.minimum, FINE.maximum, -(-FINE.levels // factors))


def streams(codes, radices=RADICES):
    coarse = coarse_grid(radices)
    planes = grid_planes.split_components((codes // np.array(radices)).astype(np.uint32), coarse)
    head = Stream(Attribute.SH0, Kind.SCALAR, ROWS, coarse.pack(), planes)
    return head, refinement_digits.write(Attribute.SH0, codes, FINE, radices)


def fine_codes(seed=1):
    rng = np.random.default_rng(seed)
    codes = rng.integers(0, FINE.levels, (ROWS, 3)).astype(np.uint32)
    codes[0], codes[1] = 0, FINE.levels - 1
    return codes


def read(head, digits):
    out, alone = np.empty((ROWS, 3), f32), np.empty((ROWS, 3), f32)
    kinds.read(stored(head), out, Inputs(refinement=stored(digits), coarse=alone))
    return out, alone


def test_head_and_digits_give_the_fine_codes():
    codes = fine_codes()
    out, alone = read(*streams(codes))
    np.testing.assert_array_equal(out, FINE.dequantise(codes))
    coarse = (codes // np.array(RADICES)).astype(np.uint32)
    np.testing.assert_array_equal(alone, coarse_grid().dequantise(coarse))


def test_a_radix_of_one_takes_no_plane():
    _, digits = streams(fine_codes())
    assert len(digits.planes) == 2
    assert all(plane.max() < radix for plane, radix in zip(digits.planes, RADICES[1:], strict=True))


def refusal(head, digits):
    with pytest.raises(FormatError, match="chunk 7") as caught:
        read(head, digits)
    return caught.value.code, caught.value.clause


@pytest.mark.parametrize("radix", [0, refinement_digits.MAX_RADIX + 1, 255])
def test_other_radices_are_refused(radix):
    head, digits = streams(fine_codes())
    params = bytes(digits.params[:-1]) + bytes([radix])
    wrong = Stream(Attribute.SH0, Kind.DIGITS, ROWS, params, digits.planes)
    assert refusal(head, wrong) == ("refinement-radix", "6.16")


def test_a_digit_of_the_radix_or_above_is_refused():
    head, digits = streams(fine_codes())
    digits.planes[0][5] = RADICES[1]
    assert refusal(head, digits) == ("code-range", "6.16")


def test_a_fine_code_beyond_its_grid_is_refused():
    codes = fine_codes()
    head, digits = streams(codes)
    # The last code of the coarse grid with its largest digit: 233 * 3 + 2 = 701 of 700 levels.
    codes[1, 1] = 233 * 3
    head, digits = streams(codes)
    digits.planes[0][1] = 2
    assert refusal(head, digits) == ("code-range", "6.16")
