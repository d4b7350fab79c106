"""Scoring views of an encode: given cameras, thinned by the preset, planned views, or both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError
from cogsplat.codec.executor import LocalThreads
from cogsplat.codec.progress import Progress
from cogsplat.codec.scoring.contribution import Scorer, Scores
from cogsplat.codec.scoring.score_config import ScoreConfig
from cogsplat.codec.scoring.splat_groups import GroupShares, group_splats, measure_shares
from cogsplat.codec.scoring.view_sums import ViewSums
from cogsplat.codec.splats import Splats
from cogsplat.codec.views.planner import ViewPlan, plan
from cogsplat.codec.views.view_sets import TEST_VIEWS, leave_out, sample_evenly

from .encoded import EncodeReport
from .presets import Preset
from .request import EncodeRequest

_SINGLE_CAMERA_LIMIT: Final = 0.01
"""Most of all contribution that may come from splats which at most one camera shows.

Above it, more of the given views are scored; if it is still above, planned views too.
docs/ablations.md, "Scoring large scenes", has the shares of scenes beside what other cameras show
there and scored ones do not.
"""

_GROWTH: Final = 4
"""Factor on the number of given views where they overlap too little."""


@dataclass(frozen=True, eq=False)
class ScoredViews:
    """Scores of a scene, with scoring views and test views.

    Parameters
    ----------
    scores : Scores or None
        Scores of the splats; None where no view was scored.
    views : sequence of Camera
        Scoring views; empty where there are none.
    test_views : sequence of Camera
        Views to measure quality in; empty for no prediction.
    jitter : bool
        Whether jittered copies of the views were scored as well.
    report : EncodeReport
        Origin of the views, origin of the test views, and coverage.
    group_shares : GroupShares or None
        Shares of groups of splats in the views, from which `EncodeConfig.cells` gets regions; None
        without cells.
    """

    scores: Scores | None
    views: Sequence[Camera]
    test_views: Sequence[Camera]
    jitter: bool
    report: EncodeReport
    group_shares: GroupShares | None = None


def score_scene(splats: Splats, request: EncodeRequest, progress: Progress) -> ScoredViews:
    """Score a scene in the views of a request, or in views that are planned around it.

    Parameters
    ----------
    splats : Splats
        Valid splats.
    request : EncodeRequest
        Given scores are returned as they are; without cameras, views are planned.
    progress : Progress
        Called with ``plan views`` and ``score``.

    Raises
    ------
    DataError
        ``no-cameras``, ``cameras-see-nothing``, ``empty-scene``; ``value-range`` where no splat
        is in the planned views.
    """
    if request.scores is not None or not len(splats):
        given = list(request.cameras or ())
        shares = None
        if request.config.cells and given and len(splats):
            shares = measure_shares(
                splats,
                given,
                workspace=request.workspace,
                executor=request.view_executor or LocalThreads(request.config.threads),
                progress=progress,
            )
        return _given_views(request, given, request.scores, shares)
    if request.cameras is None:
        return _score_planned(splats, request, progress)
    used, left_out = leave_out(request.cameras)
    if request.test_views:
        used = list(request.cameras)
    # An empty list of cameras is refused here; only None plans views.
    scorer = _scorer(splats, request, progress)
    views, share = _add_given(scorer, used, request.effort, request.scoring)
    if share <= _SINGLE_CAMERA_LIMIT or not left_out:
        return _given_views(request, views, scorer.scores(), scorer.group_shares)
    return _score_planned(splats, request, progress, scorer, views)


def _scorer(splats: Splats, request: EncodeRequest, progress: Progress) -> Scorer:
    """Return a scorer of the scene with the settings of a request."""
    return Scorer(
        splats,
        request.scoring,
        workspace=request.workspace,
        executor=request.executor,
        groups=group_splats(splats.means, request.workspace) if request.config.cells else None,
        progress=progress,
    )


def _given_views(
    request: EncodeRequest,
    views: Sequence[Camera],
    scores: Scores | None,
    group_shares: GroupShares | None,
) -> ScoredViews:
    """Return the scores and shares in some of the given cameras, with test views."""
    tests, origin = _test_views(request, views)
    report = EncodeReport(views="given" if views else "none", test_views=origin)
    if views and scores is not None and len(scores.covered):
        report = replace(report, coverage=float((scores.covered > 0).mean()))
    return ScoredViews(scores, views, tests, request.scoring.jitter, report, group_shares)


def _test_views(request: EncodeRequest, scored: Sequence[Camera]) -> tuple[Sequence[Camera], str]:
    """Return the test views of given cameras, and their origin (`EncodeReport.test_views`)."""
    if request.test_views:
        return sample_evenly(request.test_views, TEST_VIEWS), "given"
    known = {id(view) for view in scored}
    left_out = [view for view in request.cameras or () if id(view) not in known]
    if left_out:
        return sample_evenly(left_out, TEST_VIEWS), "left-out"
    return sample_evenly(scored, TEST_VIEWS), "scored" if scored else "none"


def _score_planned(
    splats: Splats,
    request: EncodeRequest,
    progress: Progress,
    scorer: Scorer | None = None,
    given: Sequence[Camera] = (),
) -> ScoredViews:
    """Score a scene in planned views as well as the given cameras, which overlap too little.

    `scorer` has the scores in the given cameras; None without such cameras.
    """
    planned = _plan_views(splats, request, progress, in_addition=bool(given))
    jittered = request.scoring.jitter and request.effort.planned_jitter
    views = [*given, *planned.views]
    if given:
        tests, origin = _test_views(request, given)
    elif request.test_views or not planned.test_views:
        tests, origin = request.test_views, "given" if request.test_views else "none"
    else:
        tests, origin = planned.test_views, "planned"
    without_views = ScoredViews(None, (), tests, jittered, EncodeReport(test_views=origin))
    if not views:
        return without_views
    if scorer is None:
        scorer = _scorer(splats, request, progress)
    scorer.add(planned.views, jittered=jittered)
    scorer.add(planned.covering_views, covering=True)
    try:
        scores = replace(scorer.scores(), sparse=bool(given))
    except DataError as error:
        if error.code != "cameras-see-nothing":
            raise
        if request.config.profile == "near-lossless":
            return without_views
        raise DataError(
            "value-range",
            f"none of {len(splats)} splats reaches a pixel of the planned views, expected means "
            "and log scales that a picture can show",
        ) from error
    found = "given and planned" if given else "planned"
    report = EncodeReport(views=found, test_views=origin, coverage=planned.coverage)
    return ScoredViews(scores, views, tests, jittered, report, scorer.group_shares)


def _plan_views(
    splats: Splats, request: EncodeRequest, progress: Progress, *, in_addition: bool
) -> ViewPlan:
    """Return planned scoring and test views; none if a near-lossless scene shows nothing."""
    try:
        settings = request.effort.plan_config(request.config.threads, in_addition=in_addition)
        settings = settings.at_width(request.shown_at)
        return plan(splats, settings, executor=request.executor, progress=progress)
    except DataError as error:
        if error.code != "empty-scene" or request.config.profile != "near-lossless":
            raise
        return ViewPlan([], [], [], 1.0)


def single_camera_share(scores: Scores | ViewSums, config: ScoreConfig) -> float:
    """Return the share of all contribution from splats that at most one camera shows.

    It estimates the part of a picture from a further camera that the scored cameras do not show
    (leave-one-out; Good 1953, "The population frequencies of species").

    Parameters
    ----------
    scores : Scores or ViewSums
        Scores in the cameras.
    config : ScoreConfig
        Settings of the scoring pass. A splat counts as shown by at most one camera if the
        number of views that show it (`SHOWN_WEIGHT`) is at most that of one camera with its
        jittered copies. Of cameras scored without copies, several then count as one.

    Returns
    -------
    float
        0 to 1; 0 for a scene without any contribution.

    Examples
    --------
    >>> import cogsplat
    >>> from cogsplat.codec.scoring.contribution import score
    >>> splats = cogsplat.read("scene.ply")
    >>> cameras = cogsplat.read_cameras("cameras.json")[:8]
    >>> config = ScoreConfig()
    >>> single_camera_share(score(splats, cameras, config), config) < 0.05
    True
    """
    total = float(scores.contribution.sum())
    if total == 0.0:
        return 0.0
    of_one = scores.shown <= (1 + config.jitter_copies if config.jitter else 1)
    return float(np.sum(scores.contribution, where=of_one)) / total


def _add_given(
    scorer: Scorer, cameras: Sequence[Camera], preset: Preset, config: ScoreConfig
) -> tuple[list[Camera], float]:
    """Score the preset's number of given views, and more if single cameras show much.

    Where single cameras show much that no other shows, as in rooms with walls between them, four
    times as many are scored; all, if there are fewer.

    Returns
    -------
    (list of Camera, float)
        Scored views in the order of the given ones, and their `single_camera_share`.
    """
    numbers = range(len(cameras))
    scored = sample_evenly(numbers, len(preset.views(cameras)))
    scorer.add([cameras[number] for number in scored], jittered=config.jitter)
    share = single_camera_share(scorer.sums, config)
    rest = sorted(set(numbers) - set(scored))
    if rest and share > _SINGLE_CAMERA_LIMIT:
        further = sample_evenly(rest, (_GROWTH - 1) * len(scored))
        # Without moved copies: what they gain is not worth their time (docs/ablations.md).
        scorer.add([cameras[number] for number in further])
        scored = sorted([*scored, *further])
        share = single_camera_share(scorer.sums, config)
    return [cameras[number] for number in scored], share
