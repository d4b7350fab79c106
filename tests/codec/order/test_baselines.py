"""Baseline orders against their formulas."""

import numpy as np
import oracle
import pytest
from scipy.special import expit

from cogsplat.codec.order import baselines


def test_rows_come_by_descending_priority():
    priority = np.array([1.0, np.nan, 3.0, 1.0, -np.inf, 3.0])
    assert baselines.sort_descending(priority).tolist() == [2, 5, 0, 3, 4, 1]


@pytest.mark.parametrize("seed", range(2))
def test_priorities_are_those_of_the_formulas(seed):
    splats = oracle.scene(seed, n=50)
    volume = np.exp(splats.scales.astype(np.float64)).prod(axis=1)
    opacity = expit(splats.opacities.astype(np.float64))
    for found, expected in (
        (baselines.antimatter(splats), volume * opacity),
        (baselines.sgss(splats), opacity * volume**0.1),
        (baselines.scale(splats), volume),
    ):
        np.testing.assert_allclose(np.exp(found), expected, rtol=1e-6)
    np.testing.assert_allclose(expit(baselines.opacity(splats)), opacity)
    distance = np.linalg.norm(splats.means.astype(np.float64), axis=1)
    np.testing.assert_allclose(baselines.nearness(splats), -distance)


def test_opaque_and_invisible_splats_have_their_place():
    splats = oracle.scene(0, n=3)
    splats.scales[:] = 0.0
    splats.opacities[:] = [-np.inf, np.inf, 0.0]
    assert baselines.sort_descending(baselines.antimatter(splats)).tolist() == [1, 2, 0]
    assert baselines.sort_descending(baselines.sgss(splats)).tolist() == [1, 2, 0]
