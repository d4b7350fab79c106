"""Coverage: the share of visible splats that views cover, and views that raise it."""

import numpy as np
import pytest

from cogsplat.codec.views.coverage import SeenSplats, choose_covering


def seen(**weights: float) -> SeenSplats:
    """Return a view that shows rows, named ``r0`` and on, with these weights."""
    rows = np.array([int(name[1:]) for name in weights], np.int32)
    return SeenSplats(rows, np.array(list(weights.values())))


def test_views_that_cover_everything_need_no_addition() -> None:
    added, coverage = choose_covering(np.ones(3), [seen(r0=0.5, r1=0.5, r2=0.5)], [seen(r0=0.9)], 5)
    assert added == []
    assert coverage == 1.0


def test_candidates_are_added_by_coverage_until_it_suffices() -> None:
    candidates = [seen(r1=0.8), seen(r1=0.8, r2=0.8), seen(r3=0.8), seen(r2=0.8)]
    added, coverage = choose_covering(np.ones(4), [seen(r0=0.9)], candidates, 5)
    assert added == [1, 2]
    assert coverage == 1.0


def test_rows_are_weighted_by_their_counts() -> None:
    candidates = [seen(r1=0.8, r2=0.8), seen(r3=0.8)]
    added, coverage = choose_covering(np.array([1.0, 1.0, 1.0, 7.0]), [seen(r0=0.9)], candidates, 1)
    assert added == [1]
    assert coverage == pytest.approx(0.8)


def test_a_splat_shown_much_worse_than_it_can_be_is_not_covered() -> None:
    for shown, covered in ((0.21, True), (0.19, False)):
        _, coverage = choose_covering(np.ones(1), [seen(r0=shown)], [seen(r0=0.8)], 0)
        assert coverage == float(covered)


def test_splats_that_no_view_shows_clearly_are_not_visible() -> None:
    added, coverage = choose_covering(np.ones(2), [seen(r0=0.5)], [seen(r1=0.09)], 3)
    assert added == []
    assert coverage == 1.0
    assert choose_covering(np.ones(2), [], [], 3) == ([], 1.0)


def test_the_number_of_added_views_is_limited() -> None:
    candidates = [SeenSplats(np.array([row], np.int32), np.array([0.5])) for row in range(40)]
    added, coverage = choose_covering(np.ones(40), [], candidates, 12)
    assert len(added) == 12
    assert coverage == pytest.approx(0.3)
