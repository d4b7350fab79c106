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
from cogsplat.codec.render.peak_weights import peak_weights
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import one_blas_thread

from .first_look import FirstLook
from .pose import down_direction
from .subsample import Subsample, subsample
from .up_direction import up_from_cameras, up_from_splats
from .view_sets import sample_evenly
from .view_text import level_rotation, parse_view, unit_up

F64 = NDArray[np.float64]

# Splats that are read from the scene, at even steps, and splats of the subsample that is drawn.
_READ_SPLATS: Final = 60_000
_DRAWN_SPLATS: Final = 6_000

# Core box: the quartiles of each axis, widened by so many times their distance, hold what is no
# sky; of that, this share at each end is left out as floaters.
_FENCE: Final = 3.0
_STRAY_SHARE: Final = 0.005

# Decimals of an estimated up direction.
_UP_DECIMALS: Final = 6

# Given cameras that are tried as first views at most.
_TRIED_CAMERAS: Final = 24
# Longer side of a tried picture, px.
_TRIED_PX: Final = 64
# Peak weight from which on a splat counts as clearly seen.
_CLEAR: Final = 0.3
# A splat that reaches further than this share of the picture is out of focus to a viewer: too near.
_LARGE_SHARE: Final = 0.25
# Factor of a view that such splats fill, and of one whose distance or pitch is three times as far
# from the cameras' median as is usual.
_BLURRED_FACTOR: Final = 0.2

# The middle of the picture: this share of its width and height.
_MIDDLE: Final = 0.3


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
    elif scene is not None and cameras:
        first = _best_camera(scene, cameras, found_up)
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
    weights = scene.counts / (1.0 + np.exp(-np.clip(scene.splats.opacities, -30.0, 30.0)))
    inside = np.ones(len(means), np.bool_)
    for axis in range(3):
        low, high = _quantiles(means[:, axis], weights, (0.25, 0.75))
        reach = _FENCE * (high - low)
        inside &= (means[:, axis] >= low - reach) & (means[:, axis] <= high + reach)
    if not inside.any():
        inside[:] = True
    shares = (_STRAY_SHARE, 1.0 - _STRAY_SHARE)
    ends = [_quantiles(means[inside, axis], weights[inside], shares) for axis in range(3)]
    return np.array([low for low, _ in ends] + [high for _, high in ends])


def _best_camera(scene: Subsample, cameras: Sequence[Camera], up: F64) -> Camera:
    """Return the given camera, levelled, that shows most of what the cameras look at."""
    tried = [level(camera, up) for camera in sample_evenly(cameras, _TRIED_CAMERAS)]
    pictures = [_Picture.of(scene, camera) for camera in tried]
    looks = np.zeros(len(scene))
    for picture in pictures:
        looks[picture.index] += picture.clear
    weights = scene.counts * looks
    distances = np.array([picture.middle_depth for picture in pictures])
    pitches = np.array([float(camera.rotation[2] @ up) for camera in tried])
    scores = [
        float(weights[picture.index] @ picture.clear) * picture.sharpness for picture in pictures
    ]
    usual = _likeness(np.log(distances)) * _likeness(pitches)
    best = int(np.argmax(np.array(scores) * usual))
    return _with_target(tried[best], distances[best])


def _likeness(values: F64) -> F64:
    """Return a factor for each value, 1 at their median and less far from it."""
    offsets = np.abs(values - np.median(values))
    spread = 1.5 * float(np.median(offsets)) + 1e-9
    likeness: F64 = 1.0 / (1.0 + np.square(offsets / (3.0 * spread)))
    return likeness


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
    return _with_target(camera, _Picture.of(scene, camera).middle_depth)


def _with_target(camera: Camera, depth: float) -> Camera:
    """Return a camera with a target in the middle of its picture."""
    return replace(camera, target=camera.position + depth * camera.rotation[2])


@dataclass(frozen=True, eq=False)
class _Picture:
    """What a small picture of a camera shows.

    Parameters
    ----------
    index : (n,) int32
        Rows of the subsample in the picture.
    clear : (n,) float64
        How clearly each is seen, 0 to 1.
    sharpness : float
        1 for a picture of small splats, less where large near splats fill it.
    middle_depth : float
        Median depth of what the middle of the picture shows, scene units.
    """

    index: NDArray[np.int32]
    clear: F64
    sharpness: float
    middle_depth: float

    @classmethod
    def of(cls, scene: Subsample, camera: Camera) -> _Picture:
        """Draw a small picture of a subsample."""
        small = _shrunk(camera)
        index, peaks = peak_weights(scene.splats, small, NEAR)
        clear = np.minimum(1.0, peaks.astype(np.float64) / _CLEAR)
        means = scene.splats.means[index].astype(np.float64)
        seen = means @ small.rotation.T + small.translation
        depths = np.maximum(seen[:, 2], NEAR)
        radii = scene.sizes[index] * small.fy / depths
        areas = np.pi * np.square(radii) * peaks
        large = 2.0 * radii > _LARGE_SHARE * max(small.width, small.height)
        filled = float(np.sum(areas, where=large)) / (small.width * small.height)
        sharpness = 1.0 - (1.0 - _BLURRED_FACTOR) * min(1.0, filled)
        offsets = np.abs(seen[:, :2]) * [small.fx, small.fy] / depths[:, None]
        middle = (offsets < 0.5 * _MIDDLE * np.array([small.width, small.height])).all(axis=1)
        weights = peaks.astype(np.float64) * np.minimum(1.0, areas)
        if not weights[middle].any():
            middle = np.ones(len(index), np.bool_)
        depth = 1.0
        if weights[middle].any():
            (depth,) = _quantiles(depths[middle], weights[middle], (0.5,))
        return cls(index, clear, sharpness, depth)


def _shrunk(camera: Camera) -> Camera:
    """Return a camera with a small picture of the same view."""
    scale = _TRIED_PX / max(camera.width, camera.height)
    width, height = max(1, round(camera.width * scale)), max(1, round(camera.height * scale))
    across, down = width / camera.width, height / camera.height
    return replace(
        camera, width=width, height=height, fx=camera.fx * across, fy=camera.fy * down,
        cx=camera.cx * across, cy=camera.cy * down,
    )  # fmt: skip


def _quantiles(values: F64, weights: F64, shares: Sequence[float]) -> list[float]:
    """Return the smallest values with these shares of the weights up to them."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    rows = [
        min(int(np.searchsorted(total, share * total[-1])), len(values) - 1) for share in shares
    ]
    return [float(values[order[row]]) for row in rows]
