"""Object labels from masks: each splat gets the label under most of its blending weight."""

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

# Limit of splats times labels: each pair takes a float64.
_MAX_VOTES: Final = 1 << 30

# Number of nearest seen splats that vote on the label of a splat seen in no mask.
_NEIGHBOURS: Final = 5


def labels_from_masks(
    splats: Splats,
    cameras: Sequence[Camera],
    masks: Sequence[NDArray[np.integer]],
    *,
    threads: int = 0,
    progress: Progress = silent,
) -> NDArray[np.uint32]:
    """Label every splat by the mask label whose pixels it weighs most in (PRoGS, section 3.4).

    Parameters
    ----------
    splats : Splats
        Scene to label.
    cameras : sequence of Camera
        Cameras of the masks in the frame of the means, at least one.
    masks : sequence of (H, W) integer
        Mask of each camera, at its image size: labels from 0 to 2³² - 1, 0 for pixels of no object.
    threads : int
        Number of threads; 0 for all cores. Labels do not depend on it.
    progress : Progress
        Called with ``("masks", views done, views)``.

    Returns
    -------
    (N,) uint32
        Label of each splat; ties go to the smallest label. A splat that no pixel shows gets the
        most common label of the five nearest splats that are seen; ties go to the nearest.

    Raises
    ------
    DataError
        ``no-cameras``: there is no camera. ``cameras-see-nothing``: no splat is seen in any pixel.
    LimitError
        ``mask-labels``: splats times labels exceed 2³⁰.
    ValueError
        Number or sizes of masks and cameras differ.
    """
    if not cameras:
        raise DataError("no-cameras", "0 cameras with masks, expected at least 1")
    sizes = [(camera.height, camera.width) for camera in cameras]
    if [mask.shape for mask in masks] != sizes:
        raise ValueError(f"masks of {[mask.shape for mask in masks]}, expected {sizes}")
    known = np.unique(np.concatenate([np.unique(mask) for mask in masks]))
    if len(known) * len(splats) > _MAX_VOTES:
        raise LimitError(
            "mask-labels",
            f"{len(known)} labels for {len(splats)} splats, expected at most {_MAX_VOTES} of "
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
        winners[~seen] = _labels_of_neighbours(splats.means, winners, seen, len(known))
    labels: NDArray[np.uint32] = known[winners].astype(np.uint32)
    return labels


def _labels_of_neighbours(
    means: NDArray[np.float32],
    labels: NDArray[np.intp],
    seen: NDArray[np.bool_],
    num_labels: int,
) -> NDArray[np.intp]:
    """Return, for each unseen splat, the most common label of the nearest seen splats.

    Parameters
    ----------
    means : (N, 3) float32
        Means of all splats.
    labels : (N,) intp
        Number of each splat's label, 0 to `num_labels` - 1; ignored for unseen splats.
    seen : (N,) bool
        Mask of the splats that some mask shows.
    num_labels : int
        Number of distinct labels.
    """
    from scipy.spatial import KDTree

    finite = np.nan_to_num(means.astype(np.float64), posinf=0.0, neginf=0.0)
    nearest = min(_NEIGHBOURS, int(seen.sum()))
    found = KDTree(finite[seen]).query(finite[~seen], k=np.arange(1, nearest + 1))[1]
    around = labels[seen][found]
    tally = np.zeros((len(around), num_labels), np.float64)
    for rank in range(nearest):
        # Half an extra vote for the nearest splat decides ties only.
        weight = 1.5 if rank == 0 else 1.0
        tally[np.arange(len(around)), around[:, rank]] += weight
    chosen: NDArray[np.intp] = tally.argmax(axis=1)
    return chosen
