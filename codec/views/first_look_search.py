"""Search for the first look of a scene: up direction, first view, core box."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.farthest_first import farthest_first
from cogsplat.codec.geometry.frustum import ALPHA_MIN, NEAR
from cogsplat.codec.geometry.rotations import normalise_extremes
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import one_blas_thread
from cogsplat.codec.trained_arrays import opacities_from_logits

from .first_look import FirstLook
from .framed_views import BELOW, around, fitting_axes, inside, places_inside
from .occlusion import Occluders
from .pose import down_direction, front_direction, level_axes
from .small_picture import SmallPicture, weighted_quantiles
from .subsample import Subsample, subsample
from .up_direction import up_from_cameras, up_from_splats
from .view_sets import sample_evenly
from .view_text import level_rotation, parse_view, unit_up

F64 = NDArray[np.float64]

# Splats read from the scene at most, at even steps, and splats of the subsample at most.
_READ_SPLATS: Final = 60_000
_DRAWN_SPLATS: Final = 6_000

# Margin around the quartiles of the means, in largest interquartile ranges; splats further out are
# sky.
_SKY_MARGIN: Final = 5.0
# Share of the opacity at each end of an axis that is cut off as floaters.
_STRAY_SHARE: Final = 0.005

# Decimals of an estimated up direction.
_UP_DECIMALS: Final = 6

# Cameras of the capture that are tried as first views at most.
_TRIED_CAMERAS: Final = 24
# Aspect ratios, width by height, of a screen and of an upright phone.
_FRAMES: Final = (16.0 / 9.0, 9.0 / 19.5)

# Margin around the quartiles of the points that bounds a scene's bulk, in largest interquartile
# ranges.
_BULK_MARGIN: Final = 0.35
# Sectors around a place, sectors with points from which on the scene surrounds it, and points that
# such a sector has at least.
_SECTORS, _SURROUNDED = 12, 10
_LEAST_IN_SECTOR: Final = 2
# Opacity from which on a splat in the core box has to be in the picture of the whole scene.
_OPAQUE: Final = 0.1
# Preferred elevation of a view around a scene and width of the Gaussian around it, degrees.
_USUAL_ELEVATION: Final = 18.0
_ELEVATION_SPREAD: Final = 40.0
# Weights of the front side, of brightness and of contrast in the score of a view.
_FRONT: Final = 0.05
_LIGHT: Final = 0.1
_CONTRAST: Final = 0.4
# Contents: splats that only views from inside show, in other cells than the splats that views from
# outside show. The inner side of a wall is no contents.
# Share of contents in the view from the median place above which a scene is shown from inside:
# 0.13 in a house, 0.05 in a hollow bus.
_LEAST_CONTENTS: Final = 0.06
# Least width of a scene with rooms, as a share of its length.
_LEAST_WIDTH: Final = 0.2
# Visibility from which on a splat counts as seen.
_SEEN: Final = 0.3
# Visibility of unseen splats, so that no sum is 0.
_UNSEEN: Final = 1e-9
# Length of a cell, as a share of the scene's diagonal, and cells along the diagonal.
_CELL: Final = 0.02
_CELLS_ACROSS: Final = 51
# Radius around a free place that is kept clear, as a share of the scene's diagonal and of its
# height; the smaller of both.
_CLEARANCE: Final = 0.06
_HEADROOM: Final = 0.25
# Share of the directions that splats within this radius block at a free place at most.
_FREE: Final = 0.1
# Directions tested at each place, and the share of them that is blocked in a room: all but one of
# 64. In a jar with an opening fewer are blocked.
_DIRECTIONS: Final = 64
_ENCLOSED: Final = 0.98
# Free places tried at most, headings at each, and half the angle of a view, radians.
_TRIED_PLACES: Final = 9
_HEADINGS: Final = 12
_HALF_VIEW: Final = math.radians(37.0)


@one_blas_thread()
def find_first_look(
    splats: Splats,
    cameras: Sequence[Camera] | None = None,
    *,
    up: str | ArrayLike | None = None,
    view: str | Camera | None = None,
    threads: int = 0,
) -> FirstLook:
    """Return the first look of a scene: up direction, first view and core box.

    Parameters
    ----------
    splats : Splats
        Scene; splats that cannot be drawn are ignored.
    cameras : sequence of Camera, optional
        Cameras of the capture. The first view is one of these cameras, levelled.
    up : str or array-like of 3 float, optional
        Direction against gravity, or its text; None: estimated.
    view : str or Camera, optional
        First view, or its text; None: searched for.
    threads : int
        Number of threads; 0 for every core this process may use. The result does not depend on it.

    Raises
    ------
    DataError
        ``bad-view-text``.

    Examples
    --------
    >>> import cogsplat
    >>> from cogsplat.codec.views.first_look_search import find_first_look
    >>> look = find_first_look(cogsplat.read("scene.ply"), up="-y")
    >>> look.up.tolist()
    [0.0, -1.0, 0.0]
    """
    usual = -down_direction(splats.info.axes)
    scene = _drawable_subsample(splats)
    core = None if scene is None else _core_box(scene)
    if up is not None:
        found_up = unit_up(up)
    elif cameras:
        found_up = up_from_cameras(cameras, usual)
    elif scene is not None and core is not None:
        found_up = up_from_splats(scene, core, usual)
    else:
        found_up = usual
    if up is None:
        # Rounded, so that the last bits of sums do not reach the file.
        found_up = np.round(found_up, _UP_DECIMALS) + 0.0
    first = None
    if isinstance(view, str):
        first = parse_view(view).camera(found_up)
    elif view is not None:
        first = view if scene is None or view.target is not None else _aim(scene, view)
    elif scene is not None and core is not None:
        if cameras:
            first = _best_camera(scene, cameras, found_up)
        else:
            first = _best_view(scene, core, found_up, front_direction(splats.info.axes))
    return FirstLook(found_up, first, core)


def _drawable_subsample(splats: Splats) -> Subsample | None:
    """Return a subsample of the splats that can be drawn; None if no splat can."""
    step = max(1, math.ceil(len(splats) / _READ_SPLATS))
    part = splats.with_sh_degree(0).take(slice(0, None, step))
    usable = ~part.invalid_rows()
    usable &= part.opacities > math.log(ALPHA_MIN / (1.0 - ALPHA_MIN))
    if not usable.any():
        return None
    return subsample(normalise_extremes(part.take(usable)), _DRAWN_SPLATS)


def _core_box(scene: Subsample) -> F64:
    """Return the bounding box of a scene without sky and floaters, (6,)."""
    means = scene.splats.means.astype(np.float64)
    weights = scene.counts * opacities_from_logits(scene.splats.opacities)
    quartiles = [weighted_quantiles(means[:, axis], weights, (0.25, 0.75)) for axis in range(3)]
    low, high = np.array(quartiles).T
    # One margin for all axes: objects on a flat ground belong to the scene.
    reach = _SKY_MARGIN * float((high - low).max())
    inside = ((means >= low - reach) & (means <= high + reach)).all(axis=1)
    shares = (_STRAY_SHARE, 1.0 - _STRAY_SHARE)
    ends = [weighted_quantiles(means[inside, axis], weights[inside], shares) for axis in range(3)]
    return np.array([low for low, _ in ends] + [high for _, high in ends])


def _best_camera(scene: Subsample, cameras: Sequence[Camera], up: F64) -> Camera:
    """Return the camera that shows most of the splats that the cameras share, without roll."""
    tried = [_level(camera, up) for camera in sample_evenly(cameras, _TRIED_CAMERAS)]
    pictures = [SmallPicture.draw(scene, camera) for camera in tried]
    sharpness = [_sharpness_in_frames(scene, camera) for camera in tried]
    looks = np.zeros(len(scene))
    for picture in pictures:
        looks[picture.index] += picture.visibility
    weights = scene.counts * looks
    distances = np.array([picture.middle_depth for picture in pictures])
    pitches = np.array([float(camera.rotation[2] @ up) for camera in tried])
    scores = [
        float(weights[picture.index] @ picture.visibility) * sharp
        for picture, sharp in zip(pictures, sharpness, strict=True)
    ]
    usual = _typicality(np.log(distances)) * _typicality(pitches)
    best = int(np.argmax(np.array(scores) * usual))
    return _with_target(tried[best], distances[best])


def _best_view(scene: Subsample, core: F64, up: F64, front: F64) -> Camera | None:
    """Return the best-scored view around or inside a scene; None if the scene has no view."""
    points = _points_to_hold(scene, core)
    if not len(points):
        return None
    weights = scene.counts * opacities_from_logits(scene.splats.opacities.astype(np.float64))
    outside = _views_around(scene, points, up, front)
    inside, visibilities = _views_inside(scene, points, weights, up)
    from_outside = np.zeros(len(scene))
    for view in outside:
        view.picture.raise_visibility(from_outside)
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    for camera in around(points, centre, up, front, 2.0 * NEAR, BELOW):
        SmallPicture.draw(scene, camera).raise_visibility(from_outside)
    walls = _share_cells_with_seen(scene, from_outside, points)
    contents = [
        float((weights * ~walls) @ np.maximum(seen - from_outside, 0.0) / (weights @ seen))
        for seen in visibilities
    ]
    views = outside
    if contents and float(np.median(contents)) > _LEAST_CONTENTS:
        views = inside + [view for view in outside if view.is_within]
    if not views:
        return None
    shares = [float(weights[view.picture.index] @ view.picture.resolved) for view in views]
    preferences = [view.preference * view.picture.sharpness for view in views]
    light = _excess(np.array([view.picture.light for view in views]))
    contrast = _excess(np.array([view.picture.contrast for view in views]))
    scores = np.sqrt(shares) * preferences * (1.0 + _LIGHT * light) * (1.0 + _CONTRAST * contrast)
    best = views[int(scores.argmax())]
    if best.camera.target is not None:
        return best.camera
    return _with_target(best.camera, best.picture.middle_depth)


@dataclass(frozen=True, eq=False)
class _Candidate:
    """A candidate for the first view.

    Parameters
    ----------
    camera : Camera
        Camera of the view.
    picture : SmallPicture
        Small picture of the view.
    preference : float
        Factor on the score, for the elevation and the side of the view.
    is_within : bool
        Whether the scene surrounds the camera.
    """

    camera: Camera
    picture: SmallPicture
    preference: float
    is_within: bool = True


def _points_to_hold(scene: Subsample, core: F64) -> F64:
    """Return the means that a view of the whole scene holds: of opaque splats in the core box."""
    means = scene.splats.means.astype(np.float64)
    inside = ((means >= core[:3]) & (means <= core[3:])).all(axis=1)
    opaque = inside & (opacities_from_logits(scene.splats.opacities.astype(np.float64)) >= _OPAQUE)
    return means[opaque if opaque.any() else inside]


def _views_around(scene: Subsample, points: F64, up: F64, front: F64) -> list[_Candidate]:
    """Return views of the whole scene and of its bulk, from all sides.

    Views of the bulk are left out unless the scene surrounds the camera.
    """
    low, high = np.quantile(points, (0.25, 0.75), axis=0)
    reach = _BULK_MARGIN * float((high - low).max())
    bulk = points[((points >= low - reach) & (points <= high + reach)).all(axis=1)]
    found = []
    for held in (points, bulk):
        if not len(held):
            continue
        centre = 0.5 * (held.min(axis=0) + held.max(axis=0))
        for camera in around(held, centre, up, front, 2.0 * NEAR):
            is_within = held is bulk and _is_surrounded(points, camera.position, up)
            if held is bulk and not is_within:
                # Seen from outside, the scene is an object: only views of the whole count.
                continue
            elevation = math.degrees(
                math.asin(min(1.0, max(-1.0, -float(camera.rotation[2] @ up))))
            )
            preference = math.exp(-(((elevation - _USUAL_ELEVATION) / _ELEVATION_SPREAD) ** 2))
            preference *= 1.0 + _FRONT * float(camera.rotation[2] @ front)
            found.append(
                _Candidate(camera, SmallPicture.draw(scene, camera), preference, is_within)
            )
    return found


def _share_cells_with_seen(scene: Subsample, visibility: F64, points: F64) -> NDArray[np.bool_]:
    """Return whether each splat shares a cell of space with a splat that is seen."""
    low = points.min(axis=0)
    cell = _CELL * float(np.linalg.norm(points.max(axis=0) - low)) or 1.0
    cells = np.clip((scene.splats.means - low) / cell, 0, _CELLS_ACROSS - 1).astype(np.int64)
    number = (cells[:, 0] * _CELLS_ACROSS + cells[:, 1]) * _CELLS_ACROSS + cells[:, 2]
    return np.isin(number, np.unique(number[visibility >= _SEEN]))


def _is_surrounded(points: F64, place: F64, up: F64) -> bool:
    """Return whether points lie in at least 10 of 12 sectors around a place."""
    flat = (points - place) @ np.stack(level_axes(up), axis=1)
    turns = 0.5 * (np.arctan2(flat[:, 1], flat[:, 0]) / math.pi + 1.0)
    sectors = np.minimum((turns * _SECTORS).astype(np.int64), _SECTORS - 1)
    counts = np.bincount(sectors, minlength=_SECTORS)
    return int((counts >= _LEAST_IN_SECTOR).sum()) >= _SURROUNDED


def _views_inside(
    scene: Subsample, points: F64, weights: F64, up: F64
) -> tuple[list[_Candidate], list[F64]]:
    """Return the best view from each place tried inside rooms, and the splats seen from it.

    Returns
    -------
    views : list of _Candidate
        Best view from each place; empty for a scene without rooms.
    visibilities : list of (n,) float64
        Visibility of each splat of the scene from each place, over all headings.
    """
    axes = fitting_axes(points, up)
    extents = np.sort(np.ptp(points @ axes.T, axis=0))
    if extents[1] < _LEAST_WIDTH * extents[2]:
        return [], []
    places = places_inside(points, axes)
    size = float(np.linalg.norm(points.max(axis=0) - points.min(axis=0)))
    occluders = Occluders(scene.splats)
    reach = min(_CLEARANCE * size, _HEADROOM * float(np.ptp(points @ up)))
    blocked = occluders.occlusion(places, np.full(len(places), reach))
    free = places[blocked <= _FREE]
    far = occluders.occlusion(free, np.full(len(free), np.inf), _DIRECTIONS)
    enclosed = far >= _ENCLOSED
    free = free[enclosed] if 2 * int(enclosed.sum()) >= len(enclosed) else free[:0]
    side, other = level_axes(up)
    found: list[_Candidate] = []
    visibilities: list[F64] = []
    for place in free[farthest_first(free, _TRIED_PLACES)]:
        looks = np.zeros(_HEADINGS)
        visibilities.append(np.full(len(scene), _UNSEEN))
        for quarter in range(4):
            camera = inside(place, 0.5 * math.pi * quarter, up)
            picture = SmallPicture.draw(scene, camera, wide=True)
            picture.raise_visibility(visibilities[-1])
            offsets = scene.splats.means[picture.index].astype(np.float64) - place
            angles = np.arctan2(offsets @ other, offsets @ side)
            shown = weights[picture.index] * picture.visibility
            for heading in range(_HEADINGS):
                turned = np.abs(angles - 2.0 * math.pi * heading / _HEADINGS)
                turned = np.minimum(turned, 2.0 * math.pi - turned)
                looks[heading] += float(np.sum(shown, where=np.abs(turned) < _HALF_VIEW))
        camera = inside(place, 2.0 * math.pi * int(looks.argmax()) / _HEADINGS, up)
        found.append(_Candidate(camera, SmallPicture.draw(scene, camera), 1.0))
    return found, visibilities


def _excess(values: F64) -> F64:
    """Return the excess of each value over the median, relative to it, clipped to -1 to 1."""
    excess: F64 = np.clip(values / max(float(np.median(values)), 1e-9) - 1.0, -1.0, 1.0)
    return excess


def _typicality(values: F64) -> F64:
    """Return a factor for each value: 1 at the median, falling with the distance from it."""
    offsets = np.abs(values - np.median(values))
    spread = 1.5 * float(np.median(offsets)) + 1e-9
    typicality: F64 = 1.0 / (1.0 + np.square(offsets / (3.0 * spread)))
    return typicality


def _sharpness_in_frames(scene: Subsample, camera: Camera) -> float:
    """Return the geometric mean of a view's sharpness in a wide and in an upright frame."""
    product = 1.0
    for aspect in _FRAMES:
        width = max(camera.width, round(camera.height * aspect))
        height = max(camera.height, round(camera.width / aspect))
        seen = replace(camera, width=width, height=height, cx=0.5 * width, cy=0.5 * height)
        product *= SmallPicture.draw(scene, seen).sharpness
    return math.sqrt(product)


def _level(camera: Camera, up: F64) -> Camera:
    """Return a camera without roll, its principal point in the middle of the picture.

    Width and height are swapped if the camera was rolled by more than 45 degrees.
    """
    rotation = level_rotation(camera.rotation[2], up)
    position = camera.position
    width, height, fx, fy = camera.width, camera.height, camera.fx, camera.fy
    if abs(float(camera.rotation[0] @ rotation[0])) < abs(float(camera.rotation[0] @ rotation[1])):
        width, height, fx, fy = height, width, fy, fx
    return Camera(
        width, height, fx, fy, 0.5 * width, 0.5 * height,
        rotation, -rotation @ position, camera.name,
    )  # fmt: skip


def _aim(scene: Subsample, camera: Camera) -> Camera:
    """Return a camera with a target at the depth that the middle of its picture shows."""
    return _with_target(camera, SmallPicture.draw(scene, camera).middle_depth)


def _with_target(camera: Camera, depth: float) -> Camera:
    """Return a camera with a target in the middle of its picture."""
    return replace(camera, target=camera.position + depth * camera.rotation[2])
