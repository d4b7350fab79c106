"""Clusters of cameras with similar positions and viewing directions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.farthest_first import farthest_first
from cogsplat.codec.geometry.unit_ball import into_unit_ball

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


def view_clusters(cameras: Sequence[Camera], means: NDArray[np.floating], count: int) -> list[I64]:
    """Cluster cameras by position and viewing direction.

    The distance between two cameras is √(d² + 1 - cos α): d is the distance between their positions
    in the unit ball around the scene (`into_unit_ball`), and α is the angle between their viewing
    directions.

    Parameters
    ----------
    cameras : sequence of Camera
        Cameras to cluster, at least one.
    means : (m, 3)
        Finite centres of splats, at least one, scene units; a random sample is enough.
    count : int
        Largest number of clusters, at least 1; there are fewer only if there are fewer cameras.

    Returns
    -------
    list of (k,) int64
        Rows of each cluster's cameras, ascending, at least one. The first cluster contains the
        first camera. Each cluster is followed by the nearest of those left, so that neighbours in
        the list are alike and compress well.

    Notes
    -----
    Some cameras become the middles of clusters: the first camera, then each time the one farthest
    from all middles (`farthest_first`). Every other camera joins the nearest middle; of equally
    near middles, the one chosen first.

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
    points = np.hstack([into_unit_ball(positions, means), forward / np.sqrt(2.0)])
    middles = farthest_first(points, count)
    distances = np.stack([_distances(points, middle) for middle in middles])
    # Equal cameras may all be middles: each stays with itself.
    distances[np.arange(len(middles)), middles] = -1.0
    owners = distances.argmin(axis=0)
    path = _greedy_path(points[middles])
    return [np.flatnonzero(owners == cluster) for cluster in path]


def _distances(points: F64, row: int) -> F64:
    """Return the distance of each point from the point in a row."""
    distances: F64 = np.linalg.norm(points - points[row], axis=1)
    return distances


def _greedy_path(points: F64) -> list[int]:
    """Return the rows of points as a path: from row 0 always to the nearest point that is left."""
    left = list(range(1, len(points)))
    path = [0]
    while left:
        distances = _distances(points, path[-1])
        path.append(left.pop(int(distances[left].argmin())))
    return path
