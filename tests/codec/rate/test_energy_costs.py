import math

import numpy as np
import pytest

from cogsplat.codec.rate import costs as rate_costs
from cogsplat.codec.rate.energy_costs import SHN_COST, EnergyCosts
from cogsplat.codec.streams.records import Attribute


def test_steps_make_cost_times_square_equal_lambda():
    rng = np.random.default_rng(2)
    for attribute, cost in (
        (Attribute.OPACITIES, rate_costs.OPACITY_COST),
        (Attribute.SH0, rate_costs.SH0_COST),
        (Attribute.QUATS, rate_costs.ROTATION_COST),
    ):
        energy = rng.lognormal(-10, 3, 100)
        step = EnergyCosts(1e-6, energy).step(attribute)
        assert cost * energy.mean() * step**2 == pytest.approx(1e-6)


def test_mean_steps_follow_the_size_of_the_splats():
    energy = np.full(50, 1e-4)
    scales = np.random.default_rng(3).normal(-4, 0.5, (50, 3)).astype(np.float32)
    step = EnergyCosts(1e-6, energy).mean_step(scales)
    larger = EnergyCosts(1e-6, energy).mean_step(scales + np.float32(math.log(2)))
    assert larger == pytest.approx(2 * step, rel=1e-5)
    tenth = np.full((1, 3), math.log(0.1), np.float32)
    one = EnergyCosts(1e-6, energy[:1]).mean_step(tenth)
    assert rate_costs.MEAN_COST * 1e-4 * (one / 0.1) ** 2 == pytest.approx(1e-6, rel=1e-5)


@pytest.mark.parametrize("scale", [-1e30, -200.0, 200.0, 1e30])
def test_mean_steps_of_extreme_scales_are_numbers_above_zero(scale):
    scales = np.full((3, 3), scale, np.float32)
    step = EnergyCosts(1e-9, np.full(3, 1e-3)).mean_step(scales)
    assert 0 < step < math.inf


def test_rows_that_weigh_more_have_finer_steps():
    energy = np.geomspace(1e-9, 1e3, 40)
    costs = EnergyCosts(1e-7, energy)
    light, heavy = costs.take(np.arange(20)), costs.take(energy > energy[19])
    for attribute in (Attribute.SCALES, Attribute.SCALE_FACTOR, Attribute.SHN):
        assert heavy.step(attribute) < costs.step(attribute) < light.step(attribute)


def test_the_cost_of_shn_is_the_mean_square_of_a_basis():
    assert pytest.approx(1 / (4 * math.pi), rel=1e-3) == SHN_COST


def test_means_have_no_step_without_sizes():
    with pytest.raises(KeyError):
        EnergyCosts(1e-7, np.ones(3)).step(Attribute.MEANS)
