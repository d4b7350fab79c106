"""Views planned from splats: their positions, the splats they show, and repeatability."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import oracle
import pytest
from numpy.typing import NDArray
from shapes import balls, box, sphere

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import Cancelled, DataError
from cogsplat.codec.scoring.contribution import score
from cogsplat.codec.scoring.score_config import ScoreConfig
from cogsplat.codec.splats import SceneInfo, Splats, concatenate, empty
from cogsplat.codec.views.planner import ViewPlanConfig, plan, plan_views
from cogsplat.codec.views.pose import Pose
from cogsplat.codec.views.view_sets import TEST_VIEWS
from cogsplat.tools.lab.synthetic.terrace import synth

SMALL = ViewPlanConfig(views=24, width=64, height=48)
FLOOR = np.array([0.0, 0.85, 0.0])


def places(cameras: list[Camera]) -> NDArray[np.float64]:
    return np.array([camera.position for camera in cameras])


def gaze(cameras: list[Camera], point: Sequence[float]) -> NDArray[np.float64]:
    """Return the cosines between where cameras look and where a point is."""
    offsets = np.asarray(point, float) - places(cameras)
    offsets /= np.linalg.norm(offsets, axis=1, keepdims=True)
    return (offsets * np.array([camera.rotation[2] for camera in cameras])).sum(axis=1)


def covered(splats: Splats, cameras: list[Camera]) -> NDArray[np.bool_]:
    return score(splats, cameras, ScoreConfig(jitter=False)).covered > 0


def same(first: list[Camera], second: list[Camera]) -> None:
    assert len(first) == len(second)
    for a, b in zip(first, second, strict=True):
        np.testing.assert_array_equal(a.rotation, b.rotation)
        np.testing.assert_array_equal(a.translation, b.translation)
        assert (a.fx, a.fy, a.width, a.height, a.name) == (b.fx, b.fy, b.width, b.height, b.name)


def test_plans_do_not_depend_on_threads() -> None:
    splats = synth(2000, sh_degree=0)
    same(
        plan_views(splats, replace(SMALL, threads=1)), plan_views(splats, replace(SMALL, threads=2))
    )


def test_views_have_the_size_and_the_field_that_were_asked_for() -> None:
    config = ViewPlanConfig(views=5, width=90, height=40, fov_deg=90.0)
    found = plan(sphere(3.0), config)
    assert [camera.name for camera in found.views] == [f"virtual-{k:03d}" for k in range(5)]
    assert len(found.covering_views) <= 5 // 2 + 5 // 8
    for camera in found.views + found.covering_views:
        assert (camera.width, camera.height, camera.cx, camera.cy) == (90, 40, 45.0, 20.0)
        assert camera.fx == camera.fy == pytest.approx(45.0)


@pytest.mark.parametrize("size", [0.01, 1.0, 1000.0])
def test_an_object_is_seen_from_all_around_and_close(size: float) -> None:
    centre = [7.0 * size, -2.0 * size, 3.0 * size]
    splats = sphere(size, centre=centre)
    cameras = plan_views(splats, SMALL)
    away = places(cameras) - centre
    distances = np.linalg.norm(away, axis=1)
    assert distances.min() > 1.05 * size, "none inside"
    assert np.quantile(distances, 0.9) < max(8.0 * size, 2.0), "it fills the pictures"
    assert (gaze(cameras, centre) > 0.8).all()
    directions = away / distances[:, None]
    assert np.linalg.norm(directions.mean(axis=0)) < 0.4, "from no side alone"
    assert covered(splats, cameras).all()


def test_test_views_show_the_whole_of_an_isolated_object() -> None:
    ball = plan(sphere(1.0), SMALL)
    assert len(ball.test_views) == TEST_VIEWS
    same(ball.views + ball.covering_views, plan_views(sphere(1.0), SMALL))
    assert (gaze(ball.test_views, (0.0, 0.0, 0.0)) > 0.99).all()
    assert_apart(ball.test_views, ball.views + ball.covering_views)


def test_test_views_of_a_room_are_from_inside_and_none_is_scored() -> None:
    half = np.array([2.5, 1.3, 2.0])
    found = plan(concatenate([box(half, 3000), sphere(0.2, 1200)]), SMALL)
    assert len(found.test_views) >= 16
    assert (np.abs(places(found.test_views)) < half).all(axis=1).mean() > 0.9
    assert_apart(found.test_views, found.views + found.covering_views)


def test_test_views_of_a_room_look_about_level_and_not_from_inside_its_furniture() -> None:
    half, chest = np.array([2.5, 1.3, 2.0]), np.array([0.7, 0.7, 0.7])
    found = plan(concatenate([box(half, 3000), box(chest, 1200)]), SMALL).test_views
    at = places(found)
    assert (np.abs(at) < half).all()
    assert not (np.abs(at) < chest).all(axis=1).any()
    pitches = np.degrees(np.arcsin([camera.rotation[2, 1] for camera in found]))
    assert pitches.min() >= -15.0 - 1e-6
    assert pitches.max() <= 45.0 + 1e-6


def assert_apart(test_views: list[Camera], views: list[Camera]) -> None:
    apart = np.linalg.norm(places(test_views)[:, None] - places(views)[None], axis=2)
    assert apart.min() > 1e-3


def test_covering_views_are_added_until_what_is_visible_is_covered() -> None:
    """The floor of a bowl, which is open at the top only, is outside all orbit views."""
    rng = np.random.default_rng(4)
    points = rng.normal(size=(3000, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    points = points[points[:, 1] > -0.75]
    size = math.sqrt(4.0 * math.pi / 3000)
    outside, inside = balls(points, size), balls(0.85 * points, size)
    found = plan(concatenate([outside, inside]), replace(SMALL, views=16))
    assert found.coverage >= 0.95
    assert len(found.views) == 16
    assert 0 < len(found.covering_views) <= 16 // 2 + 16 // 8
    assert [camera.name for camera in found.covering_views] == [
        f"covering-{row:03d}" for row in range(len(found.covering_views))
    ]
    bowl = concatenate([outside, inside])
    eyes = [np.array([0.6 * math.cos(a), -2.6, 0.6 * math.sin(a)]) for a in range(6)]
    above = [
        Pose(eye, (FLOOR - eye) / np.linalg.norm(FLOOR - eye), 1.0).camera(
            SMALL.lens(), np.array([0.0, 1.0, 0.0])
        )
        for eye in eyes
    ]
    floor = len(outside) + np.flatnonzero(points[:, 1] > 0.9)
    best = score(bowl, above, ScoreConfig(jitter=False)).peak[floor]
    views = found.views + found.covering_views
    shown = score(bowl, views, ScoreConfig(jitter=False)).peak[floor]
    assert best.mean() > 0.1
    assert (shown > 0.25 * best).mean() > 0.8


def test_rooms_are_seen_from_inside() -> None:
    half = np.array([2.5, 1.3, 2.0])
    table = box((0.5, 0.4, 0.4), 2000, (1.0, 0.9, 0.5))
    splats = concatenate([box(half, 3000), table, sphere(0.2, 1200, (-1.0, 0.2, 0.3))])
    cameras = plan_views(splats, SMALL)
    within = (np.abs(places(cameras)) < half).all(axis=1)
    assert within.mean() > 0.6
    in_table = (np.abs(places(cameras) - [1.0, 0.9, 0.5]) < [0.5, 0.4, 0.4]).all(axis=1)
    assert in_table.mean() < 0.1
    assert covered(splats, cameras).mean() > 0.99


def test_open_ground_is_seen_from_above() -> None:
    rng = np.random.default_rng(3)
    ground = rng.uniform(-50.0, 50.0, (4000, 3))
    ground[:, 1] = 2.0 * np.sin(ground[:, 0] / 9.0)
    # Its back is visible too; viewers still look down on it.
    splats = balls(ground, 1.2)
    cameras = plan_views(splats, SMALL)
    above = places(cameras)[:, 1] < 0.0
    assert above.mean() > 0.5, "y points down"
    upside_down = replace(splats, info=SceneInfo(axes="RUB"))
    above = places(plan_views(upside_down, SMALL))[:, 1] > 0.0
    assert above.mean() > 0.5, "y points up"


def test_things_far_apart_are_each_looked_at() -> None:
    first, second = sphere(1.0, 800, (-10.0, 0.0, 0.0)), sphere(1.0, 800, (10.0, 0.0, 0.0))
    cameras = plan_views(concatenate([first, second]), SMALL)
    close = [np.linalg.norm(places(cameras) - [x, 0.0, 0.0], axis=1) < 8.0 for x in (-10.0, 10.0)]
    assert close[0].sum() >= 6
    assert close[1].sum() >= 6


def test_cameras_keep_upright() -> None:
    for camera in plan_views(sphere(1.0), SMALL):
        down, forward = camera.rotation[1], camera.rotation[2]
        if abs(forward[1]) < 0.99:
            assert abs(camera.rotation[0][1]) < 1e-9
            assert down[1] > 0.0


def test_extreme_outliers_do_not_draw_views_away() -> None:
    rng = np.random.default_rng(4)
    splats = sphere(1.0)
    splats.means[:10] = rng.normal(size=(10, 3)) * 1e7
    splats.scales[10] = 60.0
    splats.opacities[10] = -3.0
    cameras = plan_views(splats, SMALL)
    assert (np.linalg.norm(places(cameras), axis=1) < 20.0).mean() > 0.8
    assert all(np.isfinite(camera.translation).all() for camera in cameras)
    assert covered(splats, cameras).mean() > 0.98


@pytest.mark.parametrize("log_scale", [-30.0, -4.0, 3.0, 70.0])
def test_one_splat_is_seen(log_scale: float) -> None:
    splats = empty(0, 1)
    splats.means[0] = [3.0, -2.0, 1.0]
    splats.scales[0] = log_scale
    cameras = plan_views(splats, replace(SMALL, views=4))
    assert len(cameras) >= 4
    assert (gaze(cameras, [3.0, -2.0, 1.0]) > 0.9).all()
    if -10.0 < log_scale < 10.0:
        assert score(splats, cameras, ScoreConfig(jitter=False)).shown[0] == len(cameras)


def test_splats_all_in_one_point_are_seen() -> None:
    splats = balls(np.full((300, 3), 3.0), 0.1)
    cameras = plan_views(splats, SMALL)
    assert (gaze(cameras, [3.0, 3.0, 3.0]) > 0.9).all()
    assert covered(splats, cameras).all()


def test_rows_that_cannot_be_drawn_are_left_out() -> None:
    splats = oracle.scene(6)
    broken = splats.take(np.arange(6))
    broken.means[0] = np.nan
    broken.opacities[1] = np.nan
    broken.opacities[2] = -np.inf
    broken.scales[3] = np.inf
    broken.quats[4] = 0.0
    broken.opacities[5] = -9.0
    same(plan_views(concatenate([splats, broken]), SMALL), plan_views(splats, SMALL))


def test_scenes_without_anything_to_see_are_refused() -> None:
    invisible = empty(0, 3)
    invisible.opacities[:] = -np.inf
    for splats in (empty(0), invisible):
        with pytest.raises(DataError) as caught:
            plan_views(splats)
        assert caught.value.code == "empty-scene"


@pytest.mark.parametrize(
    "wrong",
    [{"views": 0}, {"width": 0}, {"height": 70000}, {"fov_deg": 180.0}, {"threads": -1}],
)
def test_wrong_settings_are_refused(wrong: dict[str, int]) -> None:
    with pytest.raises(ValueError, match="expected"):
        ViewPlanConfig(**wrong)


def test_progress_ends_at_its_total_and_may_stop_the_work() -> None:
    calls: list[tuple[str, int, int]] = []
    plan_views(sphere(1.0, 200), SMALL, progress=lambda *call: calls.append(call))
    done = [call[1] for call in calls]
    assert done == sorted(done)
    assert {call[2] for call in calls} == {done[-1]}
    assert len({call[0] for call in calls}) == 1

    def stop(stage: str, done: int, total: int) -> None:
        raise Cancelled

    with pytest.raises(Cancelled):
        plan_views(sphere(1.0, 200), SMALL, progress=stop)


@pytest.mark.slow
def test_a_scene_with_everything_is_covered() -> None:
    splats = synth(10_000, sh_degree=0)
    cameras = plan_views(splats)
    small = [
        replace(
            camera,
            width=camera.width // 2,
            height=camera.height // 2,
            fx=camera.fx / 2,
            fy=camera.fy / 2,
            cx=camera.cx / 2,
            cy=camera.cy / 2,
        )
        for camera in cameras
    ]
    assert covered(splats, small).mean() >= 0.97
