"""Training views: the cameras that a scene is trained in, and the ground truth of each."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
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
from cogsplat.codec.views.drawn_views import ViewDrawer
from cogsplat.codec.views.view_sets import sample_evenly

from .downscaling import downscale_picture

F32 = NDArray[np.float32]
Background = tuple[float, float, float]

MAX_PIXELS: Final = 1 << 18
"""Maximum number of pixels per picture; larger pictures are downscaled. Bounds memory."""
MAX_VIEWS: Final = 96
"""Maximum number of given cameras used for training. Bounds memory."""

# Downscaling of covering views, per axis. They are close-ups that splats fill entirely, and losses
# are summed over pixels: at full size they would dominate.
_COVERING_FACTOR: Final = 2


@dataclass(frozen=True, eq=False)
class TrainingView:
    """One view to train in.

    Parameters
    ----------
    camera : Camera
        View, in the size of its picture.
    config : RenderConfig
        Render settings, on one thread.
    picture : (H, W, 3) float32
        Ground truth, 0 to 1, in the scene's colour space.
    """

    camera: Camera
    config: RenderConfig
    picture: F32


@dataclass(frozen=True, eq=False)
class TrainingViews:
    """Views that a scene is trained in: a fixed set, and new views drawn near its given cameras.

    With few fixed views alone, other views gain less or lose (docs/ablations.md).

    Parameters
    ----------
    cameras : sequence of Camera
        Fixed views: first the given cameras, then covering views, or views off the path.
    configs : sequence of RenderConfig
        Render settings of each fixed view, on one thread.
    pictures : sequence of (H, W, 3) float32
        Ground truth of each fixed view, 0 to 1, in the scene's colour space.
    num_given : int
        Number of given cameras.
    photos : bool
        Whether the ground truth of given cameras is photos; that of all other views is renders.
    drawn : DrawnViews, optional
        Source of new views; none by default.
    """

    cameras: Sequence[Camera]
    configs: Sequence[RenderConfig]
    pictures: Sequence[F32]
    num_given: int
    photos: bool = False
    drawn: DrawnViews | None = None

    def __len__(self) -> int:
        return len(self.cameras)

    def fixed(self, number: int) -> TrainingView:
        """Return a fixed view."""
        return TrainingView(self.cameras[number], self.configs[number], self.pictures[number])

    def sample(self, count: int, seed: int) -> list[tuple[Camera, RenderConfig]]:
        """Return cameras and render settings of views: fixed ones, then drawn ones.

        Parameters
        ----------
        count : int
            Number of views. More fixed views are sampled evenly; to fewer, drawn views are added if
            there are any, on and off the path in turn.
        seed : int
            Seed of the drawn views.
        """
        found = sample_evenly(list(zip(self.cameras, self.configs, strict=True)), count)
        if self.drawn is not None:
            rng = np.random.default_rng(seed)
            for number in range(len(found), count):
                found.append(self.drawn.camera(rng, off_path=bool(number % 2)))
        return found


@dataclass(frozen=True, eq=False)
class DrawnViews:
    """Source of new views near given cameras, whose ground truth is renders of the source.

    Parameters
    ----------
    source : Splats
        Scene that the ground truth is rendered from.
    drawer : ViewDrawer
        Source of the cameras.
    background : tuple of float
        RGB behind the splats.
    max_pixels : int
        Maximum number of pixels per picture, as in `make_training_views`.
    device : str
        Device of `RenderConfig`.
    """

    source: Splats
    drawer: ViewDrawer
    background: Background = (0.0, 0.0, 0.0)
    max_pixels: int = MAX_PIXELS
    device: str = "cpu"

    def camera(self, rng: np.random.Generator, *, off_path: bool) -> tuple[Camera, RenderConfig]:
        """Draw a view (`ViewDrawer.draw`); return it at the size of its picture, with settings."""
        camera = self.drawer.draw(rng, off_path=off_path)
        factor = _downscaling_factor(camera, self.max_pixels)
        config = _render_config(factor, self.background, self.device)
        return camera.downscaled(factor), config

    def render(self, camera: Camera, config: RenderConfig) -> TrainingView:
        """Return a drawn view with its ground truth."""
        return TrainingView(camera, config, _render_clipped((camera, config), self.source))


def _render_config(factor: int, background: Background, device: str) -> RenderConfig:
    """Return the render settings of a view whose picture is downscaled by `factor` per axis."""
    return RenderConfig(background=background, reduction=factor, threads=1, device=device)


def _downscaling_factor(camera: Camera, max_pixels: int) -> int:
    """Return the downscaling per axis that leaves at most `max_pixels` pixels."""
    factor = math.ceil(math.sqrt(camera.width * camera.height / max_pixels))
    return max(1, min(factor, camera.width, camera.height))


def _render_clipped(view: tuple[Camera, RenderConfig], source: Splats) -> F32:
    """Return the render of a view, clipped to 0 to 1."""
    picture = render(source, *view)
    return np.clip(picture, np.float32(0.0), np.float32(1.0), out=picture)


def make_training_views(
    source: Splats,
    cameras: Sequence[Camera],
    *,
    photos: Sequence[F32] | None = None,
    draw: bool = True,
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
    draw : bool
        Whether new views are drawn near the cameras while training.
    covering : sequence of Camera
        Views of regions that `cameras` hardly show (`planner.ViewPlan.covering_views`), so that
        training keeps these regions. They are rendered at half the width and height, and shown
        rarely: with equal weight, other views of a figure lost 1 dB at the same file size.
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
    >>> len(views), views.num_given, views.pictures[0].shape
    (2, 2, (48, 64, 3))
    """
    if not cameras:
        raise DataError("no-cameras", "0 cameras to train in, expected at least 1")
    if photos is not None and len(photos) != len(cameras):
        raise ValueError(f"{len(photos)} photos for {len(cameras)} cameras")
    chosen = sample_evenly(range(len(cameras)), MAX_VIEWS)
    given = [cameras[number] for number in chosen]
    views = [*given, *covering]
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
    drawn = None
    if draw:
        drawer = ViewDrawer(source, given)
        drawn = DrawnViews(source, drawer, background, max_pixels, device)
    return TrainingViews(small, configs, pictures, len(given), photos is not None, drawn)
