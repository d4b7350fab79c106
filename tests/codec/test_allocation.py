import math
from dataclasses import replace

import numpy as np
import pytest

from cogsplat.codec import allocation
from cogsplat.codec.score import unscored


def with_energy(values):
    energy = np.array(values, np.float64)
    return replace(unscored(len(energy)), energy=energy)


def test_ten_decibels_are_a_tenth_of_the_slope():
    scores = with_energy([0.0, 1.0, 2.0])
    assert allocation.slope(scores, 30) == pytest.approx(10 * allocation.slope(scores, 40))


def test_a_scene_quantised_at_the_slope_has_the_nominal_error():
    # N splats that each take up one share: their uniform errors, Δ²/12 times energy, add up to it.
    energy = np.random.default_rng(1).lognormal(-12, 2, 5000)
    slope = allocation.slope(with_energy(energy), 36)
    steps = np.sqrt(slope / energy)
    shares = 8
    error = shares * (energy * steps**2 / 12).sum()
    assert -10 * math.log10(error) == pytest.approx(36)


def test_unseen_splats_do_not_count():
    seen = with_energy([1.0, 2.0])
    more = with_energy([1.0, 2.0, 0.0, 0.0])
    assert allocation.slope(seen, 36) == allocation.slope(more, 36)
    assert allocation.slope(unscored(4), 36) == allocation.slope(with_energy([1.0]), 36)
    assert math.isfinite(allocation.slope(unscored(0), 36))


def test_no_energy_is_zero():
    energy = np.append(np.zeros(10), np.linspace(1, 2, 101))
    out = allocation.floor_energy(with_energy(energy))
    assert out.min() == pytest.approx(1.01)
    np.testing.assert_array_equal(out[energy > 1.01], energy[energy > 1.01])
    np.testing.assert_array_equal(out[:10], out.min())
    assert (allocation.floor_energy(unscored(5)) == 1).all()
    assert allocation.floor_energy(unscored(0)).shape == (0,)
    assert (allocation.floor_energy(with_energy([0.0, 5e-324])) > 0).all()


def test_steps_spend_the_same_slope():
    rng = np.random.default_rng(2)
    for cost in (1.0, 0.02):
        energy = rng.lognormal(-10, 3, 100)
        step = allocation.step(1e-6, cost, energy)
        assert cost * energy.mean() * step**2 == pytest.approx(1e-6)


def test_mean_steps_follow_the_size_of_the_splats():
    energy = np.full(50, 1e-4)
    scales = np.random.default_rng(3).normal(-4, 0.5, (50, 3)).astype(np.float32)
    step = allocation.mean_step(1e-6, energy, scales)
    larger = allocation.mean_step(1e-6, energy, scales + np.float32(math.log(2)))
    assert larger == pytest.approx(2 * step, rel=1e-5)
    one = allocation.mean_step(1e-6, energy[:1], np.full((1, 3), math.log(0.1), np.float32))
    assert allocation.MEAN_COST * 1e-4 * (one / 0.1) ** 2 == pytest.approx(1e-6, rel=1e-5)


@pytest.mark.parametrize("scale", [-1e30, -200.0, 200.0, 1e30])
def test_mean_steps_of_extreme_scales_are_numbers_above_zero(scale):
    scales = np.full((3, 3), scale, np.float32)
    step = allocation.mean_step(1e-9, np.full(3, 1e-3), scales)
    assert 0 < step < math.inf
