from dataclasses import replace

import numpy as np
import oracle
import pytest

from cogsplat.codec.order import ORDERS, order_rows
from cogsplat.codec.score import unscored


def scored(contribution):
    contribution = np.array(contribution, np.float64)
    scores = replace(unscored(len(contribution)), contribution=contribution)
    return oracle.scene(1, n=len(contribution), degree=0), scores


@pytest.mark.parametrize("name", ORDERS)
@pytest.mark.parametrize("n", [0, 1, 2, 500])
def test_every_order_is_a_permutation_and_repeatable(name, n):
    splats, scores = scored(np.random.default_rng(2).integers(0, 40, n))
    rows = order_rows(name, splats, scores)
    assert rows.dtype == np.int64
    assert sorted(rows.tolist()) == list(range(n))
    np.testing.assert_array_equal(order_rows(name, splats, scores), rows)


def test_contribution_falls_and_ties_stay_in_file_order():
    values = np.random.default_rng(3).integers(0, 20, 1000) / 7
    splats, scores = scored(values)
    expected = sorted(range(1000), key=lambda row: (-values[row], row))
    assert order_rows("contribution", splats, scores).tolist() == expected


def test_unseen_splats_come_last_in_file_order():
    splats, scores = scored([0.0, 2.0, -0.0, 0.0, 1e-300])
    assert order_rows("contribution", splats, scores).tolist() == [1, 4, 0, 2, 3]
    splats, scores = scored([0.0] * 6)
    assert order_rows("contribution", splats, scores).tolist() == list(range(6))


def test_the_source_order_is_the_files():
    splats, scores = scored([1.0, 3.0, 2.0])
    assert order_rows("source", splats, scores).tolist() == [0, 1, 2]


def test_unknown_orders_are_refused():
    splats, scores = scored([1.0])
    for name in ("", "Contribution", "random"):
        with pytest.raises(ValueError, match="expected one of"):
            order_rows(name, splats, scores)
