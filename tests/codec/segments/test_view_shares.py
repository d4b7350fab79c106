from fractions import Fraction

import numpy as np
import pytest

from cogsplat.codec.errors import FormatError
from cogsplat.codec.segments.view_shares import (
    ViewTable,
    encode_shares,
    pack_codes,
    unpack_codes,
)


def table_of(codes):
    return ViewTable(np.zeros((len(codes), 3), np.float32), codes)


def test_codes_stand_for_half_octaves_exactly():
    shares = table_of(np.arange(256, dtype=np.uint8)[None]).shares[0]
    assert shares[0] == 0.0
    for code in range(1, 256):
        exact = Fraction(2 + code % 2) * Fraction(2) ** (code // 2 - 128)
        assert Fraction(float(shares[code])) == exact
    assert shares[254] == 1.0
    assert (np.diff(shares) > 0).all()


def test_shares_become_the_nearest_code():
    shares = np.concatenate([[0.0, 1.0], np.geomspace(1e-30, 1.0, 1000)])
    found = table_of(encode_shares(shares)[None]).shares[0]
    assert found[0] == 0.0
    off = np.abs(found[1:] / shares[1:] - 1)
    # Half of the widest step: from 2 to 3 of something.
    assert off.max() <= 0.25
    every = table_of(np.arange(256, dtype=np.uint8)[None]).shares[0]
    nearest = np.abs(shares[:, None] - every).min(axis=1)
    np.testing.assert_array_equal(np.abs(found - shares), nearest)


@pytest.mark.parametrize("views", [1, 3, 64])
def test_codes_come_back(views):
    rng = np.random.default_rng(views)
    codes = rng.integers(0, 256, (views, 17), np.uint8)
    packed = pack_codes(codes)
    np.testing.assert_array_equal(unpack_codes(packed, views, 17, "here"), codes)
    # Viewpoints that see alike take hardly more than one of them.
    same = np.repeat(codes[:1], views, axis=0)
    assert len(pack_codes(same)) <= 17 + 24
    np.testing.assert_array_equal(unpack_codes(pack_codes(same), views, 17, "here"), same)
    with pytest.raises(FormatError) as caught:
        unpack_codes(packed, views, 18, "here")
    assert caught.value.code in ("plane-length", "zstd-size")
