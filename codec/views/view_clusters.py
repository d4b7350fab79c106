"""Clusters of cameras with similar positions and viewing directions."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


def view_clusters(cameras: Sequence[Camera], count: int) -> list[I64]:
    """Cluster cameras by position and viewing direction.

    The distance between two cameras is the sum of two terms. The first is the distance of their
    positions over the spread of all cameras (their RMS distance from the mean position). The
    second is 1 - cos of the angle between their viewing directions.

    Parameters
    ----------
    cameras : sequence of Camera
        Cameras to cluster, at least one.
    count : int
        Number of clusters at most, at least 1.

    Returns
    -------
    list of (m,) int64
        Ascending camera numbers of each cluster, none empty. Each cluster is close to the one
        before it.

    Notes
    -----
    Centres are chosen farthest first (Gonzalez, Clustering to minimize the maximum intercluster
    distance, 1985); ties go to the earlier camera. Every camera joins its nearest centre.

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

    def distances_to(other: int) -> F64:
        moved = np.sqrt(np.square(positions - positions[other]).sum(axis=1)) / spread
        distance: F64 = moved + 1.0 - (forward * forward[other]).sum(axis=1)
        return distance

    centres = [0]
    nearest = distances_to(0)
    owner = np.zeros(len(cameras), np.int64)
    while len(centres) < min(count, len(cameras)):
        farthest = int(np.argmax(nearest))
        distance = distances_to(farthest)
        owner[distance < nearest] = len(centres)
        owner[farthest] = len(centres)
        nearest = np.minimum(nearest, distance)
        nearest[farthest] = -1.0
        centres.append(farthest)
    return [np.flatnonzero(owner == cluster) for cluster in _greedy_path(centres, distances_to)]


def _greedy_path(centres: Sequence[int], distances_to: Callable[[int], F64]) -> list[int]:
    """Return cluster numbers, from 0 on: each is followed by the nearest remaining cluster.

    Parameters
    ----------
    centres : sequence of int
        Number of the camera at each cluster's centre.
    distances_to : callable
        Function that returns the distances of all cameras to the camera with a given number.
    """
    left = list(range(len(centres)))
    path = [left.pop(0)]
    while left:
        distance = distances_to(centres[path[-1]])
        path.append(left.pop(int(np.argmin([distance[centres[cluster]] for cluster in left]))))
    return path
