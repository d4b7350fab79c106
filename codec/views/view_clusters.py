"""Clusters of cameras that stand near each other and look the same way."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


def view_clusters(cameras: Sequence[Camera], count: int) -> list[I64]:
    """Gather cameras into clusters, each around one that is far from those of the others.

    Two cameras are as far from each other as their distance, in root mean square distances of the
    cameras from their mean position, and one less the cosine of the angle between their directions:
    half a turn counts as much as twice the spread of the cameras.

    Parameters
    ----------
    cameras : sequence of Camera
        At least one.
    count : int
        Most clusters, at least 1.

    Returns
    -------
    list of (m,) int64
        Numbers of the cameras of each cluster, ascending; at least one each. The clusters stand in
        an order in which each is near the one before.

    Notes
    -----
    Centres are chosen farthest first (Gonzalez, Clustering to minimize the maximum intercluster
    distance, 1985); of equal distances the earlier camera counts. Every camera joins its nearest
    centre.

    Examples
    --------
    >>> from cogsplat.codec.views.view_clusters import view_clusters
    >>> import cogsplat
    >>> cameras = cogsplat.read_cameras("cameras.json")[:8]
    >>> clusters = view_clusters(cameras, 2)
    >>> len(clusters), sum(len(cluster) for cluster in clusters)
    (2, 8)
    """
    positions = np.stack([camera.position for camera in cameras])
    forward = np.stack([camera.rotation[2] for camera in cameras])
    from_middle = np.square(positions - positions.mean(axis=0)).sum(axis=1)
    spread = max(float(np.sqrt(from_middle.mean())), 1e-9)

    def away(other: int) -> F64:
        moved = np.sqrt(np.square(positions - positions[other]).sum(axis=1)) / spread
        distance: F64 = moved + 1.0 - (forward * forward[other]).sum(axis=1)
        return distance

    centres = [0]
    nearest = away(0)
    owner = np.zeros(len(cameras), np.int64)
    while len(centres) < min(count, len(cameras)):
        farthest = int(np.argmax(nearest))
        distance = away(farthest)
        owner[distance < nearest] = len(centres)
        owner[farthest] = len(centres)
        nearest = np.minimum(nearest, distance)
        nearest[farthest] = -1.0
        centres.append(farthest)
    return [np.flatnonzero(owner == cluster) for cluster in _path(centres, away)]


def _path(centres: Sequence[int], away: Callable[[int], F64]) -> list[int]:
    """Return clusters in an order in which each is the nearest to the one before of those left."""
    left = list(range(len(centres)))
    path = [left.pop(0)]
    while left:
        distance = away(centres[path[-1]])
        path.append(left.pop(int(np.argmin([distance[centres[cluster]] for cluster in left]))))
    return path
