from dataclasses import replace

import numpy as np
import oracle
import pytest

from cogsplat.codec.encode.profiles import shapes
from cogsplat.codec.rate.costs import costs
from cogsplat.codec.scoring.contribution import zero_scores
from cogsplat.codec.segments.opacities import MAX_LOGIT
from cogsplat.codec.streams import scale_differences

N = 4000


def scene_and_costs():
    splats = oracle.scene(3, n=N)
    scores = replace(zero_scores(N), energy=np.random.default_rng(4).lognormal(-8, 1, N))
    # Middle, thin, long.
    scales = np.sort(splats.scales, axis=1)[:, [1, 0, 2]]
    return scales, costs(splats, scores)


def area(scales):
    """Logarithm of the product of the two longer axes."""
    return scales[:, 0].astype(np.float64) + scales[:, 2]


@pytest.mark.parametrize("lagrangian", [3e-6, 3e-5])
def test_the_longest_axis_makes_up_for_areas(lagrangian):
    scales, known = scene_and_costs()
    missed = {}
    for areas in (False, True):
        differences, grid = shapes.differences_to_store(scales, known, lagrangian, areas)
        stored = scale_differences.scales_of(grid.dequantise(grid.quantise(differences)))
        missed[areas] = np.exp(area(stored) - area(scales))
    # Every splat's area, and that of all splats.
    assert np.log(missed[True]).std() < np.log(missed[False]).std()
    assert abs(missed[True].mean() - 1) < 0.5 * abs(missed[False].mean() - 1)


def test_steps_cost_lambda_on_every_axis():
    scales, known = scene_and_costs()
    _, grid = shapes.differences_to_store(scales, known, 1e-6, areas=False)
    columns = (known.scale_long, known.scale_middle, known.scale_thin)
    spent = [cost.mean() * step**2 for cost, step in zip(columns, grid.step, strict=True)]
    # A grid has a whole number of levels: its steps are at most those asked for.
    assert all(0.7e-6 < one <= 1.0001e-6 for one in spent)


def test_opacities_give_up_what_areas_gained():
    rng = np.random.default_rng(6)
    scales = rng.normal(-3, 0.5, (200, 3)).astype(np.float32)
    logits = rng.normal(0, 1, 200).astype(np.float32)
    same = shapes.opacities_to_store(logits, scales, scales)
    np.testing.assert_allclose(same[:, 0], logits, rtol=1e-6)
    larger = shapes.opacities_to_store(logits, scales, scales + np.float32(0.02))
    assert (larger < same).all()
    # Half of the change, to the first order: 4 % more area, 2 % less alpha.
    alphas = [1 / (1 + np.exp(-one[:, 0].astype(np.float64))) for one in (same, larger)]
    seen = logits < 2
    np.testing.assert_allclose((alphas[1] / alphas[0])[seen], 0.98, atol=0.002)


def test_opacities_end_where_they_are_stored():
    logits = np.array([-np.inf, -50, 50, np.inf], np.float32)
    scales = np.zeros((4, 3), np.float32)
    found = shapes.opacities_to_store(logits, scales, scales)[:, 0]
    assert found.tolist() == [-MAX_LOGIT, -MAX_LOGIT, MAX_LOGIT, MAX_LOGIT]
