import math
from dataclasses import replace

import numpy as np
import oracle
import pytest

from cogsplat.codec.rate import allocation
from cogsplat.codec.rate import costs as rate_costs
from cogsplat.codec.render.sensitivities import Sensitivities
from cogsplat.codec.scoring.contribution import zero_scores


def with_energy(values):
    energy = np.array(values, np.float64)
    return replace(zero_scores(len(energy)), energy=energy)


def test_ten_decibels_are_a_tenth_of_lambda_below_the_coarsest_steps():
    scores = with_energy([0.0, 1.0, 2.0])
    assert allocation.lagrangian(scores, 30) == pytest.approx(
        10 * allocation.lagrangian(scores, 40)
    )


@pytest.mark.parametrize("sparse", [False, True])
@pytest.mark.parametrize("quality_db", [22.0, 36.0, 50.0])
def test_a_scene_quantised_at_the_slope_has_the_nominal_error(quality_db, sparse):
    # The uniform errors of N splats, Δ²/12 times energy, add up to the nominal error.
    # Many splats are so faint that their steps are the coarsest. Some have finer steps than their
    # mean energy gives, because one view shows them best.
    rng = np.random.default_rng(1)
    energy = rng.lognormal(-12, 3, 5000)
    largest = energy * rng.lognormal(3, 1, 5000)
    scores = replace(with_energy(energy), largest_energy=largest, sparse=sparse)
    lagrangian = allocation.lagrangian(scores, quality_db)
    shown = rate_costs.robust_energy(scores)
    assert (shown > energy).any()
    coarsest = rate_costs.coarsest_colour(scores)
    assert coarsest == (0.05 if sparse else 0.15)
    steps = np.sqrt(lagrangian / rate_costs.limit_colour_steps(shown, lagrangian, coarsest))
    assert 0.999 * coarsest < steps.max() < 1.001 * coarsest
    shares = 24.5
    error = shares * (energy * steps**2 / 12).sum()
    assert -10 * math.log10(error) == pytest.approx(quality_db)


def test_lambda_rises_even_where_all_steps_are_the_coarsest():
    scores = with_energy([1e-9, 2e-9])
    found = [allocation.lagrangian(scores, quality) for quality in (40.0, 30.0, 20.0, 10.0)]
    assert found == sorted(found)
    assert found[0] < found[-1]
    assert np.isfinite(found).all()


def test_unseen_splats_do_not_count():
    seen = with_energy([1.0, 2.0])
    more = with_energy([1.0, 2.0, 0.0, 0.0])
    assert allocation.lagrangian(seen, 36) == allocation.lagrangian(more, 36)
    assert allocation.lagrangian(zero_scores(4), 36) == allocation.lagrangian(
        with_energy([1.0]), 36
    )
    assert math.isfinite(allocation.lagrangian(zero_scores(0), 36))


def test_positive_energies_are_above_zero():
    energy = np.append(np.zeros(10), np.linspace(1, 2, 101))
    out = rate_costs.positive_energy(with_energy(energy))
    assert out.min() == pytest.approx(1.01)
    np.testing.assert_array_equal(out[energy > 1.01], energy[energy > 1.01])
    np.testing.assert_array_equal(out[:10], out.min())
    assert (rate_costs.positive_energy(zero_scores(5)) == 1).all()
    assert rate_costs.positive_energy(zero_scores(0)).shape == (0,)
    assert (rate_costs.positive_energy(with_energy([0.0, 5e-324])) > 0).all()


def test_a_splat_counts_at_least_a_share_of_its_best_view():
    scores = replace(with_energy([1.0, 1.0, 0.0]), largest_energy=np.array([1.0, 64.0, 0.0]))
    np.testing.assert_array_equal(rate_costs.robust_energy(scores), [1.0, 2.0, 0.0])
    np.testing.assert_array_equal(rate_costs.positive_energy(scores), [1.0, 2.0, 1.0])


def test_sensitivities_rise_with_the_energy_of_the_best_view():
    splats, scores = a_scene()
    found = replace(scores, sensitivities=sensitive(80, scale=1e9))
    best = replace(found, largest_energy=32.0 * 4.0 * scores.energy)
    plain, raised = rate_costs.costs(splats, found), rate_costs.costs(splats, best)
    fainter = scores.energy < np.quantile(scores.energy, 0.01)
    for name in VALUES:
        ratio = getattr(raised, name) / getattr(plain, name)
        np.testing.assert_allclose(ratio[~fainter], 4.0, rtol=1e-9, err_msg=name)


def test_splats_outside_the_measured_views_have_typical_costs():
    splats, scores = a_scene()
    found = sensitive(80, scale=1e9)
    for values in (found.opacities, found.means, found.scales, found.rotations):
        values[:7] = 0.0
    measured = rate_costs.costs(splats, replace(scores, sensitivities=found))
    usual = rate_costs.costs(splats, scores)
    for name in VALUES:
        np.testing.assert_array_equal(getattr(measured, name)[:7], getattr(usual, name)[:7])
        if name != "energy":
            assert (getattr(measured, name)[7:] > getattr(usual, name)[7:]).all()


def test_costs_chunk_by_chunk_are_those_of_the_whole():
    splats, scores = a_scene()
    scores = replace(scores, sensitivities=sensitive(80, scale=1e3))
    whole = rate_costs.costs(splats, scores)
    energy = rate_costs.positive_energy(scores)
    for run in (slice(0, 30), slice(30, 31), slice(31, 80)):
        rows = np.arange(80)[run]
        part = rate_costs.costs(splats.take(run), scores.take(rows), energy[run])
        for name in (*VALUES, "basis_mean"):
            expected = getattr(whole.take(run), name)
            np.testing.assert_array_equal(getattr(part, name), expected, err_msg=name)


# Costs.

VALUES = (
    "energy", "mean", "opacity", "scale_long", "scale_middle", "scale_thin", "swing", "twist",
)  # fmt: skip


def sensitive(rows, seed=4, scale=1.0):
    rng = np.random.default_rng(seed)

    def some(*shape):
        return scale * rng.lognormal(-3, 1, (rows, *shape))

    return Sensitivities(some(), some(3), some(3), some(3), some(3))


def a_scene(rows=80, seed=5):
    splats = oracle.scene(seed, n=rows)
    energy = np.random.default_rng(seed).lognormal(-9, 2, rows)
    return splats, replace(zero_scores(rows), energy=energy)


def test_costs_are_above_zero_with_and_without_sensitivities():
    splats, scores = a_scene()
    for energy in (scores.energy, np.zeros(80), np.geomspace(1e-200, 1e3, 80)):
        for found in (None, sensitive(80), sensitive(80, scale=0.0)):
            given = replace(scores, energy=energy, sensitivities=found)
            costs = rate_costs.costs(splats, given)
            for name in VALUES:
                values = getattr(costs, name)
                assert values.shape == (80,)
                assert ((values > 0) & np.isfinite(values)).all(), name
            assert costs.basis_mean.shape == (80, 15)


def test_permuting_the_axes_of_a_splat_changes_no_cost():
    splats, scores = a_scene()
    found = sensitive(80)
    turned = [1, 2, 0]
    other = replace(found, scales=found.scales[:, turned], rotations=found.rotations[:, turned])
    for one, two in ((None, None), (found, other)):
        plain = rate_costs.costs(splats, replace(scores, sensitivities=one))
        named = rate_costs.costs(
            replace(splats, scales=splats.scales[:, turned]), replace(scores, sensitivities=two)
        )
        for name in VALUES:
            np.testing.assert_allclose(getattr(named, name), getattr(plain, name), rtol=1e-12)


def test_costs_follow_sensitivities():
    splats, scores = a_scene()
    found = sensitive(80, scale=1e9)  # far above any floor
    costs = rate_costs.costs(splats, replace(scores, sensitivities=found))
    by_size = np.take_along_axis(found.scales, np.argsort(splats.scales, axis=1), axis=1)
    for name, expected in (
        ("mean", found.means.mean(axis=1)),
        ("opacity", found.opacities),
        ("scale_long", found.scales.sum(axis=1)),
        ("scale_middle", by_size[:, :2].sum(axis=1)),
        ("scale_thin", by_size[:, 0]),
        (
            "twist",
            np.take_along_axis(found.rotations, np.argsort(splats.scales, axis=1), axis=1)[:, 2],
        ),
    ):
        ratio = getattr(costs, name) / expected
        np.testing.assert_allclose(ratio, ratio[0], rtol=1e-9)
        assert 0.5 < ratio[0] < 5


def test_larger_sensitivities_and_energies_cost_more():
    splats, scores = a_scene()
    for low, high in (
        (scores, replace(scores, energy=10 * scores.energy)),
        (
            replace(scores, sensitivities=sensitive(80)),
            replace(scores, sensitivities=sensitive(80, scale=10.0)),
        ),
    ):
        one, two = rate_costs.costs(splats, low), rate_costs.costs(splats, high)
        for name in VALUES:
            assert (getattr(two, name) >= getattr(one, name)).all()
            assert name == "energy" or (getattr(two, name) > getattr(one, name)).any()


def test_costs_are_sliced_and_equalised():
    splats, scores = a_scene()
    costs = rate_costs.costs(splats, replace(scores, sensitivities=sensitive(80)))
    rows = np.array([5, 2, 2, 79])
    part, level = costs.take(rows), costs.equalise()
    for name in VALUES:
        values = getattr(costs, name)
        np.testing.assert_array_equal(getattr(part, name), values[rows])
        np.testing.assert_allclose(getattr(level, name), values.mean())
    np.testing.assert_array_equal(part.basis_mean, costs.basis_mean[rows])
    np.testing.assert_array_equal(level.basis_mean, costs.basis_mean)


def test_steps_follow_the_mean_cost_or_each_cost():
    cost = np.random.default_rng(6).lognormal(-5, 2, 300)
    assert cost.mean() * allocation.equal_step(1e-7, cost) ** 2 == pytest.approx(1e-7)
    np.testing.assert_allclose(cost * allocation.step_per_value(1e-7, cost) ** 2, 1e-7)
    assert allocation.shn_step(1e-7, 4 * cost) == pytest.approx(allocation.shn_step(1e-7, cost) / 2)


@pytest.mark.parametrize("cost", [1e-300, 1e-60, 1e60, 1e300])
def test_steps_of_extreme_costs_fit_the_format(cost):
    for lagrangian in (1e-20, 1e-3, 10.0):
        step = allocation.equal_step(lagrangian, np.full(4, cost))
        assert 0 < step <= 2.0**32
        assert 0 < allocation.shn_step(lagrangian, np.full(4, cost)) <= 2.0**32


def test_limits_bound_every_step():
    splats, scores = a_scene()
    for lagrangian in (1e-9, 1.0):
        costs = rate_costs.costs(splats, replace(scores, energy=np.full(80, 1e-12)))
        limited = rate_costs.limit_steps(costs, splats.scales, lagrangian)
        for name in VALUES:
            assert (getattr(limited, name) >= getattr(costs, name)).all()
        assert allocation.step_per_value(lagrangian, limited.opacity).max() <= 2
        assert allocation.step_per_value(lagrangian, limited.scale_long).max() <= 1
        size = np.exp(splats.scales.astype(float).mean(axis=1))
        assert (allocation.step_per_value(lagrangian, limited.mean) <= 2 * size).all()
        thin, middle, long = np.exp(np.sort(splats.scales.astype(float), axis=1)).T
        for length, cost in ((long, limited.swing), (middle, limited.twist)):
            thicker = (length**2 - thin**2) * lagrangian / cost
            assert (thicker <= np.maximum(thin, 0.3 * length) ** 2 * (1 + 1e-6)).all()
    strong = rate_costs.costs(splats, replace(scores, energy=np.full(80, 1e3)))
    same = rate_costs.limit_steps(strong, splats.scales, 1e-9)
    for name in VALUES:
        np.testing.assert_array_equal(getattr(same, name), getattr(strong, name))
