"""Views of a tuning run: training views, covering views, held-out views and test views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from cogsplat.codec.cameras import Camera
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.splats import Splats
from cogsplat.codec.views.planner import ViewPlanConfig, plan

from .training_views import held_out_views


@dataclass(frozen=True, eq=False)
class TuningViews:
    """Cameras of a tuning run, by their use.

    Parameters
    ----------
    cameras : sequence of Camera
        Views that the scene is trained and scored in.
    covering : sequence of Camera
        Views of regions that `cameras` hardly show.
    held_out : sequence of Camera
        Views between cameras that training leaves out.
    test_views : sequence of Camera
        Views that PSNR is measured in: held-out views where there are any. Empty for some of
        `cameras`.
    planned : bool
        Whether the views were planned because no cameras were given.
    """

    cameras: Sequence[Camera]
    covering: Sequence[Camera] = ()
    held_out: Sequence[Camera] = ()
    test_views: Sequence[Camera] = ()
    planned: bool = False


def choose_tuning_views(
    splats: Splats,
    cameras: Sequence[Camera] | None,
    *,
    test_views: Sequence[Camera] = (),
    threads: int = 0,
    progress: Progress = silent,
) -> TuningViews:
    """Choose the views of a tuning run from given cameras, or plan views around the scene.

    Parameters
    ----------
    splats : Splats
        Scene to tune.
    cameras : sequence of Camera or None
        Given cameras; None plans views.
    test_views : sequence of Camera
        Fallback for the test views, where no view between given cameras can be held out. By
        default, a subset of the cameras.
    threads : int
        Number of threads, 0 for all cores.
    progress : Progress
        Receives the stage ``plan views`` where views are planned.

    Returns
    -------
    TuningViews

    Raises
    ------
    DataError
        ``empty-scene``: no view can be planned.
    """
    if cameras is not None:
        held_out = held_out_views(cameras)
        return TuningViews(cameras, (), held_out, held_out or test_views)
    # Quality in training views would be too optimistic: planned test views are separate.
    found = plan(splats, ViewPlanConfig(threads=threads), progress=progress)
    return TuningViews(found.views, found.covering_views, (), found.test_views, planned=True)
