"""Views of a tuning run: training views, covering views and test views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from cogsplat.codec.cameras import Camera
from cogsplat.codec.capture import Capture
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.splats import Splats
from cogsplat.codec.views.capture_choice import choose_capture
from cogsplat.codec.views.planner import ViewPlanConfig, plan
from cogsplat.codec.views.view_sets import TEST_VIEWS, at_width, leave_out, sample_evenly


@dataclass(frozen=True, eq=False)
class TuningViews:
    """Cameras of a tuning run, by their use.

    Parameters
    ----------
    cameras : sequence of Camera
        Views that the scene is trained and scored in.
    covering : sequence of Camera
        Views of regions that `cameras` hardly show.
    test_views : sequence of Camera
        Views that PSNR is measured in. If empty, some of `cameras` are used.
    origin : str
        Origin of the test views: ``left-out`` of the given cameras, ``scored`` where there are too
        few to leave some out, ``planned``.
    capture : Capture
        Viewpoints of the given cameras in their full size; none where none were given.
    """

    cameras: Sequence[Camera]
    covering: Sequence[Camera] = ()
    test_views: Sequence[Camera] = ()
    origin: str = "scored"
    capture: Capture = ()

    @property
    def planned(self) -> bool:
        """Whether the views were planned because no cameras were given."""
        return self.origin == "planned"


def choose_tuning_views(
    splats: Splats,
    cameras: Sequence[Camera] | None,
    *,
    shown_at: int | None = None,
    threads: int = 0,
    progress: Progress = silent,
) -> TuningViews:
    """Choose the views of a tuning run from given cameras, or plan views around the scene.

    Parameters
    ----------
    splats : Splats
        Scene to tune.
    cameras : sequence of Camera or None
        Given cameras, of which some are left out to measure in; None plans views.
    shown_at : int, optional
        Width of all views, px; by default that of the given cameras, or 400.
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
        used, left_out = leave_out(at_width(cameras, shown_at))
        origin = "left-out" if left_out else "scored"
        tests = sample_evenly(left_out, TEST_VIEWS)
        return TuningViews(used, (), tests, origin, choose_capture(splats, cameras))
    # Quality in training views would be too optimistic: planned test views are separate.
    settings = ViewPlanConfig(threads=threads).at_width(shown_at)
    found = plan(splats, settings, progress=progress)
    return TuningViews(found.views, found.covering_views, found.test_views, "planned")
