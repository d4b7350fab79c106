"""Rasteriser: renders of a scene, blended front to back in 16x16 px tiles as 3DGS does."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.compiling import called_with
from cogsplat.codec.finite_fields import require_finite
from cogsplat.codec.geometry.frustum import NEAR
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.splats import MAX_SH_DEGREE, Splats
from cogsplat.codec.threads import ordered_map, thread_count

from .blending import BLUE, GREEN, PIXELS, PLANES, RED, REST, blend_tile, tile_area
from .cuda_device import require_device
from .cuda_views import CudaScene, CudaView
from .jit import kernel
from .projection import project
from .shading import footprint_colours
from .tiles import TILE, tile_lists


@dataclass(frozen=True)
class RenderConfig:
    """Settings of `render` and `render_views`.

    Parameters
    ----------
    background : tuple of float
        Background colour, RGB in the scene's colour space.
    near_plane : float
        Camera-space depth up to which nothing is drawn, scene units.
    sh_degree : int or None
        Highest SH degree used; None for the scene's own.
    reduction : float
        Reduction of the picture per axis against the pictures of training, at least 1.
        Used only where ``info.capture`` does not tell.
    threads : int
        Number of threads; 0 for every core this process may use. The picture does not depend on it.
    device : str
        ``cpu``, or ``cuda`` to draw with gsplat on a CUDA device (extra ``train``). CUDA pictures
        differ by rounding, from run to run too (`cuda_views`).
    """

    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    near_plane: float = NEAR
    sh_degree: int | None = None
    reduction: float = 1.0
    threads: int = 0
    device: str = "cpu"

    def __post_init__(self) -> None:
        require_finite(self)
        if not self.reduction >= 1.0:
            raise ValueError(f"reduction {self.reduction}, expected 1 or more")
        if not self.near_plane > 0.0:
            raise ValueError(f"near_plane {self.near_plane}, expected more than 0")
        if self.sh_degree is not None and not 0 <= self.sh_degree <= MAX_SH_DEGREE:
            raise ValueError(f"SH degree {self.sh_degree}, expected 0 to {MAX_SH_DEGREE}")
        thread_count(self.threads)
        require_device(self.device)


@called_with(
    "int64, int64[::1], int32[::1], float32[:, ::1], int32[:, ::1], float32[:, ::1], "
    "boolean[::1], float32[::1], boolean[::1], float32[:, :, ::1], int64, int64"
)
@kernel
def _draw_tiles(
    lists_first: int,
    starts: NDArray[np.int64],
    members: NDArray[np.int32],
    ellipse: NDArray[np.float32],
    rows: NDArray[np.int32],
    colours: NDArray[np.float32],
    present: NDArray[np.bool_],
    background: NDArray[np.float32],
    wanted: NDArray[np.bool_],
    image: NDArray[np.float32],
    first: int,
    last: int,
) -> None:
    """Draw the tiles of an image from ``first`` to ``last``, half-open, that ``wanted`` marks."""
    height, width = image.shape[0], image.shape[1]
    state = np.empty(PLANES * PIXELS, np.float32)
    for tile in range(first, last):
        if not wanted[tile]:
            continue
        top, left, num_rows, num_columns = tile_area(tile, width, height)
        blend_tile(
            state,
            starts[tile - lists_first],
            starts[tile - lists_first + 1],
            members,
            ellipse,
            rows,
            colours,
            present,
            top,
            left,
            num_rows,
            num_columns,
            True,
        )
        for y in range(num_rows):
            for x in range(num_columns):
                pixel = np.uintp(y * TILE + x)
                rest = state[pixel + REST]
                image[top + y, left + x, 0] = state[pixel + RED] + rest * background[0]
                image[top + y, left + x, 1] = state[pixel + GREEN] + rest * background[1]
                image[top + y, left + x, 2] = state[pixel + BLUE] + rest * background[2]


def _draw(
    splats: Splats,
    camera: Camera,
    config: RenderConfig,
    threads: int,
    wanted: NDArray[np.bool_] | None = None,
) -> NDArray[np.float32]:
    """Render one view, or only the tiles that the (tiles in y, tiles in x) mask `wanted` marks."""
    if wanted is None:
        wanted = np.ones(_tile_counts(camera), np.bool_)
    footprints = project(splats, camera, reduction=config.reduction, near_plane=config.near_plane)
    colours = footprint_colours(splats, camera, footprints, sh_degree=config.sh_degree)
    present = np.ones(len(footprints), np.bool_)
    background = np.array(config.background, np.float32)
    image = np.empty((camera.height, camera.width, 3), np.float32)
    for lists in tile_lists(footprints, camera.width, camera.height):
        draw = partial(
            _draw_tiles,
            lists.first,
            lists.starts,
            lists.members,
            footprints.ellipse,
            footprints.rows,
            colours,
            present,
            background,
            wanted.ravel(),
            image,
        )
        lists.for_ranges(draw, threads)
    return image


def _tile_counts(camera: Camera) -> tuple[int, int]:
    """Return the tile counts of an image in y and in x."""
    return -(-camera.height // TILE), -(-camera.width // TILE)


def render(
    splats: Splats, camera: Camera, config: RenderConfig | None = None
) -> NDArray[np.float32]:
    """Render a scene from one camera.

    Parameters
    ----------
    splats : Splats
        Scene, drawn with the kernel of ``splats.info``; splats that cannot be drawn are ignored.
    camera : Camera
        Camera in the frame of the means (``info.origin`` is not applied).
    config : RenderConfig or None
        None for the defaults.

    Returns
    -------
    (H, W, 3) float32
        Picture in the scene's colour space, not clipped.

    Raises
    ------
    MissingExtraError
        ``needs-extra`` or ``no-cuda-device``: the device ``cuda`` is not available.
    LimitError
        ``device-memory``: the CUDA device is out of memory.

    Notes
    -----
    3DGS conventions (Kerbl et al. 2023, section 6 and the published rasteriser's constants): EWA
    projection, alpha capped at 0.99 and cut below 1/255, a pixel ends before its transmittance
    falls below 1e-4, order by camera-space z of the mean. A splat reaches exactly the pixels where
    its alpha is 1/255 or more.

    Examples
    --------
    >>> from cogsplat.codec.render.rasteriser import RenderConfig, render
    >>> import cogsplat
    >>> splats = cogsplat.read("scene.ply")
    >>> camera = cogsplat.read_cameras("cameras.json")[0]
    >>> image = render(splats, camera, RenderConfig(background=(1.0, 1.0, 1.0)))
    >>> image.shape, image.dtype.name
    ((48, 64, 3), 'float32')
    """
    config = config or RenderConfig()
    if config.device == "cuda":
        return cuda_view(CudaScene(splats), camera, config).picture(config.background)
    return _draw(splats, camera, config, thread_count(config.threads))


def cuda_view(scene: CudaScene, camera: Camera, config: RenderConfig) -> CudaView:
    """Project a scene on a CUDA device into a camera, with the settings of a `RenderConfig`."""
    return scene.view(
        camera,
        reduction=config.reduction,
        near_plane=config.near_plane,
        sh_degree=config.sh_degree,
    )


def render_tiles(
    splats: Splats, camera: Camera, every: int, config: RenderConfig | None = None
) -> NDArray[np.float32]:
    """Render every n-th tile of a view, spread over the image.

    In large pictures, a sample of the tiles measures the difference of two scenes well enough.

    Parameters
    ----------
    splats, camera, config
        See `render`.
    every : int
        Interval n of the tiles; 1 renders all.

    Returns
    -------
    (P, 3) float32
        Pixels of the sampled tiles in the order of the image; the sample depends on the image size
        only.
    """
    config = config or RenderConfig()
    down, across = np.indices(_tile_counts(camera))
    # The offset per row of tiles is about a golden section, so the sample avoids rows and columns.
    wanted = (across + max(1, round(0.382 * every)) * down) % every == 0
    if config.device == "cuda":
        image = render(splats, camera, config)
    else:
        image = _draw(splats, camera, config, thread_count(config.threads), wanted)
    pixels = np.repeat(np.repeat(wanted, TILE, axis=0), TILE, axis=1)
    drawn: NDArray[np.float32] = image[pixels[: camera.height, : camera.width]]
    return drawn


def render_views(
    splats: Splats,
    cameras: Sequence[Camera],
    config: RenderConfig | None = None,
    *,
    progress: Progress = silent,
) -> list[NDArray[np.float32]]:
    """Render a scene from several cameras, views in parallel.

    Parameters
    ----------
    splats, config
        See `render`.
    cameras : sequence of Camera
        Cameras in the frame of the means.
    progress : Progress
        Called with ``("render", views done, views)``; raising from it stops the work.

    Returns
    -------
    list of (H, W, 3) float32
        Pictures in the order of the cameras, not clipped, bit-identical to those of `render`.

    Examples
    --------
    >>> from cogsplat.codec.render.rasteriser import render_views
    >>> import cogsplat
    >>> splats = cogsplat.read("scene.ply")
    >>> cameras = cogsplat.read_cameras("cameras.json")[:2]
    >>> [image.shape for image in render_views(splats, cameras)]
    [(48, 64, 3), (48, 64, 3)]
    """
    config = config or RenderConfig()
    threads = thread_count(config.threads)
    by_view = len(cameras) >= threads
    images: list[NDArray[np.float32]] = []
    progress("render", 0, len(cameras))
    drawn: Iterator[NDArray[np.float32]]
    if config.device == "cuda":
        scene = CudaScene(splats)
        drawn = (cuda_view(scene, camera, config).picture(config.background) for camera in cameras)
    else:
        drawn = ordered_map(
            lambda camera: _draw(splats, camera, config, 1 if by_view else threads),
            cameras,
            threads if by_view else 1,
        )
    for image in drawn:
        images.append(image)
        progress("render", len(images), len(cameras))
    return images
