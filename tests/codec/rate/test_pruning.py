import math
from dataclasses import replace

import numpy as np
import oracle
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cogsplat.codec.rate.pruning import PruneConfig, keep_mask
from cogsplat.codec.scoring.contribution import score, zero_scores


def seen(peak, covered, opacities=None):
    n = len(peak)
    splats = oracle.scene(1, n=n, degree=0)
    splats.opacities[:] = 1.0 if opacities is None else opacities
    scores = replace(
        zero_scores(n), peak=np.array(peak, np.float32), covered=np.array(covered, np.int32)
    )
    return splats, scores


@settings(derandomize=True, deadline=None, max_examples=200)
@given(
    st.lists(st.tuples(st.floats(0, 1, width=32), st.integers(0, 8)), max_size=20),
    st.floats(0, 0.99),
    st.integers(1, 8),
)
def test_a_visible_splat_is_dropped_only_below_the_peak_and_if_covered(rows, peak, views):
    splats, scores = seen([row[0] for row in rows], [row[1] for row in rows])
    kept = keep_mask(splats, scores, PruneConfig(peak=peak, views=views))
    assert kept.dtype == np.bool_
    assert kept.tolist() == [p >= np.float32(peak) or c < views for p, c in rows]


def test_only_splats_not_worth_their_bytes_are_dropped():
    splats, scores = seen([0.01] * 4, [9, 9, 9, 3])
    scores = replace(scores, energy=np.array([1.0, 5.9, 6.0, 1.0]))
    kept = keep_mask(splats, scores, PruneConfig(worth=6.0), lagrangian=1.0)
    assert kept.tolist() == [False, False, True, True]
    assert keep_mask(splats, scores, PruneConfig(worth=6.0), lagrangian=0.1).tolist() == [True] * 4
    assert keep_mask(splats, scores, PruneConfig(), lagrangian=0.0).all()


def test_splats_that_one_view_shows_well_are_kept():
    splats, scores = seen([0.01] * 2, [9, 9])
    scores = replace(
        scores, energy=np.array([1.0, 1.0]), largest_energy=np.array([1.0, 6.0 * 32.0])
    )
    kept = keep_mask(splats, scores, PruneConfig(worth=6.0), lagrangian=1.0)
    assert kept.tolist() == [False, True]


def test_splats_that_no_view_covers_are_kept():
    splats, scores = seen([0.0] * 5, [0, 1, 2, 3, 4])
    assert keep_mask(splats, scores, PruneConfig()).tolist() == [True] * 4 + [False]
    assert keep_mask(splats, scores, PruneConfig(views=1)).tolist() == [True] + [False] * 4
    assert keep_mask(splats, zero_scores(5), PruneConfig(peak=0.999, views=1)).all()


def test_a_peak_at_the_limit_is_kept():
    splats, scores = seen([0.25, np.nextafter(np.float32(0.25), np.float32(0))], [9, 9])
    assert keep_mask(splats, scores, PruneConfig(peak=0.25)).tolist() == [True, False]
    assert keep_mask(splats, scores, PruneConfig(peak=0)).tolist() == [True, True]


def test_less_is_dropped_where_cameras_show_too_little_in_common():
    splats, scores = seen([0.019, 0.021, 0.059, 0.061], [9] * 4)
    sparse = replace(scores, sparse=True)
    assert keep_mask(splats, scores, PruneConfig()).tolist() == [False, False, False, True]
    assert keep_mask(splats, sparse, PruneConfig()).tolist() == [False, True, True, True]
    for found in (scores, sparse):
        assert keep_mask(splats, found, PruneConfig(peak=0.05)).tolist() == [False] * 2 + [True] * 2


def test_transparent_splats_are_dropped_even_unseen():
    edge = -math.log(254)
    logits = [-np.inf, edge - 1e-4, edge + 1e-4, 0.0, np.inf]
    splats, scores = seen([0.0] * 5, [0] * 5, logits)
    assert keep_mask(splats, scores, PruneConfig()).tolist() == [False, False, True, True, True]
    assert keep_mask(splats, scores, None).all()


def test_dropping_keeps_every_pixel_within_the_bound_of_each():
    splats = oracle.scene(5, n=150, opacity=3.0)
    cameras = [oracle.camera(angle) for angle in (0.0, 0.6, 1.2, 1.8)]
    config = PruneConfig(peak=0.05, views=4)
    kept = keep_mask(splats, score(splats, cameras), config)
    assert 0 < kept.sum() < len(kept)
    for camera in cameras:
        weights = oracle.view(splats, camera).weights
        visible = splats.opacities >= -math.log(254)
        assert weights[:, ~kept].max() < config.peak + 1e-5
        assert weights[:, ~visible].max(initial=0) == 0


def test_an_empty_scene_keeps_nothing():
    splats, scores = seen([], [])
    assert keep_mask(splats, scores, PruneConfig()).shape == (0,)
    assert keep_mask(splats, scores, None).shape == (0,)


@pytest.mark.parametrize(
    "settings_",
    [{"peak": -0.1}, {"peak": 1.0}, {"peak": float("nan")}, {"views": 0}, {"worth": 0.0}],
)
def test_bounds_out_of_range_are_refused(settings_):
    with pytest.raises(ValueError, match="expected"):
        PruneConfig(**settings_)
