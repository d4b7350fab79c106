"""TrainingViews: the views that a scene is trained in, and what it should look like there."""

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
from cogsplat.codec.splats import SceneInfo, Splats
from cogsplat.codec.threads import ordered_map, thread_count
from cogsplat.codec.views.view_sets import jitter, sample_evenly

from .downscaling import downscale_camera, downscale_picture

F32 = NDArray[np.float32]

MAX_PIXELS: Final = 1 << 18
"""Most pixels of one picture; larger ones are made smaller. Bounds memory, as `MAX_VIEWS` does."""
MAX_VIEWS: Final = 96
"""Most views of those given; each has two copies beside it, and views between it and others."""

# Cameras that look most alike, halfway to which a view is put: from 2 where there are as many
# cameras as may be to 5 where there are few. Of a captured room with 11,715 of its 80,796 splats,
# 391 views in place of 184 brought 0.07 dB in other views after 1,000 steps, 0.17 in the worst.
_FEWEST_NEIGHBOURS, _MOST_NEIGHBOURS = 2, 5
_NEIGHBOURS_IN_ALL: Final = 256
# One of so many of the views between cameras is kept apart to measure in, of those whose cameras
# look the same way to this cosine: halfway between others may be inside of something.
_APART_EVERY: Final = 6
_ALIKE: Final = 0.8

# Views that cover what others do not show are made smaller by this in width and height: they are
# close-ups, of which every pixel shows something, and losses are summed over pixels.
_COVERING_FACTOR: Final = 2

Background = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class TrainingViews:
    """Views and the pictures that a scene should show in them.

    Parameters
    ----------
    cameras : sequence of Camera
        The given ones, those between them, then copies of all these off the capture path, and
        views that cover what these do not show.
    configs : sequence of RenderConfig
        How each is drawn, on one thread.
    pictures : sequence of (H, W, 3) float32
        0 to 1, in the scene's colour space.
    given : int
        How many of the views are given ones.
    along : int
        How many are given ones or between these.
    photos : int
        How many of the given ones, the first, show photos; all others show renders of the source.
    """

    cameras: Sequence[Camera]
    configs: Sequence[RenderConfig]
    pictures: Sequence[F32]
    given: int
    along: int
    photos: int = 0

    def __len__(self) -> int:
        return len(self.cameras)


def _config(info: SceneInfo, factor: int, background: Background, device: str) -> RenderConfig:
    """Return how a view is drawn whose picture was made so many times smaller each way."""
    return RenderConfig(
        info.kernel_px / (factor * factor),
        info.antialiased,
        background=background,
        threads=1,
        device=device,
    )


def _factor(camera: Camera, most_pixels: int) -> int:
    """Return by how much each side of a picture is divided."""
    factor = math.ceil(math.sqrt(camera.width * camera.height / most_pixels))
    return max(1, min(factor, camera.width, camera.height))


def _between(cameras: Sequence[Camera]) -> list[Camera]:
    """Return views halfway between cameras and those that look most alike.

    Scenes trained in few views learn them by heart, what is rounded in them above all: these are
    new and as near to the capture path as any.
    """
    return [_halfway(cameras[one], cameras[other]) for one, other in _pairs(cameras)]


def _pairs(cameras: Sequence[Camera]) -> list[tuple[int, int]]:
    """Return pairs of cameras that look alike, the smaller number first."""
    places = np.array([camera.position for camera in cameras])
    looks = np.array([camera.rotation[2] for camera in cameras])
    spread = float(np.linalg.norm(places - places.mean(axis=0), axis=1).mean())
    neighbours = _NEIGHBOURS_IN_ALL // len(cameras)
    neighbours = min(max(neighbours, _FEWEST_NEIGHBOURS), _MOST_NEIGHBOURS)
    pairs = []
    for number in range(len(cameras)):
        off = np.linalg.norm(places - places[number], axis=1)
        off += spread * (1.0 - looks @ looks[number])
        off[number] = np.inf
        for other in np.argsort(off, kind="stable")[:neighbours].tolist():
            pair = min(number, other), max(number, other)
            if math.isfinite(off[other]) and pair not in pairs:
                pairs.append(pair)
    return pairs


def held_out_views(cameras: Sequence[Camera]) -> list[Camera]:
    """Return views to measure in, halfway between cameras, for training_views without them.

    Parameters
    ----------
    cameras : sequence of Camera
        In the frame of the means; those that `make_training_views` is given.

    Returns
    -------
    list of Camera
        For the parameter `apart` of `make_training_views`. Empty where no cameras look alike.
    """
    given = sample_evenly(cameras, MAX_VIEWS)
    alike = [
        (given[one], given[other])
        for one, other in _pairs(given)
        if float(given[one].rotation[2] @ given[other].rotation[2]) >= _ALIKE
    ]
    return [_halfway(*pair) for pair in alike[::_APART_EVERY]]


def _halfway(camera: Camera, other: Camera) -> Camera:
    """Return a camera as the first one, in the middle of two and turned by half the angle."""
    left, _, right = np.linalg.svd(camera.rotation + other.rotation)
    rotation = left @ np.diag([1.0, 1.0, float(np.linalg.det(left @ right))]) @ right
    place = (camera.position + other.position) / 2
    return replace(
        camera,
        rotation=rotation,
        translation=-rotation @ place,
        name=f"{camera.name}-{other.name}",
    )


def _drawn(view: tuple[Camera, RenderConfig], source: Splats) -> F32:
    picture = render(source, *view)
    return np.clip(picture, np.float32(0.0), np.float32(1.0), out=picture)


def make_training_views(
    source: Splats,
    cameras: Sequence[Camera],
    *,
    photos: Sequence[F32] | None = None,
    copies: bool = True,
    covering: Sequence[Camera] = (),
    apart: Sequence[Camera] = (),
    background: Background = (0.0, 0.0, 0.0),
    most_pixels: int = MAX_PIXELS,
    threads: int = 0,
    device: str = "cpu",
    progress: Progress = silent,
) -> TrainingViews:
    """Make the training_views that a scene is trained by: its own renders, or photos.

    Parameters
    ----------
    source : Splats
        Drawn with the kernel and anti-aliasing of ``source.info``.
    cameras : sequence of Camera
        In the frame of the means. Of more than `MAX_VIEWS`, evenly spread ones are taken.
    photos : sequence of (H, W, 3) float32, optional
        0 to 1, one per camera, in its size; without them the source's renders teach.
    copies : bool
        Whether views between cameras, and copies of all that step back or turn
        (`view_sets.jitter`), are added. They are always taught by the source's renders.
    covering : sequence of Camera
        Views of what visitors hardly see (`planner.ViewPlan.covering_views`). They teach as copies
        do, so that this is not forgotten. As given views, with copies and views between them, a
        third of what taught a trained figure was its underside, and views from around it had 1 dB
        less in as many bytes.
    apart : sequence of Camera
        From `held_out_views`: views that do not teach.
    background : tuple of float
        RGB behind the splats.
    most_pixels : int
        Larger pictures are made smaller by a whole number.
    threads : int
        0 for every core this process may use. The pictures do not depend on it.
    device : str
        As `RenderConfig` has it: where these pictures, and those of the training, are drawn.
    progress : Progress
        Called with ``training views``, views done and views.

    Returns
    -------
    TrainingViews

    Raises
    ------
    DataError
        ``no-cameras``.
    ValueError
        Other than one photo per camera.

    Examples
    --------
    >>> from cogsplat.codec.fit.training_views import make_training_views
    >>> import cogsplat
    >>> splats = cogsplat.read("scene.ply")
    >>> cameras = cogsplat.read_cameras("cameras.json")[:2]
    >>> views = make_training_views(splats, cameras)
    >>> len(views), views.given, views.along, views.pictures[0].shape
    (8, 2, 3, (48, 64, 3))
    """
    if not cameras:
        raise DataError("no-cameras", "0 cameras to train in, expected at least 1")
    if photos is not None and len(photos) != len(cameras):
        raise ValueError(f"{len(photos)} photos for {len(cameras)} cameras")
    chosen = sample_evenly(range(len(cameras)), MAX_VIEWS)
    given = [cameras[number] for number in chosen]
    between, off = [], []
    if copies:
        names = {camera.name for camera in apart}
        between = [camera for camera in _between(given) if camera.name not in names]
        off = [*jitter(source, given), *jitter(source, between, 1)]
    off += covering
    views = [*given, *between, *off]
    factors = [_factor(camera, most_pixels) for camera in views]
    for number in range(len(views) - len(covering), len(views)):
        factors[number] *= min(_COVERING_FACTOR, views[number].width, views[number].height)
    small = [downscale_camera(*pair) for pair in zip(views, factors, strict=True)]
    configs = [_config(source.info, factor, background, device) for factor in factors]
    taught = [] if photos is None else [photos[number] for number in chosen]
    pictures = [downscale_picture(*pair) for pair in zip(taught, factors, strict=False)]
    left = list(zip(small, configs, strict=True))[len(pictures) :]
    progress("training views", 0, len(views))
    for picture in ordered_map(partial(_drawn, source=source), left, thread_count(threads)):
        pictures.append(picture)
        progress("training views", len(pictures), len(views))
    along = len(given) + len(between)
    return TrainingViews(small, configs, pictures, len(given), along, len(taught))
