"""Sums over views against sums computed with numpy."""

import numpy as np
import oracle
import pytest

from cogsplat.codec.scoring.view_sums import SHOWN_WEIGHT, ViewSums, add_rows

SUMS = ("contribution", "energy", "largest_energy", "peak", "shown")


def _views(splats, count=4):
    """Return made-up sums of some views: rows, (S, 3) weights, position, pixels, share."""
    rng = np.random.default_rng(2)
    views = []
    for _ in range(count):
        reached = rng.permutation(len(splats))[: len(splats) // 2].astype(np.int32)
        index = reached[5:]  # the first five are hidden
        sums = rng.random((len(index), 3))
        sums[: len(index) // 4, 2] *= SHOWN_WEIGHT  # these are only glimpsed
        position = rng.normal(size=3) * 9.0
        views.append((reached, index, sums, position, int(rng.integers(9, 99)), rng.random()))
    return views


def test_sums_are_those_of_their_definition():
    splats = oracle.scene(1, n=64)
    totals = ViewSums(splats)
    expected = {name: np.zeros(64) for name in SUMS}
    covered, bases, weighted = np.zeros(64), np.zeros((64, 16)), np.zeros((64, 15))
    for reached, index, sums, position, num_pixels, share in _views(splats):
        totals.add(reached, index, sums, position, num_pixels, share)
        expected["contribution"][index] += share * sums[:, 0]
        expected["energy"][index] += share * sums[:, 1]
        expected["peak"][index] = np.maximum(expected["peak"][index], sums[:, 2])
        largest = expected["largest_energy"]
        largest[index] = np.maximum(largest[index], sums[:, 1] / num_pixels)
        expected["shown"][index] += sums[:, 2] >= SHOWN_WEIGHT
        covered[reached] += 1
        offset = splats.means[index] - position
        values = oracle.real_sh(offset / np.linalg.norm(offset, axis=1, keepdims=True), 3)
        bases[index] += share * sums[:, :1] * np.abs(values)
        weighted[index] += share * sums[:, 1:2] * values[:, 1:]
    for name, value in expected.items():
        np.testing.assert_allclose(getattr(totals, name), value, rtol=1e-6, err_msg=name)
    np.testing.assert_array_equal(totals.covered, covered)
    np.testing.assert_allclose(totals.bases, bases, rtol=1e-6, atol=1e-12)
    energy = np.where(expected["energy"] > 0, expected["energy"], 1.0)
    np.testing.assert_allclose(totals.basis_mean(), weighted / energy[:, None], atol=1e-6)


def test_the_spread_is_the_covariance_of_the_bases_over_views():
    splats = oracle.scene(2, n=8)  # of each eight splats the first is sampled
    totals = ViewSums(splats)
    rng = np.random.default_rng(3)
    values, weights = [], []
    for _ in range(6):
        position, square = rng.normal(size=3) * 5.0, rng.random()
        row = np.zeros(1, np.int32)
        totals.add(row, row, np.array([[1.0, square, 1.0]]), position, 9, 0.5)
        offset = splats.means[:1] - position
        values.append(oracle.real_sh(offset / np.linalg.norm(offset), 3)[0, 1:])
        weights.append(0.5 * square)
    expected = np.cov(np.array(values).T, aweights=weights, bias=True)
    np.testing.assert_allclose(totals.basis_spread(), expected, atol=1e-10)


@pytest.mark.parametrize("degree", [0, 2])
def test_directions_are_summed_only_for_view_dependent_colours(degree):
    splats = oracle.scene(3, n=16, degree=degree)
    totals = ViewSums(splats)
    for view in _views(splats):
        totals.add(*view)
    assert totals.basis_mean().any() == (degree > 0)
    assert totals.bases.any()


def test_without_views_all_sums_are_zero():
    totals = ViewSums(oracle.scene(4, n=9))
    assert not totals.basis_spread().any()
    assert not totals.basis_mean().any()
    assert not totals.shown.any()


def test_rows_are_added_with_their_share():
    totals = np.ones((4, 2))
    rows, places = np.array([0, 3], np.int32), np.array([1, 0], np.int32)
    add_rows(rows, places, np.array([[1.0, 2.0], [3.0, 4.0]]), 0.5, totals)
    assert totals.tolist() == [[2.5, 3.0], [1.0, 1.0], [1.0, 1.0], [1.5, 2.0]]
