import numpy as np
import pytest

from cogsplat.codec.encode.profiles.refined import (
    NO_REFINEMENT,
    Refined,
    choose_refinement_bits,
    squared_error_drop,
)
from cogsplat.codec.rate import refinement_split
from cogsplat.codec.streams import grid as grids
from cogsplat.codec.streams.records import Attribute, Kind, Stream

N = 3000


def plane(bits, seed=1):
    """A plane of bytes that take so many bits each."""
    return np.random.default_rng(seed).integers(0, 1 << bits, N).astype(np.uint8)


def stream(bits):
    return Stream(Attribute.MEANS, Kind.SCALAR, N, b"", [plane(bits)])


def quantised(penalty):
    """Values of 7 bits, of which some may wait, at so many bits more for each that does."""
    order = np.arange(N)

    def quantise(waiting):
        if not waiting:
            return order, stream(7), NO_REFINEMENT
        head = [plane(7 - waiting), *(plane(1, seed) for seed in range(penalty * waiting))]
        whole = Stream(Attribute.MEANS, Kind.SCALAR, N, b"", head)
        return order, whole, Refined(stream(waiting), float(waiting))

    return quantise


@pytest.mark.parametrize("most", range(6))
def test_all_bits_wait_that_cost_nothing(most):
    _, head, refined = choose_refinement_bits(quantised(0), most)
    assert len(np.unique(head.planes[0])) == 1 << (7 - most)
    assert refined.distortion_drop == most
    assert (refined.stream is None) == (most == 0)


def test_bits_that_cost_as_much_as_they_are_do_not_wait():
    assert choose_refinement_bits(quantised(1), 5)[2] is NO_REFINEMENT


def test_the_drop_is_the_error_that_the_refinement_removes():
    values = np.random.default_rng(2).normal(size=(500, 2)).astype(np.float32)
    grid = grids.fit(values, 0.01)
    parts = refinement_split.split(Attribute.SH0, values, grid, np.ones(500), (8, 8))
    assert parts.digits is not None
    drop = squared_error_drop(parts, values)
    wide = values.astype(np.float64)
    coarse, fine = (np.square(one - wide) for one in (parts.coarse, parts.fine))
    np.testing.assert_allclose(drop, coarse - fine)
    assert drop.sum() > 30 * fine.sum()
