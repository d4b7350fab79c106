"""Deletion errors: how much pictures change when one splat is removed from a scene."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.render.marginal_gains import marginal_gains
from cogsplat.codec.render.projection import project
from cogsplat.codec.render.rasteriser import RenderConfig
from cogsplat.codec.render.shading import footprint_colours
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import ordered_map, thread_count

F64 = NDArray[np.float64]


def _view_errors(
    view: tuple[Camera, RenderConfig], splats: Splats
) -> tuple[NDArray[np.int32], F64]:
    """Return the rows of the splats that one view shows, and the deletion error of each in it."""
    camera, config = view
    footprints = project(splats, camera, reduction=config.reduction)
    # Relative to the background, a picture over it is one over black, as `marginal_gains` expects.
    colours = footprint_colours(splats, camera, footprints)
    colours -= np.array(config.background, np.float32)
    present = np.ones(len(footprints), np.bool_)
    # With the scene's own picture as ground truth, the gain of a splat is minus the squared change
    # that its deletion makes.
    gains, _ = marginal_gains(footprints, colours, present, (camera.width, camera.height))
    return footprints.index, -gains


def deletion_errors(
    splats: Splats,
    views: Sequence[tuple[Camera, RenderConfig]],
    *,
    threads: int = 0,
    progress: Progress = silent,
) -> F64:
    """Measure how much the pictures of a scene change when a single splat is removed.

    In a pixel where a splat has weight w, alpha α and colour c, and the splats and the background
    behind it add up to the colour R, its removal changes the colour by ``w·c - R·α/(1 - α)``.

    Parameters
    ----------
    splats : Splats
        Scene of N splats.
    views : sequence of (Camera, RenderConfig)
        Views to measure in, and their render settings.
    threads : int
        Number of threads; 0 uses all cores. The sums do not depend on it.
    progress : Progress
        Receives the stage ``deletions``, in views.

    Returns
    -------
    (N,) float64
        Squared colour change by the removal of each splat, summed over views, pixels and channels.
    """
    errors = np.zeros(len(splats))
    measure = partial(_view_errors, splats=splats)
    progress("deletions", 0, len(views))
    found = ordered_map(measure, views, thread_count(threads))
    for done, (rows, changes) in enumerate(found, start=1):
        errors[rows] += changes
        progress("deletions", done, len(views))
    return errors
