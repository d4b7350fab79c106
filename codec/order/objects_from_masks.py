"""Labels for splats from masks of a few views: whose pixels a splat shows in, it belongs to."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError, LimitError
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.render.label_votes import label_votes
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import ordered_map, thread_count

# Votes are a float64 per splat and label.
_MOST_VOTES: Final = 1 << 30

# Splats that no mask sees go with most of so many neighbours that some mask does.
_NEIGHBOURS: Final = 5


def assign(
    splats: Splats,
    cameras: Sequence[Camera],
    masks: Sequence[NDArray[np.integer]],
    *,
    threads: int = 0,
    progress: Progress = silent,
) -> NDArray[np.uint32]:
    """Give every splat the label whose mask collects most of its weight (PRoGS, section 3.4).

    Parameters
    ----------
    splats : Splats
    cameras : sequence of Camera
        In the frame of the means, at least one.
    masks : sequence of (H, W) integer
        Of each camera, in its size: labels from 0 to 2³² - 1, 0 for what is no object.
    threads : int
        0 for all cores; the labels do not depend on it.
    progress : Progress
        Called with ``("masks", views done, views)``.

    Returns
    -------
    (N,) uint32
        Of equal votes the smallest label. A splat that shows in no pixel goes with most of its five
        nearest neighbours that do, of equally many with the nearest.

    Raises
    ------
    DataError
        ``no-cameras``; ``cameras-see-nothing``: no splat shows in any pixel.
    LimitError
        ``mask-labels``: more splats times labels than fit into memory.
    ValueError
        Masks of another number or size than the cameras.
    """
    if not cameras:
        raise DataError("no-cameras", "0 cameras with masks, expected at least 1")
    sizes = [(camera.height, camera.width) for camera in cameras]
    if [mask.shape for mask in masks] != sizes:
        raise ValueError(f"masks of {[mask.shape for mask in masks]}, expected {sizes}")
    known = np.unique(np.concatenate([np.unique(mask) for mask in masks]))
    if len(known) * len(splats) > _MOST_VOTES:
        raise LimitError(
            "mask-labels",
            f"{len(known)} labels for {len(splats)} splats, expected at most {_MOST_VOTES} of "
            "both multiplied",
        )
    votes = np.zeros((len(splats), len(known)), np.float64)
    progress("masks", 0, len(cameras))
    results = ordered_map(
        lambda view: label_votes(
            splats,
            cameras[view],
            np.searchsorted(known, masks[view]).astype(np.int32),
            len(known),
        ),
        range(len(cameras)),
        thread_count(threads),
    )
    for done, (rows, found) in enumerate(results, start=1):
        votes[rows] += found
        progress("masks", done, len(cameras))
    seen = votes.max(axis=1, initial=0.0) > 0
    if not seen.any():
        raise DataError(
            "cameras-see-nothing",
            f"none of {len(splats)} splats reaches a pixel of the {len(cameras)} masks, expected "
            "cameras in the frame of the scene",
        )
    winners = votes.argmax(axis=1)
    if not seen.all():
        winners[~seen] = _from_neighbours(splats.means, winners, seen, len(known))
    labels: NDArray[np.uint32] = known[winners].astype(np.uint32)
    return labels


def _from_neighbours(
    means: NDArray[np.float32],
    winners: NDArray[np.intp],
    seen: NDArray[np.bool_],
    count: int,
) -> NDArray[np.intp]:
    """Return what most of the neighbours of those not seen are, among those seen."""
    from scipy.spatial import KDTree

    finite = np.nan_to_num(means.astype(np.float64), posinf=0.0, neginf=0.0)
    nearest = min(_NEIGHBOURS, int(seen.sum()))
    found = KDTree(finite[seen]).query(finite[~seen], k=np.arange(1, nearest + 1))[1]
    around = winners[seen][found]
    tally = np.zeros((len(around), count), np.float64)
    for rank in range(nearest):
        # The nearest counts a little more, which decides ties and nothing else.
        weight = 1.5 if rank == 0 else 1.0
        tally[np.arange(len(around)), around[:, rank]] += weight
    chosen: NDArray[np.intp] = tally.argmax(axis=1)
    return chosen
