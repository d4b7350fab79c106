"""Close views: test views moved towards the surface that they show."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.geometry.frustum import ALPHA_MIN, NEAR
from cogsplat.codec.render.visible_depth import visible_depth
from cogsplat.codec.splats import Splats

from .low_discrepancy import STEPS_2D, sequence
from .occlusion import Occluders
from .subsample import subsample
from .view_sets import CLOSE_SHARE, CLOSE_VIEWS, sample_evenly

F64 = NDArray[np.float64]

# Splats of the subsample that blocks rays, and splats of the scene that it is drawn from: they
# bound memory and run time for scenes of any size.
_OCCLUDERS: Final = 20_000
_DRAWN_SPLATS: Final = 400_000
# Rays per view, through points of this central share of the picture. The first ray that meets a
# surface leads to what the view shows.
_RAYS: Final = 16
_CENTRAL_SHARE: Final = 0.3
# Length of the rays, in median depths of the view.
_RAY_DEPTHS: Final = 3.0
# Least distance of a close view, in near-plane distances. It zooms in for the rest of the way.
_NEAR_PLANES: Final = 4.0


@dataclass(frozen=True, eq=False)
class ViewDistance:
    """Distance of a view from the surface that it shows, and its close view.

    Parameters
    ----------
    camera : Camera
        The view.
    distance : float
        Distance from the camera to the surface near the centre of the picture, scene units; the
        median depth of the splats in the picture where no surface is met.
    close : ViewDistance or None
        Close view at 40 % of the distance, with the same rotation, its camera named ``NAME-close``;
        None where no surface is met, and for a close view itself.
    """

    camera: Camera
    distance: float
    close: ViewDistance | None = None


def view_distances(
    splats: Splats, cameras: Sequence[Camera], *, threads: int = 0
) -> list[ViewDistance]:
    """Measure the distance from each view to the surface that it shows, and make a close view.

    Parameters
    ----------
    splats : Splats
        Scene; splats that cannot be drawn are ignored.
    cameras : sequence of Camera
        Views in the frame of the means.
    threads : int
        Number of threads, 0 for all cores; the result does not depend on it.

    Returns
    -------
    list of ViewDistance
        In the order of the cameras; empty for a scene without drawable splats.

    Examples
    --------
    >>> from cogsplat.codec.views.close_views import close_views, view_distances
    >>> import cogsplat
    >>> splats = cogsplat.read("scene.ply")
    >>> found = view_distances(splats, cogsplat.read_cameras("cameras.json")[:1])
    >>> [view.camera.name for view in close_views(found)]
    ['view_00-close']
    """
    scene = _drawable_sample(splats)
    if not len(scene):
        return []
    occluders = Occluders(scene, threads)
    points = (sequence(np.arange(_RAYS), STEPS_2D) - 0.5) * _CENTRAL_SHARE
    points[0] = 0.0
    return [_view_distance(scene, occluders, camera, points) for camera in cameras]


def close_views(views: Sequence[ViewDistance]) -> list[ViewDistance]:
    """Return the close copies (`ViewDistance.close`) of at most `CLOSE_VIEWS` views.

    They are spread evenly over the views that have one.
    """
    return sample_evenly([view.close for view in views if view.close is not None], CLOSE_VIEWS)


def _drawable_sample(splats: Splats) -> Splats:
    """Return a subsample of the valid splats above the smallest drawn alpha, enlarged.

    The subsample covers the area of all these splats.
    """
    every = max(1, len(splats) // _DRAWN_SPLATS)
    rows = splats.with_sh_degree(0).without_extras().take(slice(0, None, every))
    drawn = ~rows.invalid_rows() & (rows.opacities > math.log(ALPHA_MIN / (1.0 - ALPHA_MIN)))
    if not drawn.any():
        return rows.take(slice(0, 0))
    thin = subsample(rows.take(drawn), _OCCLUDERS).splats
    return replace(thin, scales=thin.scales + np.float32(0.5 * math.log(every)))


def _view_distance(
    scene: Splats, occluders: Occluders, camera: Camera, points: F64
) -> ViewDistance:
    """Return the distance and the close view of a camera.

    Parameters
    ----------
    scene : Splats
        Splats that `occluders` holds.
    occluders : Occluders
        Surfaces that end the rays.
    camera : Camera
        View in the frame of the means.
    points : (n, 2) float64
        Points of the picture, as shares of its size from its centre.
    """
    depth = visible_depth(scene, camera)
    if not depth > 0.0:
        return ViewDistance(camera, depth)
    offsets = np.empty((len(points), 3))
    offsets[:, 0] = ((0.5 + points[:, 0]) * camera.width - camera.cx) / camera.fx
    offsets[:, 1] = ((0.5 + points[:, 1]) * camera.height - camera.cy) / camera.fy
    offsets[:, 2] = 1.0
    stretch = np.linalg.norm(offsets, axis=1)
    directions = np.ascontiguousarray(offsets / stretch[:, None] @ camera.rotation)
    position = -camera.rotation.T @ camera.translation
    origins = np.ascontiguousarray(np.broadcast_to(position, directions.shape))
    lengths = _RAY_DEPTHS * depth * stretch
    free = occluders.free_lengths(origins, directions, lengths, NEAR * stretch)
    met = np.flatnonzero((free < lengths) & (free > 0.0))
    if not len(met):
        return ViewDistance(camera, depth)
    ray = int(met[0])
    distance = float(free[ray])
    near = min(max(CLOSE_SHARE * distance, _NEAR_PLANES * NEAR), distance)
    zoom = near / (CLOSE_SHARE * distance)
    moved = position + (distance - near) * directions[ray]
    close = replace(
        camera,
        fx=camera.fx * zoom,
        fy=camera.fy * zoom,
        translation=-camera.rotation @ moved,
        name=f"{camera.name}-close",
    )
    # A zoomed picture shows the surface as large as one from the close view's full way.
    return ViewDistance(camera, distance, ViewDistance(close, CLOSE_SHARE * distance))
