from dataclasses import replace

import numpy as np
import oracle
import pytest

from cogsplat.codec.errors import CogsplatWarning, DataError
from cogsplat.codec.geometry import frustum
from cogsplat.codec.order.orders import (
    FIRST_VIEW,
    FRUSTUM,
    ORDERS,
    POSE_RULES,
    OrderConfig,
    OrderInputs,
    needs_scores,
    order_rows,
    split_name,
)
from cogsplat.codec.scoring.contribution import zero_scores


def scored(contribution, seed=1):
    contribution = np.array(contribution, np.float64)
    scores = replace(zero_scores(len(contribution)), contribution=contribution)
    return OrderInputs(oracle.scene(seed, n=len(contribution), degree=0), scores)


# A frustum may hold all of a few splats.
@pytest.mark.filterwarnings("ignore:.*changes nothing")
@pytest.mark.parametrize("rule", ["", *POSE_RULES])
@pytest.mark.parametrize("name", ORDERS)
@pytest.mark.parametrize("n", [0, 1, 2, 300])
def test_every_order_is_a_permutation_and_repeatable(name, rule, n):
    scene = scored(np.random.default_rng(2).integers(0, 40, n))
    if n in (1, 2):
        # The camera must look at this splat, or its view shows nothing.
        means = np.zeros_like(scene.splats.means)
        scene = replace(scene, splats=replace(scene.splats, means=means))
    config = OrderConfig(first_view=oracle.camera(width=24, height=20))
    full = f"{name}+{rule}" if rule else name
    rows = order_rows(full, scene, config)
    assert rows.dtype == np.int64
    assert sorted(rows.tolist()) == list(range(n))
    again = order_rows(full, replace(scene, threads=1), config)
    np.testing.assert_array_equal(again, rows)


def test_contribution_falls_and_ties_stay_in_file_order():
    values = np.random.default_rng(3).integers(0, 20, 1000) / 7
    expected = sorted(range(1000), key=lambda row: (-values[row], row))
    assert order_rows("contribution", scored(values)).tolist() == expected


def test_unseen_splats_come_last_in_file_order():
    scene = scored([0.0, 2.0, -0.0, 0.0, 1e-300])
    assert order_rows("contribution", scene).tolist() == [1, 4, 0, 2, 3]
    assert order_rows("contribution", scored([0.0] * 6)).tolist() == list(range(6))


def test_baselines_sort_by_their_priority():
    scene = scored(np.zeros(400))
    splats = scene.splats
    volumes = np.prod(np.exp(splats.scales.astype(np.float64)), axis=1)
    opacities_unit = 1 / (1 + np.exp(-splats.opacities.astype(np.float64)))
    importance = opacities_unit * (volumes / np.percentile(volumes, 90)) ** 0.1
    expected = {
        "antimatter": volumes * opacities_unit,
        "sgss": importance,
        "opacity": opacities_unit,
        "scale": volumes,
        "distance": -np.linalg.norm(splats.means.astype(np.float64), axis=1),
    }
    for name, values in expected.items():
        falling = values[order_rows(name, scene)]
        assert (np.diff(falling) <= 1e-12 * np.abs(falling[1:])).all(), name
    assert order_rows("source", scene).tolist() == list(range(400))


def test_opacities_may_be_infinite():
    scene = scored([0.0] * 3)
    infinite = np.array([-np.inf, 0.0, np.inf], np.float32)
    scene = replace(scene, splats=replace(scene.splats, opacities=infinite))
    for name in ("opacity", "antimatter", "sgss"):
        assert order_rows(name, scene)[-1] == 0
    assert order_rows("opacity", scene).tolist() == [2, 1, 0]


def test_random_order_is_another_one_with_another_seed():
    scene = scored(np.zeros(100))
    first, again, other = (
        order_rows("random", scene, OrderConfig(seed=seed)).tolist() for seed in (3, 3, 4)
    )
    assert first == again
    assert first != other


def test_first_view_is_ordered_by_what_a_direct_render_of_it_shows():
    scene = replace(scored(np.random.default_rng(5).random(60)), splats=oracle.scene(5, n=60))
    camera = oracle.camera()
    weights = oracle.view(scene.splats, camera).weights.sum(axis=0)
    config = OrderConfig(first_view=camera, first_view_share=0.25, first_view_mix=1.0)
    rows = order_rows(f"contribution+{FIRST_VIEW}", scene, config)
    shown = rows[:15]
    falling = weights[shown]
    assert (np.diff(falling) <= 1e-3 * falling[1:]).all()
    assert falling.min() >= np.sort(weights)[::-1][14] * (1 - 1e-3)
    rest = [row for row in order_rows("contribution", scene).tolist() if row not in set(shown)]
    assert rows[15:].tolist() == rest


def test_first_view_brings_forward_only_visible_splats():
    scene = replace(scored(np.arange(60.0)), splats=oracle.scene(5, n=60))
    camera = oracle.camera(width=12, height=10)
    seen = int((oracle.view(scene.splats, camera).weights.sum(axis=0) > 0).sum())
    assert 0 < seen < 60
    config = OrderConfig(first_view=camera, first_view_share=1.0, first_view_mix=1.0)
    rows = order_rows(f"contribution+{FIRST_VIEW}", scene, config)
    assert (np.diff(rows[seen:]) < 0).all(), "the rest as without"
    nothing = replace(config, first_view_share=0.0)
    plain = order_rows("contribution", scene)
    np.testing.assert_array_equal(order_rows("contribution+first-view", scene, nothing), plain)


def test_first_view_that_shows_nothing_is_refused():
    scene = replace(scored(np.zeros(60)), splats=oracle.scene(5, n=60))
    away = OrderConfig(first_view=oracle.camera(distance=-1e6))
    with pytest.raises(DataError) as caught:
        order_rows("contribution+first-view", scene, away)
    assert caught.value.code == "cameras-see-nothing"


def test_frustum_holds_means_within_the_widened_image():
    scene = replace(scored(np.arange(300.0)), splats=oracle.scene(6, n=300))
    camera = oracle.camera(width=20, height=30)
    inside = []
    for mean in scene.splats.means.astype(np.float64):
        x, y, z = camera.rotation @ mean + camera.translation
        u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
        # ±1.3 in normalised device coordinates.
        inside.append(z > 0.2 and -3 < u < 23 and -4.5 < v < 34.5)
    config = OrderConfig(first_view=camera, frustum_share=1.0)
    rows = order_rows(f"contribution+{FRUSTUM}", scene, config)
    count = sum(inside)
    assert 20 < count < 280
    assert [inside[row] for row in rows] == [True] * count + [False] * (300 - count)
    assert (np.diff(rows[:count]) < 0).all()


def test_the_default_frustum_share_halves_the_splats_outside():
    scene = replace(scored(np.arange(300.0)), splats=oracle.scene(6, n=300))
    camera = oracle.camera(width=20, height=30)
    inside = frustum.in_frustum(scene.splats, camera, 0.15)
    share = inside.mean()
    assert 0.1 < share < 0.9
    rows = order_rows(f"contribution+{FRUSTUM}", scene, OrderConfig(first_view=camera))
    for prefix in (20, 40, 60):
        if inside[rows[:prefix]].sum() == inside.sum():
            break
        assert 1 - inside[rows[:prefix]].mean() <= 0.5 * (1 - share) + 1e-9


def test_a_frustum_that_changes_nothing_warns():
    scene = replace(scored(np.arange(300.0)), splats=oracle.scene(6, n=300))
    config = OrderConfig(first_view=oracle.camera(), frustum_share=0.0)
    with pytest.warns(CogsplatWarning, match="changes nothing"):
        rows = order_rows(f"contribution+{FRUSTUM}", scene, config)
    np.testing.assert_array_equal(rows, order_rows("contribution", scene))


@pytest.mark.parametrize("name", [name for name in ORDERS if not needs_scores(name)])
def test_orders_without_scores_do_not_read_them(name):
    one, other = (scored(values) for values in (np.arange(60.0), np.zeros(60)))
    np.testing.assert_array_equal(order_rows(name, one), order_rows(name, other))


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("contribution", ("contribution", "")),
        ("sgss+frustum", ("sgss", "frustum")),
        ("octree-quota+first-view", ("octree-quota", "first-view")),
    ],
)
def test_names_are_an_order_and_a_rule(name, found):
    assert split_name(name) == found


@pytest.mark.parametrize(
    "name", ["", "Contribution", "first-view", "contribution+", "contribution+x", "a+frustum"]
)
def test_unknown_orders_are_refused(name):
    with pytest.raises(ValueError, match="expected one of"):
        order_rows(name, scored([1.0]), OrderConfig(first_view=oracle.camera()))


def test_a_rule_needs_a_view():
    with pytest.raises(ValueError, match="without a first view"):
        order_rows("contribution+frustum", scored([1.0]))


@pytest.mark.parametrize(
    "wrong",
    [
        {"octree_depth": -1},
        {"octree_depth": 21},
        {"first_view_share": 1.1},
        {"first_view_mix": -0.1},
        {"frustum_share": -0.1},
        {"frustum_margin": float("nan")},
        {"seed": -1},
        {"run_chunks": 0},
        {"by_object": True, "object_budgets": ((1, 2.0),)},
        {"object_budgets": ((1, 0.5),)},
    ],
)
def test_parameters_out_of_range_are_refused(wrong):
    with pytest.raises(ValueError, match=r"expected|without"):
        OrderConfig(**wrong)
