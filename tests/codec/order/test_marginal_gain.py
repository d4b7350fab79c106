import numpy as np
import oracle
import pytest

from cogsplat.codec.errors import Cancelled
from cogsplat.codec.executor import LocalThreads
from cogsplat.codec.metrics import psnr
from cogsplat.codec.order import chunk_plan, prefix_inflation
from cogsplat.codec.order.gain_effort import GainEffort
from cogsplat.codec.order.marginal_gain import (
    GainConfig,
    Stage,
    gain_order,
    gain_rows,
    gains,
    stage_splats,
    view_gains,
)
from cogsplat.codec.order.orders import OrderInputs, order_rows
from cogsplat.codec.render.rasteriser import render
from cogsplat.codec.scoring.contribution import score, zero_scores
from cogsplat.codec.scoring.reference_views import render_references
from cogsplat.codec.scoring.score_config import ScoreConfig
from cogsplat.codec.splats import concatenate


@pytest.fixture(scope="module")
def scene():
    splats = oracle.scene(5, n=600)
    cameras = [oracle.camera(angle=angle) for angle in (0, 20, 40)]
    return splats, cameras, score(splats, cameras, ScoreConfig(jitter=False))


@pytest.fixture(scope="module")
def several_chunks():
    """Return a scene with enough chunks for sorted runs."""
    splats = oracle.scene(5, n=2000)
    cameras = [oracle.camera(angle=angle) for angle in (0, 30)]
    return splats, cameras, score(splats, cameras, ScoreConfig(jitter=False))


def test_order_is_a_permutation_whatever_the_threads(scene):
    splats, cameras, scores = scene
    orders = [
        gain_order(splats, scores, cameras, GainConfig(threads=threads)) for threads in (1, 2, 3)
    ]
    np.testing.assert_array_equal(np.sort(orders[0]), np.arange(len(splats)))
    np.testing.assert_array_equal(orders[0], orders[1])
    np.testing.assert_array_equal(orders[0], orders[2])


@pytest.mark.parametrize("inflated", [False, True])
def test_short_prefixes_show_more_than_those_by_contribution(scene, inflated):
    splats, cameras, scores = scene
    config = GainConfig(inflated=inflated, jitter=False)
    by_gain = gain_order(splats, scores, cameras, config)
    by_contribution = np.argsort(-scores.contribution, kind="stable")

    def quality(rows, share):
        prefix = splats.take(rows[: int(share * len(splats))])
        if inflated:
            effective_splats = prefix_inflation.effective_splats(scores.contribution)
            prefix = prefix_inflation.inflate(
                prefix, prefix_inflation.best_inflation(len(prefix) / effective_splats)
            )
        return np.mean([psnr(render(splats, view), render(prefix, view)) for view in cameras])

    for share in (0.05, 0.1):
        assert quality(by_gain, share) > quality(by_contribution, share) + 0.3


def test_behind_the_share_that_is_ordered_by_gain_splats_come_by_contribution(scene):
    splats, cameras, scores = scene
    share = 0.1 * len(splats) / prefix_inflation.effective_splats(scores.contribution)
    effort = GainEffort(ordered_ratio=share * (1 + 1e-9), growth=0.5, views=2)
    rows = gain_order(splats, scores, cameras, GainConfig(jitter=False, effort=effort))
    by_contribution = np.argsort(-scores.contribution, kind="stable")
    first = len(splats) // 10
    rest = by_contribution[~np.isin(by_contribution, rows[:first])]
    np.testing.assert_array_equal(rows[first:], rest)
    assert set(rows[:first]) != set(by_contribution[:first])


def test_duplicates_are_ordered_late(scene):
    splats, cameras, _ = scene
    # The scene twice: by contribution every splat is next to its copy.
    pairs = concatenate([splats, splats])
    scores = score(pairs, cameras, ScoreConfig(jitter=False))
    rows = gain_order(pairs, scores, cameras, GainConfig(inflated=False, jitter=False))
    first = rows[:120] % len(splats)
    # With pairs kept together it would be 60; depending on the seed it is 80 to 92.
    assert len(np.unique(first)) > 75


def test_without_cameras_the_order_is_by_contribution(scene):
    splats, _, scores = scene
    expected = np.argsort(-scores.contribution, kind="stable")
    np.testing.assert_array_equal(gain_order(splats, scores, []), expected)
    nothing = gain_order(splats, zero_scores(len(splats)), [])
    np.testing.assert_array_equal(nothing, np.arange(len(splats)))


def test_a_scene_without_splats_has_an_empty_order(scene):
    splats, cameras, scores = scene
    none = np.zeros(0, np.int64)
    rows = gain_order(splats.take(none), scores.take(none), cameras)
    assert rows.dtype == np.int64
    assert len(rows) == 0


def test_the_order_by_name_sorts_runs_of_chunks(several_chunks):
    splats, cameras, scores = several_chunks
    effort = GainEffort(ordered_ratio=1000.0)
    plain = gain_order(splats, scores, cameras, GainConfig(effort=effort))
    expected = chunk_plan.sort_runs(plain, scores.contribution)
    assert (expected != plain).any()
    found = order_rows("gain", OrderInputs(splats, scores, cameras, effort=effort))
    np.testing.assert_array_equal(found, expected)


def test_gains_weigh_the_views(scene):
    splats, cameras, _ = scene
    references = render_references(splats, cameras, jittered=False)
    present = np.arange(len(splats)) % 2 == 0
    drawn = stage_splats(splats, np.arange(len(splats)))
    stage = Stage(np.arange(len(splats), dtype=np.int32), present)
    total = gains(splats, references, stage, [0, 2], LocalThreads(1))
    expected = np.zeros(len(splats))
    for view in (0, 2):
        camera = references.cameras[view]
        rows, found, _ = view_gains(drawn, present, camera, references.pictures[view])
        expected[rows] += found / 3 / (camera.width * camera.height)
    np.testing.assert_allclose(total, expected, rtol=1e-12)


def test_progress_can_cancel(scene):
    splats, cameras, scores = scene
    references = render_references(splats, cameras)
    calls = []

    def stop(stage, done, total):
        calls.append((stage, done, total))
        if done > 100:
            raise Cancelled

    with pytest.raises(Cancelled):
        gain_rows(splats, scores, references, progress=stop)
    until = GainEffort().ordered_ratio * prefix_inflation.effective_splats(scores.contribution)
    assert calls[0] == ("gain", 0, int(until))


def test_given_reference_views_are_not_rendered_again(several_chunks, monkeypatch):
    splats, cameras, scores = several_chunks
    expected = gain_order(splats, scores, cameras)
    references = render_references(splats, cameras)

    def refuse(*args, **kwargs):
        raise AssertionError

    monkeypatch.setattr("cogsplat.codec.order.marginal_gain.render_references", refuse)
    given = OrderInputs(splats, scores, cameras, references=references)
    np.testing.assert_array_equal(
        gain_order(splats, scores, cameras, references=references), expected
    )
    np.testing.assert_array_equal(
        order_rows("gain", given), chunk_plan.sort_runs(expected, scores.contribution)
    )


def test_without_jitter_only_the_given_views_are_rendered(several_chunks):
    splats, cameras, scores = several_chunks
    without = gain_order(splats, scores, cameras, GainConfig(jitter=False))
    assert (without != gain_order(splats, scores, cameras)).any()
    found = order_rows("gain", OrderInputs(splats, scores, cameras, jitter=False))
    np.testing.assert_array_equal(found, chunk_plan.sort_runs(without, scores.contribution))


def test_the_splats_of_a_stage_copy_no_colours(scene):
    splats, _, _ = scene
    rows = np.arange(0, len(splats), 2)
    stage = stage_splats(splats, rows, prefix_inflation.Inflation(0.25, 1.5))
    assert stage.scene is splats
    assert stage.shapes.sh_degree == 0
    np.testing.assert_array_equal(stage.shapes.means, splats.means[rows])
    np.testing.assert_allclose(stage.shapes.scales, splats.scales[rows] + 0.25, rtol=1e-6)
