"""Training views: the cameras that a scene is trained in, and the ground truth of each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.render.rasteriser import RenderConfig, render
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import ordered_map, thread_count
from cogsplat.codec.views.view_sets import jitter, sample_evenly

from .downscaling import downscale_picture

F32 = NDArray[np.float32]

MAX_PIXELS: Final = 1 << 18
"""Maximum number of pixels per picture; larger pictures are downscaled. Bounds memory."""
MAX_VIEWS: Final = 96
"""Maximum number of given cameras used for training. Bounds memory: views between cameras and
jittered copies are added to them."""

# Neighbours per camera that in-between views are interpolated with: from 2 for many cameras to 5
# for few. Measured on a captured room with 11,715 of its 80,796 splats, after 1,000 steps: 391
# views in place of 184 gained 0.07 dB in held-out views, and 0.17 dB in the worst of them.
_MIN_NEIGHBOURS, _MAX_NEIGHBOURS = 2, 5
# Number of in-between views, counted per end, that the neighbour count aims at.
_NEIGHBOUR_BUDGET: Final = 256

# Downscaling of covering views, per axis. They are close-ups that splats fill entirely, and losses
# are summed over pixels: at full size they would dominate.
_COVERING_FACTOR: Final = 2

Background = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class TrainingViews:
    """Cameras that a scene is trained in, with the ground-truth picture of each.

    Parameters
    ----------
    cameras : sequence of Camera
        Views in this order: given cameras, views between them, jittered copies of both, covering
        views.
    configs : sequence of RenderConfig
        Render settings of each view, on one thread.
    pictures : sequence of (H, W, 3) float32
        Ground truth of each view, 0 to 1, in the scene's colour space.
    num_given : int
        Number of given cameras.
    num_on_path : int
        Number of views on the capture path: given cameras and views between them.
    num_photos : int
        Number of views with a photo as ground truth, the first ones; all other views have a render
        of the source.
    """

    cameras: Sequence[Camera]
    configs: Sequence[RenderConfig]
    pictures: Sequence[F32]
    num_given: int
    num_on_path: int
    num_photos: int = 0

    def __len__(self) -> int:
        return len(self.cameras)


def _render_config(factor: int, background: Background, device: str) -> RenderConfig:
    """Return the render settings of a view whose picture is downscaled by `factor` per axis."""
    return RenderConfig(background=background, reduction=factor, threads=1, device=device)


def _downscaling_factor(camera: Camera, max_pixels: int) -> int:
    """Return the downscaling per axis that leaves at most `max_pixels` pixels."""
    factor = math.ceil(math.sqrt(camera.width * camera.height / max_pixels))
    return max(1, min(factor, camera.width, camera.height))


def _interpolated_cameras(cameras: Sequence[Camera]) -> list[Camera]:
    """Return a camera halfway between each camera and each of its nearest neighbours.

    Views from these cameras reduce overfitting. With few training views, training would hide
    quantisation errors in those views alone. Interpolated cameras stay near the capture path.
    """
    return [
        _interpolate(cameras[one], cameras[other]) for one, other in _neighbouring_cameras(cameras)
    ]


def _neighbouring_cameras(cameras: Sequence[Camera]) -> list[tuple[int, int]]:
    """Return index pairs of cameras with similar poses, the smaller index first."""
    positions = np.array([camera.position for camera in cameras])
    directions = np.array([camera.rotation[2] for camera in cameras])
    spread = float(np.linalg.norm(positions - positions.mean(axis=0), axis=1).mean())
    neighbours = _NEIGHBOUR_BUDGET // len(cameras)
    neighbours = min(max(neighbours, _MIN_NEIGHBOURS), _MAX_NEIGHBOURS)
    pairs = []
    for number in range(len(cameras)):
        distances = np.linalg.norm(positions - positions[number], axis=1)
        distances += spread * (1.0 - directions @ directions[number])
        distances[number] = np.inf
        for other in np.argsort(distances, kind="stable")[:neighbours].tolist():
            pair = min(number, other), max(number, other)
            if math.isfinite(distances[other]) and pair not in pairs:
                pairs.append(pair)
    return pairs


def _interpolate(camera: Camera, other: Camera) -> Camera:
    """Return a camera halfway between two poses, with the intrinsics of the first."""
    left, _, right = np.linalg.svd(camera.rotation + other.rotation)
    rotation = left @ np.diag([1.0, 1.0, float(np.linalg.det(left @ right))]) @ right
    position = (camera.position + other.position) / 2
    return replace(
        camera,
        rotation=rotation,
        translation=-rotation @ position,
        name=f"{camera.name}-{other.name}",
    )


def _render_clipped(view: tuple[Camera, RenderConfig], source: Splats) -> F32:
    """Return the render of a view, clipped to 0 to 1."""
    picture = render(source, *view)
    return np.clip(picture, np.float32(0.0), np.float32(1.0), out=picture)


def make_training_views(
    source: Splats,
    cameras: Sequence[Camera],
    *,
    photos: Sequence[F32] | None = None,
    copies: bool = True,
    covering: Sequence[Camera] = (),
    background: Background = (0.0, 0.0, 0.0),
    max_pixels: int = MAX_PIXELS,
    threads: int = 0,
    device: str = "cpu",
    progress: Progress = silent,
) -> TrainingViews:
    """Make the views that a scene is trained in; their ground truth is renders or photos.

    Parameters
    ----------
    source : Splats
        Scene that the ground truth is rendered from, with kernel and anti-aliasing of
        ``source.info``.
    cameras : sequence of Camera
        Cameras in the frame of the means. If there are more than `MAX_VIEWS`, evenly spread ones
        are used.
    photos : sequence of (H, W, 3) float32, optional
        Ground truth of `cameras`, 0 to 1, one photo per camera in its size. Renders of the source
        by default.
    copies : bool
        Whether to add views between cameras, and jittered copies that step back or turn
        (`view_sets.jitter`). Their ground truth is always a render.
    covering : sequence of Camera
        Views of regions that `cameras` hardly show (`planner.ViewPlan.covering_views`), so that
        training keeps these regions; used like jittered copies. Used like given cameras, they made
        a third of the views of one figure show its underside, and views around it lost 1 dB at the
        same size.
    background : tuple of float
        RGB behind the splats.
    max_pixels : int
        Maximum number of pixels per picture; larger pictures are downscaled by an integer factor.
    threads : int
        Number of threads; 0 uses all cores. The pictures do not depend on it.
    device : str
        Device of `RenderConfig` for the ground truth and for training.
    progress : Progress
        Receives the stage ``training views``, in views.

    Returns
    -------
    TrainingViews

    Raises
    ------
    DataError
        ``no-cameras``: `cameras` is empty.
    ValueError
        The number of photos differs from the number of cameras.

    Examples
    --------
    >>> from cogsplat.codec.fit.training_views import make_training_views
    >>> import cogsplat
    >>> splats = cogsplat.read("scene.ply")
    >>> cameras = cogsplat.read_cameras("cameras.json")[:2]
    >>> views = make_training_views(splats, cameras)
    >>> len(views), views.num_given, views.num_on_path, views.pictures[0].shape
    (8, 2, 3, (48, 64, 3))
    """
    if not cameras:
        raise DataError("no-cameras", "0 cameras to train in, expected at least 1")
    if photos is not None and len(photos) != len(cameras):
        raise ValueError(f"{len(photos)} photos for {len(cameras)} cameras")
    chosen = sample_evenly(range(len(cameras)), MAX_VIEWS)
    given = [cameras[number] for number in chosen]
    between, off_path = [], []
    if copies:
        between = _interpolated_cameras(given)
        off_path = [*jitter(source, given), *jitter(source, between, 1)]
    off_path += covering
    views = [*given, *between, *off_path]
    factors = [_downscaling_factor(camera, max_pixels) for camera in views]
    for number in range(len(views) - len(covering), len(views)):
        factors[number] *= min(_COVERING_FACTOR, views[number].width, views[number].height)
    small = [view.downscaled(factor) for view, factor in zip(views, factors, strict=True)]
    configs = [_render_config(factor, background, device) for factor in factors]
    chosen_photos = [] if photos is None else [photos[number] for number in chosen]
    pictures = [downscale_picture(*pair) for pair in zip(chosen_photos, factors, strict=False)]
    to_render = list(zip(small, configs, strict=True))[len(pictures) :]
    progress("training views", 0, len(views))
    renders = ordered_map(partial(_render_clipped, source=source), to_render, thread_count(threads))
    for picture in renders:
        pictures.append(picture)
        progress("training views", len(pictures), len(views))
    on_path = len(given) + len(between)
    return TrainingViews(small, configs, pictures, len(given), on_path, len(chosen_photos))
