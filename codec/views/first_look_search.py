"""Search for the first look of a scene: up direction, first view, core box."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cogsplat.codec.cameras import Camera
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

# Splats that are read from the scene, at even steps, and splats of the subsample that is drawn.
_READ_SPLATS: Final = 60_000
_DRAWN_SPLATS: Final = 6_000

# Core box: the quartiles of each axis, widened by so many times their largest distance, hold what
# is no sky; of that, this share at each end is left out as floaters.
_FENCE: Final = 5.0
_STRAY_SHARE: Final = 0.005

# Decimals of an estimated up direction.
_UP_DECIMALS: Final = 6

# Given cameras that are tried as first views at most.
_TRIED_CAMERAS: Final = 24
# Width by height of the frames of a screen and of a telephone.
_FRAMES: Final = (16.0 / 9.0, 9.0 / 19.5)

# The bulk of a scene: the quartiles of each axis, widened by so many times their largest distance.
_BULK_REACH: Final = 0.35
# A scene surrounds a place where so many of its sides have at least so many points.
_SIDES, _SURROUNDED = 12, 10
_LEAST_ON_SIDE: Final = 2
# Opacity from which on a splat in the core box has to be in the picture of the whole scene.
_OPAQUE: Final = 0.1
# Usual elevation of a view around a scene, degrees, and how far others may be from it; how much the
# side counts that the axes call the front; how much light and contrast count.
_USUAL_ELEVATION: Final = 18.0
_ELEVATION_SPREAD: Final = 40.0
_FRONT: Final = 0.05
_LIGHT: Final = 0.1
_CONTRAST: Final = 0.4
# Contents are what only views from inside show, further than a cell from what others show: the
# inner side of a wall is none. A scene is shown from inside where, in the median place, contents
# are more than this share of what is shown: 0.13 in a house, 0.05 in a hollow bus.
_LEAST_CONTENTS: Final = 0.06
# Least width of a scene with rooms, as a share of its length.
_LEAST_WIDTH: Final = 0.2
# Clearness from which on a splat counts as shown.
_CLEAR: Final = 0.3
# Clearness of what is not seen, so that no sum is 0.
_UNSEEN: Final = 1e-9
# Length of a cell, as a share of the scene's diagonal, and cells along the diagonal.
_CELL: Final = 0.02
_CELLS_ACROSS: Final = 51
# A place is free where splats within this share of the scene's size, or of its height, block at
# most this share of the directions.
_CLEARANCE: Final = 0.06
_HEADROOM: Final = 0.25
_FREE: Final = 0.1
# Directions in which a place is tested, and the share of them that are blocked in a room: all but
# one of 64. A jar with an opening has less.
_DIRECTIONS: Final = 64
_ENCLOSED: Final = 0.98
# Free places that are tried at most, headings at each, and half the angle of a view, radians.
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
    """Return how a viewer should first show a scene.

    Parameters
    ----------
    splats : Splats
        Scene; splats that cannot be drawn are ignored.
    cameras : sequence of Camera, optional
        Cameras of the capture. The first view is one of them, levelled.
    up : str or array-like of 3 float, optional
        Direction against gravity or its text; None estimates it.
    view : str or Camera, optional
        First view or its text; None chooses one.
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
    scene = _thin(splats)
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


def _thin(splats: Splats) -> Subsample | None:
    """Return a subsample of the splats that can be drawn; None if there are none."""
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
    # One reach for all axes: what stands on a flat ground belongs to the scene.
    reach = _FENCE * float((high - low).max())
    inside = ((means >= low - reach) & (means <= high + reach)).all(axis=1)
    shares = (_STRAY_SHARE, 1.0 - _STRAY_SHARE)
    ends = [weighted_quantiles(means[inside, axis], weights[inside], shares) for axis in range(3)]
    return np.array([low for low, _ in ends] + [high for _, high in ends])


def _best_camera(scene: Subsample, cameras: Sequence[Camera], up: F64) -> Camera:
    """Return the given camera, levelled, that shows most of what the cameras look at."""
    tried = [level(camera, up) for camera in sample_evenly(cameras, _TRIED_CAMERAS)]
    pictures = [SmallPicture.draw(scene, camera) for camera in tried]
    sharpness = [_sharpness_in_frames(scene, camera) for camera in tried]
    looks = np.zeros(len(scene))
    for picture in pictures:
        looks[picture.index] += picture.clear
    weights = scene.counts * looks
    distances = np.array([picture.middle_depth for picture in pictures])
    pitches = np.array([float(camera.rotation[2] @ up) for camera in tried])
    scores = [
        float(weights[picture.index] @ picture.clear) * sharp
        for picture, sharp in zip(pictures, sharpness, strict=True)
    ]
    usual = _likeness(np.log(distances)) * _likeness(pitches)
    best = int(np.argmax(np.array(scores) * usual))
    return _with_target(tried[best], distances[best])


def _best_view(scene: Subsample, core: F64, up: F64, front: F64) -> Camera | None:
    """Return the view around or inside a scene that shows most of it; None where none shows any."""
    points = _points_to_hold(scene, core)
    if not len(points):
        return None
    weights = scene.counts * opacities_from_logits(scene.splats.opacities.astype(np.float64))
    outside = _views_around(scene, points, up, front)
    inside, panoramas = _views_inside(scene, points, weights, up)
    from_outside = np.zeros(len(scene))
    for view in outside:
        view.picture.add_to(from_outside)
    centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
    for camera in around(points, centre, up, front, 2.0 * NEAR, BELOW):
        SmallPicture.draw(scene, camera).add_to(from_outside)
    walls = _near_shown(scene, from_outside, points)
    contents = [
        float((weights * ~walls) @ np.maximum(seen - from_outside, 0.0) / (weights @ seen))
        for seen in panoramas
    ]
    views = outside
    if contents and float(np.median(contents)) > _LEAST_CONTENTS:
        views = inside + [view for view in outside if view.is_within]
    if not views:
        return None
    shares = [float(weights[view.picture.index] @ view.picture.detail) for view in views]
    tastes = [view.taste * view.picture.sharpness for view in views]
    light = _merit(np.array([view.picture.light for view in views]))
    contrast = _merit(np.array([view.picture.contrast for view in views]))
    scores = np.sqrt(shares) * tastes * (1.0 + _LIGHT * light) * (1.0 + _CONTRAST * contrast)
    best = views[int(scores.argmax())]
    if best.camera.target is not None:
        return best.camera
    return _with_target(best.camera, best.picture.middle_depth)


@dataclass(frozen=True, eq=False)
class _Tried:
    """A view that is tried as the first one.

    Parameters
    ----------
    camera : Camera
    picture : SmallPicture
        What it shows.
    taste : float
        Factor for its elevation and side.
    is_within : bool
        Whether the scene surrounds the camera.
    """

    camera: Camera
    picture: SmallPicture
    taste: float
    is_within: bool = True


def _points_to_hold(scene: Subsample, core: F64) -> F64:
    """Return the points that a view of the whole scene holds: opaque splats in the core box."""
    means = scene.splats.means.astype(np.float64)
    inside = ((means >= core[:3]) & (means <= core[3:])).all(axis=1)
    opaque = inside & (opacities_from_logits(scene.splats.opacities.astype(np.float64)) >= _OPAQUE)
    return means[opaque if opaque.any() else inside]


def _views_around(scene: Subsample, points: F64, up: F64, front: F64) -> list[_Tried]:
    """Return views of the whole scene, and of its bulk, from all around."""
    low, high = np.quantile(points, (0.25, 0.75), axis=0)
    reach = _BULK_REACH * float((high - low).max())
    bulk = points[((points >= low - reach) & (points <= high + reach)).all(axis=1)]
    found = []
    for held in (points, bulk):
        if not len(held):
            continue
        centre = 0.5 * (held.min(axis=0) + held.max(axis=0))
        for camera in around(held, centre, up, front, 2.0 * NEAR):
            is_within = held is bulk and _surround(points, camera.position, up)
            if held is bulk and not is_within:
                # Who stands beside the scene sees an object, and gets the whole of it.
                continue
            elevation = math.degrees(
                math.asin(min(1.0, max(-1.0, -float(camera.rotation[2] @ up))))
            )
            taste = math.exp(-(((elevation - _USUAL_ELEVATION) / _ELEVATION_SPREAD) ** 2))
            taste *= 1.0 + _FRONT * float(camera.rotation[2] @ front)
            found.append(_Tried(camera, SmallPicture.draw(scene, camera), taste, is_within))
    return found


def _near_shown(scene: Subsample, clear: F64, points: F64) -> NDArray[np.bool_]:
    """Return whether splats lie where clearly seen splats do: in the same cells of space."""
    low = points.min(axis=0)
    cell = _CELL * float(np.linalg.norm(points.max(axis=0) - low)) or 1.0
    cells = np.clip((scene.splats.means - low) / cell, 0, _CELLS_ACROSS - 1).astype(np.int64)
    number = (cells[:, 0] * _CELLS_ACROSS + cells[:, 1]) * _CELLS_ACROSS + cells[:, 2]
    return np.isin(number, np.unique(number[clear >= _CLEAR]))


def _surround(points: F64, place: F64, up: F64) -> bool:
    """Return whether there are points on all sides of a place."""
    flat = (points - place) @ np.stack(level_axes(up), axis=1)
    sides = ((np.arctan2(flat[:, 1], flat[:, 0]) / math.pi + 1.0) * (0.5 * _SIDES)).astype(np.int64)
    counts = np.bincount(np.minimum(sides, _SIDES - 1), minlength=_SIDES)
    return int((counts >= _LEAST_ON_SIDE).sum()) >= _SURROUNDED


def _views_inside(
    scene: Subsample, points: F64, weights: F64, up: F64
) -> tuple[list[_Tried], list[F64]]:
    """Return the best view from each of some places in rooms, and how clear each shows all."""
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
    found: list[_Tried] = []
    panoramas: list[F64] = []
    for place in _spread(free, _TRIED_PLACES):
        looks = np.zeros(_HEADINGS)
        panoramas.append(np.full(len(scene), _UNSEEN))
        for quarter in range(4):
            camera = inside(place, 0.5 * math.pi * quarter, up)
            picture = SmallPicture.draw(scene, camera, wide=True)
            picture.add_to(panoramas[-1])
            offsets = scene.splats.means[picture.index].astype(np.float64) - place
            angles = np.arctan2(offsets @ other, offsets @ side)
            shown = weights[picture.index] * picture.clear
            for heading in range(_HEADINGS):
                turned = np.angle(np.exp(1j * (angles - 2.0 * math.pi * heading / _HEADINGS)))
                looks[heading] += float(np.sum(shown, where=np.abs(turned) < _HALF_VIEW))
        camera = inside(place, 2.0 * math.pi * int(looks.argmax()) / _HEADINGS, up)
        found.append(_Tried(camera, SmallPicture.draw(scene, camera), 1.0))
    return found, panoramas


def _spread(places: F64, count: int) -> F64:
    """Return some of the places, each far from those before it."""
    chosen: list[int] = []
    distances = np.full(len(places), np.inf)
    while len(chosen) < min(count, len(places)):
        chosen.append(int(distances.argmax()))
        offsets = np.linalg.norm(places - places[chosen[-1]], axis=1)
        distances = np.minimum(distances, offsets)
    return places[chosen]


def _merit(values: F64) -> F64:
    """Return how much larger each value is than their median, -1 to 1."""
    merit: F64 = np.clip(values / max(float(np.median(values)), 1e-9) - 1.0, -1.0, 1.0)
    return merit


def _likeness(values: F64) -> F64:
    """Return a factor for each value, 1 at their median and less far from it."""
    offsets = np.abs(values - np.median(values))
    spread = 1.5 * float(np.median(offsets)) + 1e-9
    likeness: F64 = 1.0 / (1.0 + np.square(offsets / (3.0 * spread)))
    return likeness


def _sharpness_in_frames(scene: Subsample, camera: Camera) -> float:
    """Return the sharpness of a camera's view in a wide and in an upright frame."""
    product = 1.0
    for aspect in _FRAMES:
        width = max(camera.width, round(camera.height * aspect))
        height = max(camera.height, round(camera.width / aspect))
        seen = replace(camera, width=width, height=height, cx=0.5 * width, cy=0.5 * height)
        product *= SmallPicture.draw(scene, seen).sharpness
    return math.sqrt(product)


def level(camera: Camera, up: F64) -> Camera:
    """Return a camera without roll, its principal point in the middle of the picture.

    Where the camera was held upright, width and height change places.
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
