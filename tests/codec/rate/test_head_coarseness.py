import numpy as np
import pytest

from cogsplat.codec.rate.head_coarseness import FINE, head_coarseness
from cogsplat.codec.streams.refinement_digits import MAX_RADIX

RUNS = [slice(0, 100), slice(100, 400), slice(400, 1000)]
# Contribution in the order by contribution: the first chunks hold most of it.
CONTRIBUTION = np.sort(np.random.default_rng(1).lognormal(0, 2, 1000))[::-1]


def coarseness(lagrangian, missing_all=0.15):
    return head_coarseness(CONTRIBUTION, lagrangian, RUNS, missing_all)


def test_every_head_has_its_own_coarseness():
    found = coarseness(1e-9)
    assert list(found) == [0, 100, 400]
    for one in found.values():
        assert len(one.scales) == len(one.sh0) == 3
        assert all(1 <= r <= MAX_RADIX for r in (*one.scales, *one.opacities, *one.sh0))


def test_heads_that_show_more_for_their_bits_are_coarser():
    first, second, third = coarseness(1e-9).values()
    assert first.means >= second.means >= third.means
    assert first.scales[0] > third.scales[0]


@pytest.mark.parametrize("power", range(-10, -5))
def test_a_quarter_of_lambda_moves_one_more_bit_to_the_refinement(power):
    some, more = (coarseness(lagrangian) for lagrangian in (10.0**power, 10.0**power / 4))
    for one, other in zip(some.values(), more.values(), strict=True):
        assert other.means - one.means in ((1,) if one.means > 0 and other.means < 5 else (0, 1))
        assert 1 <= other.scales[0] / one.scales[0] <= 2.7


def test_heads_that_show_nothing_are_fine():
    assert set(coarseness(1e-9, missing_all=0.0).values()) == {FINE}
    assert set(coarseness(1e3).values()) == {FINE}
