"""Deletion errors: what pictures lose when a splat is taken out of a scene."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.render.marginal_gains import marginal_gains
from cogsplat.codec.render.projection import project
from cogsplat.codec.render.rasteriser import render
from cogsplat.codec.render.shading import footprint_colours
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import ordered_map, thread_count

from .training_views import TrainingViews

F64 = NDArray[np.float64]


def _view_errors(
    view: int, splats: Splats, training_views: TrainingViews
) -> tuple[NDArray[np.int32], F64]:
    """Return the rows that a view shows, and what its picture changes without each of them."""
    camera, config = training_views.cameras[view], training_views.configs[view]
    footprints = project(splats, camera, kernel_px=config.kernel_px, antialiased=config.antialiased)
    colours = footprint_colours(splats, camera, footprints)
    picture = render(splats, camera, config)
    present = np.ones(len(footprints), np.bool_)
    # Against its own picture, what a splat gains is less than nothing: the change, squared.
    gains, _ = marginal_gains(footprints, colours, present, picture)
    return footprints.index, -gains


def deletion_errors(
    splats: Splats,
    training_views: TrainingViews,
    views: Sequence[int] | None = None,
    *,
    threads: int = 0,
    progress: Progress = silent,
) -> F64:
    """Measure how much the pictures of a scene change when one splat alone is taken out.

    Of a pixel that a splat covers with weight w and colour c, and behind which lies the colour R,
    taking it out changes ``w·c - R·α/(1 - α)``.

    Parameters
    ----------
    splats : Splats
    training_views : TrainingViews
        Their pictures are not looked at.
    views : sequence of int, optional
        Numbers of the views; all where it is not given.
    threads : int
        0 for every core this process may use. The sums do not depend on it.
    progress : Progress
        Called with ``deletions``, views done and views.

    Returns
    -------
    (N,) float64
        Sum over views, pixels and channels of the squared change.
    """
    numbers = range(len(training_views)) if views is None else views
    errors = np.zeros(len(splats))
    measure = partial(_view_errors, splats=splats, training_views=training_views)
    progress("deletions", 0, len(numbers))
    found = ordered_map(measure, numbers, thread_count(threads))
    for done, (rows, changes) in enumerate(found, start=1):
        errors[rows] += changes
        progress("deletions", done, len(numbers))
    return errors
