"""Given views are scored until little is shown by one camera alone."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from cogsplat.codec.cameras import Camera
from cogsplat.codec.encode import request as request_module
from cogsplat.codec.encode.config import EncodeConfig
from cogsplat.codec.encode.pipeline import encode
from cogsplat.codec.encode.presets import PRESETS
from cogsplat.codec.encode.request import EncodeRequest
from cogsplat.codec.encode.scored_views import ScoredViews, score_scene, single_camera_share
from cogsplat.codec.errors import DataError
from cogsplat.codec.progress import silent
from cogsplat.codec.scoring.contribution import score
from cogsplat.codec.scoring.score_config import ScoreConfig
from cogsplat.codec.splats import Splats
from cogsplat.codec.views.view_sets import CLOSE_VIEWS
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras

PLAIN = ScoreConfig(jitter=False)
FAST = PRESETS["fast"]


@pytest.fixture(scope="module")
def rooms() -> tuple[Splats, list[Camera]]:
    """36 scenes so far from each other that a camera shows one of them, each with one camera."""
    splats, cameras = synth(150, sh_degree=0), synth_cameras(36, 40, 30)
    shifts = [np.array([10_000.0 * place, 0.0, 0.0]) for place in range(36)]
    means = np.concatenate([splats.means + shift.astype(np.float32) for shift in shifts])
    many = splats.take(np.tile(np.arange(len(splats)), 36))
    moved = [
        replace(camera, translation=camera.translation - camera.rotation @ shift)
        for camera, shift in zip(cameras, shifts, strict=True)
    ]
    return replace(many, means=means), moved


def scored_in(splats: Splats, cameras: Sequence[Camera]) -> ScoredViews:
    """Score a scene in given cameras with the preset `fast`; none is left out as a test view."""
    config = EncodeConfig(order="contribution", compensate=False, threads=1)
    inputs = EncodeRequest(
        cameras=cameras,
        test_views=cameras[:1],
        config=config,
        preset="fast",
        score_config=PLAIN,
    )
    return score_scene(splats, inputs, silent)


def by_leaving_out(splats: Splats, cameras: Sequence[Camera]) -> float:
    """Return what is not shown without one of the cameras, by scoring without it, as a share."""
    missing = np.zeros(len(splats), np.bool_)
    for k in range(len(cameras)):
        missing |= score(splats, [*cameras[:k], *cameras[k + 1 :]], PLAIN).shown == 0
    contribution = sum(score(splats, [camera], PLAIN).contribution for camera in cameras)
    return float(np.sum(contribution, where=missing) / np.sum(contribution))


def test_what_one_camera_alone_shows_is_what_is_missing_without_it() -> None:
    splats, cameras = synth(400, sh_degree=0), synth_cameras(3, 40, 30)
    found = single_camera_share(score(splats, cameras, PLAIN), PLAIN)
    assert 0.0 < found < 1.0
    assert found == pytest.approx(by_leaving_out(splats, cameras), rel=1e-6)


def test_jittered_copies_count_as_their_camera() -> None:
    splats, cameras = synth(400, sh_degree=0), synth_cameras(1, 40, 30)
    config = ScoreConfig(jitter_copies=1)
    scores = score(splats, cameras, config)
    assert scores.shown.max() == 2
    assert single_camera_share(scores, config) == 1.0
    assert single_camera_share(scores, PLAIN) < 1.0


def test_views_of_one_place_are_thinned_out() -> None:
    cameras = synth_cameras(48, 40, 30)
    found = scored_in(synth(400, sh_degree=0), cameras)
    assert list(found.views) == FAST.views(cameras)
    assert len(found.views) < len(cameras)
    assert found.scores is not None
    assert found.scores.num_pixels == sum(view.width * view.height for view in found.views)


def test_all_views_are_scored_where_each_shows_a_place_of_its_own(
    rooms: tuple[Splats, list[Camera]],
) -> None:
    splats, cameras = rooms
    assert len(FAST.views(cameras)) < len(cameras)
    found = scored_in(splats, cameras)
    assert list(found.views[: len(cameras)]) == cameras
    # Eight cameras leave none out: what further views would show is not asked.
    found = scored_in(splats, cameras[:8])
    assert (found.report.views, list(found.views)) == ("given", cameras[:8])
    assert found.scores is not None
    expected = score(splats, cameras[:8], PLAIN)
    assert found.scores.contribution.tobytes() == expected.contribution.tobytes()


def test_four_times_as_many_views_at_most_are_scored(
    rooms: tuple[Splats, list[Camera]], monkeypatch: pytest.MonkeyPatch
) -> None:
    splats, cameras = rooms
    few = replace(FAST, most_views=4)
    monkeypatch.setattr(request_module, "PRESETS", {"fast": few})
    found = scored_in(splats, cameras)
    assert found.report.views == "given and planned"
    views = [view for view in found.views if view in cameras]
    assert len(views) == 16
    assert list(found.views[:16]) == views
    assert set(few.views(cameras)) <= set(views)
    assert [cameras.index(view) for view in views] == sorted(map(cameras.index, views))
    assert found.scores is not None
    assert found.scores.num_pixels == sum(view.width * view.height for view in found.views)


def test_planned_views_show_rooms_without_a_scored_camera(
    rooms: tuple[Splats, list[Camera]],
) -> None:
    splats, cameras = rooms
    config = EncodeConfig(order="contribution", compensate=False, threads=1)
    request = EncodeRequest(cameras=cameras, config=config, preset="fast", score_config=PLAIN)
    found = score_scene(splats, request, silent)
    assert (found.report.views, found.report.test_views) == ("given and planned", "left-out")
    assert list(found.test_views) == cameras[::4]
    used = [camera for camera in cameras if camera not in cameras[::4]]
    assert list(found.views[: len(used)]) == used
    assert found.scores is not None
    of_used = score(splats, used, PLAIN)
    unseen = (score(splats, cameras[::4], PLAIN).shown > 0) & (of_used.shown == 0)
    assert unseen.any()
    assert (found.scores.shown[unseen] > 0).mean() > 0.5
    assert found.scores.sparse
    # Half as many as without cameras, and views for what they leave out.
    planned = len(found.views) - len(used)
    assert FAST.planned_views // 2 <= planned < FAST.planned_views


def test_only_the_first_views_have_moved_copies(
    rooms: tuple[Splats, list[Camera]], monkeypatch: pytest.MonkeyPatch
) -> None:
    splats, cameras = rooms
    monkeypatch.setattr(request_module, "PRESETS", {"fast": replace(FAST, most_views=4)})
    config = EncodeConfig(order="contribution", compensate=False, threads=1)
    request = EncodeRequest(cameras=cameras, config=config, preset="fast")
    found = score_scene(splats, request, silent)
    views = [view for view in found.views if view in cameras]
    assert len(views) == 16
    copies = 4 * cameras[0].width * cameras[0].height
    assert found.scores is not None
    shown = sum(view.width * view.height for view in found.views)
    assert found.scores.num_pixels == shown + copies


def test_no_views_are_refused() -> None:
    with pytest.raises(DataError) as error:
        scored_in(synth(100), [])
    assert error.value.code == "no-cameras"


def test_quality_is_predicted_in_cameras_that_were_not_scored() -> None:
    splats, cameras = synth(400, sh_degree=0), synth_cameras(17, 40, 30)
    config = EncodeConfig(compensate=False, order="contribution")
    request = EncodeRequest(config=config, cameras=cameras, score_config=PLAIN)
    found = score_scene(splats, request, silent)
    assert found.report.test_views == "left-out"
    assert [view.name for view in found.test_views] == [cameras[k].name for k in (0, 4, 8, 12, 16)]
    assert not {view.name for view in found.views} & {view.name for view in found.test_views}
    # A preset that scores few of many leaves out more, and the predicted figures are theirs.
    made = encode(splats, replace(request, preset="fast"))
    assert made.report.test_views == "left-out"
    assert made.report.scored_views + len(made.report.test_psnr_db) == len(cameras)
    assert len(made.report.test_distances) == len(made.report.test_psnr_db)
    assert 0 < len(made.report.close_psnr_db) <= CLOSE_VIEWS
    assert max(made.report.close_distances) < max(made.report.test_distances)


def test_given_test_views_leave_all_cameras_to_be_scored() -> None:
    splats, cameras = synth(400, sh_degree=0), synth_cameras(17, 40, 30)
    request = EncodeRequest(cameras=cameras[1:], test_views=cameras[:1], score_config=PLAIN)
    found = score_scene(splats, request, silent)
    assert (found.report.test_views, len(found.views)) == ("given", 16)
    assert list(found.test_views) == cameras[:1]


def test_few_cameras_are_all_scored_and_measured_in() -> None:
    splats, cameras = synth(400, sh_degree=0), synth_cameras(8, 40, 30)
    request = EncodeRequest(cameras=cameras, score_config=PLAIN)
    found = score_scene(splats, request, silent)
    assert found.report.test_views == "scored"
    assert list(found.test_views) == list(found.views) == cameras
