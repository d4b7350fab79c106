"""Morton codes: interleaved bits of three coordinates, and the spatial order."""

import numpy as np
import pytest

from cogsplat.codec.geometry.morton import deinterleave, interleave, spatial_order


@pytest.mark.parametrize("bits", [1, 10, 21])
def test_codes_hold_the_bits_of_x_y_z_in_turn(bits: int) -> None:
    rng = np.random.default_rng(bits)
    codes = rng.integers(0, 1 << bits, (50, 3)).astype(np.uint32)
    found = interleave(codes)
    for row, code in zip(codes.tolist(), found.tolist(), strict=True):
        x, y, z = ({k for k in range(bits) if value >> k & 1} for value in row)
        expected = {3 * k for k in x} | {3 * k + 1 for k in y} | {3 * k + 2 for k in z}
        assert {k for k in range(3 * bits) if code >> k & 1} == expected
    np.testing.assert_array_equal(deinterleave(found), codes)


def test_spatial_order_keeps_neighbours_together_despite_outliers() -> None:
    rng = np.random.default_rng(7)
    means = rng.uniform(-1.0, 1.0, (2000, 3)).astype(np.float32)
    means[:5] *= 1e7
    ordered = means[spatial_order(means)]
    inner = np.abs(ordered).max(axis=1) <= 1.0
    steps = np.linalg.norm(np.diff(ordered[inner], axis=0), axis=1)
    assert np.median(steps) < 0.25, "shuffled, it would be about 1.3"


def test_spatial_order_separates_thousands_of_neighbours() -> None:
    along = np.random.default_rng(3).permutation(5000).astype(np.float32)
    diagonal = np.stack([along, along, along], axis=1)
    np.testing.assert_array_equal(spatial_order(diagonal), np.argsort(along))
