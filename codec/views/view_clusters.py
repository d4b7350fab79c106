"""Clusters of cameras with similar positions and viewing directions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.farthest_first import farthest_first
from cogsplat.codec.geometry.places_as_seen import places_as_seen

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


def view_clusters(cameras: Sequence[Camera], means: NDArray[np.floating], count: int) -> list[I64]:
    """Cluster cameras by position and viewing direction.

    The squared distance between two cameras is that of their places as the scene sees them
    (`places_as_seen`), + 1 - cos of the angle between their viewing directions.

    Parameters
    ----------
    cameras : sequence of Camera
        Cameras to cluster, at least one.
    means : (m, 3)
        Finite centres that are drawn evenly from the scene, at least one, scene units.
    count : int
        Number of clusters at most, at least 1.

    Returns
    -------
    list of (m,) int64
        Ascending camera numbers of each cluster, none empty. Each cluster is close to the one
        before it.

    Notes
    -----
    Centres are chosen farthest first. Every camera joins its nearest centre, of equally near ones
    the first that was chosen.

    Examples
    --------
    >>> from cogsplat.codec.views.view_clusters import view_clusters
    >>> import cogsplat
    >>> cameras = cogsplat.read_cameras("cameras.json")[:8]
    >>> clusters = view_clusters(cameras, cogsplat.read("scene.ply").means, 2)
    >>> len(clusters), sum(len(cluster) for cluster in clusters)
    (2, 8)
    """
    positions = np.stack([camera.position for camera in cameras])
    forward = np.stack([camera.rotation[2] for camera in cameras])
    # Half the squared distance of two unit vectors is 1 - cos of their angle.
    points = np.hstack([places_as_seen(positions, means), forward / np.sqrt(2.0)])
    centres = farthest_first(points, count)
    distances = np.stack([_distances(points, centre) for centre in centres])
    # Equal cameras may all be centres: each stays with itself.
    distances[np.arange(len(centres)), centres] = -1.0
    owners = distances.argmin(axis=0)
    path = _greedy_path(points[centres])
    return [np.flatnonzero(owners == cluster) for cluster in path]


def _distances(points: F64, row: int) -> F64:
    """Return the distances of all points to one of them."""
    distances: F64 = np.linalg.norm(points - points[row], axis=1)
    return distances


def _greedy_path(centres: F64) -> list[int]:
    """Return the rows of centres, from 0 on: each is followed by the nearest remaining one."""
    left = list(range(1, len(centres)))
    path = [0]
    while left:
        distances = _distances(centres, path[-1])
        path.append(left.pop(int(distances[left].argmin())))
    return path
