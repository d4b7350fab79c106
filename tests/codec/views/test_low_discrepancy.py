"""Low-discrepancy sequences: in the unit square, the unit cube and on the sphere."""

import math

import numpy as np
import pytest

from cogsplat.codec.views.low_discrepancy import (
    STEP_1D,
    STEPS_2D,
    STEPS_3D,
    even_directions,
    sequence,
)


def test_steps_are_powers_of_the_roots_of_their_polynomials() -> None:
    for dimensions, steps in ((1, np.array([STEP_1D])), (2, STEPS_2D), (3, STEPS_3D)):
        root = 1.0 / steps[0]
        assert root ** (dimensions + 1) == pytest.approx(root + 1.0, rel=1e-12)
        np.testing.assert_allclose(steps, root ** -np.arange(1.0, dimensions + 1), rtol=1e-12)


@pytest.mark.parametrize("steps", [STEPS_2D, STEPS_3D])
@pytest.mark.parametrize("first", [-200, 0, 37])
def test_any_run_covers_every_cell_evenly(steps: np.ndarray, first: int) -> None:
    points = sequence(np.arange(first, first + 1024), steps)
    assert points.shape == (1024, len(steps))
    assert points.min() >= 0.0
    assert points.max() < 1.0
    # 16 cells a side in two dimensions, 8 in three: random points would leave many empty.
    side = {2: 16, 3: 8}[len(steps)]
    cells = np.unique((points * side).astype(int), axis=0)
    assert len(cells) > 0.85 * side ** len(steps)
    np.testing.assert_allclose(points.mean(axis=0), 0.5, atol=0.01)


def test_a_number_is_always_the_same_point() -> None:
    whole = sequence(np.arange(-5, 20), STEPS_3D)
    np.testing.assert_array_equal(sequence(np.array([-5, 3, 19]), STEPS_3D), whole[[0, 8, 24]])


def test_directions_are_unit_vectors_spread_evenly() -> None:
    directions = even_directions(32)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
    assert np.linalg.norm(directions.mean(axis=0)) < 0.02
    cosines = directions @ directions.T - 2.0 * np.eye(32)
    assert math.degrees(math.acos(cosines.max())) > 20.0, "no two close together"
