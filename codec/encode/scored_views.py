"""Score a scene in as many of the given views as it takes to see what they show."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from cogsplat.codec.cameras import Camera
from cogsplat.codec.executor import Executor
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.scoring.contribution import ScoreConfig, Scores, score
from cogsplat.codec.splats import Splats
from cogsplat.codec.views.view_sets import sample_evenly
from cogsplat.codec.workspace import IN_MEMORY, Workspace

from .presets import Preset

_MOST_SEEN_ONCE: Final = 0.02
"""Share of what views show that may be shown by one of them alone, before more views are scored.

A house of six rooms has 0.17 of it in 14 of 42 views: splats in rooms of the others were taken for
worthless, and pictures from there came to 13 dB. A million splats on a terrace have 0.012 in 20 of
100 views, and a captured room less than 0.00005 in 15 of 43.
"""

_MORE: Final = 4
"""How many times as many are scored then. What was scored before is a quarter of it at most."""


def seen_once(scores: Scores, config: ScoreConfig) -> float:
    """Return which share of all contribution comes from splats that one camera alone shows.

    That is the mean over the cameras of how much of a picture would be missing if splats that the
    other cameras do not show were dropped, and so about how much is missing in a further one
    (leaving one out; Good 1953, "The population frequencies of species").

    Parameters
    ----------
    scores : Scores
    config : ScoreConfig
        What they were scored with. A splat that is seen as often as one camera and its jittered
        copies can show it counts as shown by one, though two may have shown it.

    Returns
    -------
    float
        0 to 1; 0 where nothing is shown at all.

    Examples
    --------
    >>> import cogsplat
    >>> splats = cogsplat.read("scene.ply")
    >>> cameras = cogsplat.read_cameras("cameras.json")[:8]
    >>> config = ScoreConfig()
    >>> seen_once(score(splats, cameras, config), config) < 0.05
    True
    """
    total = float(scores.contribution.sum())
    if total == 0.0:
        return 0.0
    of_one = scores.seen <= (1 + config.jitter_copies if config.jitter else 1)
    return float(np.sum(scores.contribution, where=of_one)) / total


def score_given(
    splats: Splats,
    cameras: Sequence[Camera],
    preset: Preset,
    config: ScoreConfig,
    *,
    workspace: Workspace = IN_MEMORY,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> tuple[list[Camera], Scores]:
    """Score a scene in the views that a preset takes of the given ones, or in more.

    Where much is shown by one camera alone, as in rooms with walls between them, four times as many
    are taken, until little is or there are no more.

    Parameters
    ----------
    splats : Splats
    cameras : sequence of Camera
        All that were given.
    preset : Preset
    config : ScoreConfig
    workspace, executor, progress
        As `score` has them.

    Returns
    -------
    (list of Camera, Scores)
        The views, evenly spread over the given ones, and the scores in them.

    Raises
    ------
    CogsplatError
        As `score`.
    """
    views = preset.views(cameras)
    while True:
        scores = score(
            splats, views, config, workspace=workspace, executor=executor, progress=progress
        )
        if len(views) == len(cameras) or seen_once(scores, config) <= _MOST_SEEN_ONCE:
            return views, scores
        views = sample_evenly(cameras, min(_MORE * len(views), len(cameras)))
