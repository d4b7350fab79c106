"""Pictures of a scene: footprints blended front to back in 16x16 px tiles, as 3DGS does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.geometry import sh
from cogsplat.codec.geometry.frustum import ALPHA_MIN, NEAR
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.splats import MAX_SH_DEGREE, Splats
from cogsplat.codec.threads import ordered_map, thread_count

from .jit import kernel
from .projection import FLAT, NARROW, OPACITY, SHEAR, Footprints, X, Y, project
from .tiles import TILE, TileLists, tile_lists

# 3DGS, renderCUDA: alpha is capped here, and a splat that would bring the transmittance below
# TRANSMITTANCE_MIN ends the pixel unblended. Both compared in float32, as there: two capped splats
# leave (1 - 0.99f)², which is below 1e-4f in float32 and would not be in float64.
ALPHA_MAX = np.float32(0.99)
TRANSMITTANCE_MIN = np.float32(1e-4)
_ALPHA_MIN = np.float32(ALPHA_MIN)

# exp(t) = p(t / 8)⁸ for t in [-6, 0], p interpolated at the Chebyshev nodes of [-0.75, 0]: relative
# error 4e-8 before rounding, under 2e-6 with it. Plain arithmetic, so that the compiler does a
# whole tile row at once. exp(-6) < 1/255, so everything beyond is cut anyway.
_EXPONENT_MIN = np.float32(-6.0)
_EXPONENT_STEP = np.float32(1.0 / 8.0)
_E0 = np.float32(0.9999999976614112)
_E1 = np.float32(0.9999996941214522)
_E2 = np.float32(0.49999344142033314)
_E3 = np.float32(0.1666136657480342)
_E4 = np.float32(0.04146113829788055)
_E5 = np.float32(0.007918287681908878)
_E6 = np.float32(0.0009587715253757255)

_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)
_HALF = np.float32(0.5)
_PIXELS = TILE * TILE
# Unsigned, so that no index is checked for counting from the end: such checks stop vectorisation.
_TILE = np.uintp(TILE)
_REST, _RED, _GREEN, _BLUE = (np.uintp(k * _PIXELS) for k in range(1, 5))
_TILE_RED, _TILE_GREEN, _TILE_BLUE = (np.uintp(k * _PIXELS) for k in range(1, 4))

# Ranges of tiles per thread: tiles differ in cost, and small ranges even that out.
_RANGES_PER_THREAD = 4


@dataclass(frozen=True)
class RenderConfig:
    """How a scene is drawn.

    Parameters
    ----------
    kernel_px : float
        Variance added to projected covariances, px²; 0.3 in 3DGS, 0.1 in Mip-Splatting.
    antialiased : bool
        Rescale opacities by the area the kernel adds (Mip-Splatting, section 4.2).
    background : tuple of float
        RGB behind the splats, in the scene's colour space.
    near_plane : float
        Means at or before this camera-space depth are not drawn, scene units.
    sh_degree : int or None
        Highest SH degree used; None for the scene's own.
    threads : int
        0 for every core this process may use. The picture does not depend on it.
    """

    kernel_px: float = 0.3
    antialiased: bool = False
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    near_plane: float = NEAR
    sh_degree: int | None = None
    threads: int = 0

    def __post_init__(self) -> None:
        if not self.kernel_px >= 0.0:
            raise ValueError(f"kernel_px {self.kernel_px}, expected 0 or more")
        if not self.near_plane > 0.0:
            raise ValueError(f"near_plane {self.near_plane}, expected more than 0")
        if self.sh_degree is not None and not 0 <= self.sh_degree <= MAX_SH_DEGREE:
            raise ValueError(f"SH degree {self.sh_degree}, expected 0 to {MAX_SH_DEGREE}")
        thread_count(self.threads)


@kernel
def falloff(exponent: np.float32) -> np.float32:
    """Return exp(exponent) for an exponent of at most 0; below -6, exp(-6)."""
    t = max(exponent, _EXPONENT_MIN) * _EXPONENT_STEP
    p = _E0 + t * (_E1 + t * (_E2 + t * (_E3 + t * (_E4 + t * (_E5 + t * _E6)))))
    p = p * p
    p = p * p
    return p * p


_terms = kernel(sh.terms)


@kernel
def _shade(
    index: NDArray[np.int32],
    means: NDArray[np.float32],
    sh0: NDArray[np.float32],
    shN: NDArray[np.float32],
    position: NDArray[np.float64],
    higher: int,
    colours: NDArray[np.float32],
) -> None:
    """Colours of the indexed splats from a camera position, using `higher` bases above DC."""
    for row in range(len(index)):
        i = index[row]
        red = np.float32(sh.C0) * sh0[i, 0]
        green = np.float32(sh.C0) * sh0[i, 1]
        blue = np.float32(sh.C0) * sh0[i, 2]
        if higher > 0:
            x = means[i, 0] - position[0]
            y = means[i, 1] - position[1]
            z = means[i, 2] - position[2]
            inverse = 1.0 / np.sqrt(x * x + y * y + z * z)
            values = _terms(x * inverse, y * inverse, z * inverse)
            for k in range(higher):
                value = np.float32(values[k])
                red += value * shN[i, k, 0]
                green += value * shN[i, k, 1]
                blue += value * shN[i, k, 2]
        offset = np.float32(sh.COLOUR_OFFSET)
        colours[row, 0] = max(red + offset, _ZERO)
        colours[row, 1] = max(green + offset, _ZERO)
        colours[row, 2] = max(blue + offset, _ZERO)


@kernel
def _blend(
    first: int,
    last: int,
    lists_first: int,
    starts: NDArray[np.int64],
    members: NDArray[np.int32],
    ellipse: NDArray[np.float32],
    rows: NDArray[np.int32],
    colours: NDArray[np.float32],
    background: NDArray[np.float32],
    image: NDArray[np.float32],
) -> None:
    """Draw the tiles ``first`` to ``last`` of an image.

    A splat is taken through a tile a whole row of 16 pixels at a time, without branches, so that
    the rows become vector instructions. Pixels that are finished, or outside the image, have a
    transmittance of 0 for blending (`live`) and keep the one for the background apart (`rest`).
    """
    height, width = image.shape[0], image.shape[1]
    tiles_x = (width + TILE - 1) // TILE
    # live, rest, red, green, blue of 256 pixels each: one array at constant distances, so that the
    # compiler sees that they do not overlap.
    state = np.empty(5 * _PIXELS, np.float32)
    for tile in range(first, last):
        top = tile // tiles_x * TILE
        left = tile % tiles_x * TILE
        num_rows = min(TILE, height - top)
        num_columns = min(TILE, width - left)
        state[:] = _ZERO
        for y in range(num_rows):
            for x in range(num_columns):
                state[y * TILE + x] = _ONE
                state[y * TILE + x + _PIXELS] = _ONE
        unfinished = num_rows * num_columns
        for pair in range(starts[tile - lists_first], starts[tile - lists_first + 1]):
            i = members[pair]
            narrow = ellipse[i, NARROW]
            shear = ellipse[i, SHEAR]
            flat = ellipse[i, FLAT]
            opacity = ellipse[i, OPACITY]
            # Relative to the centre of the tile's first pixel.
            centre_x = ellipse[i, X] - np.float32(left) - _HALF
            centre_y = ellipse[i, Y] - np.float32(top) - _HALF
            red, green, blue = colours[i, 0], colours[i, 1], colours[i, 2]
            finished = 0
            for y in range(max(rows[i, 0] - top, 0), min(rows[i, 1] - top, num_rows)):
                dy = np.float32(y) - centre_y
                row_x = centre_x + shear * dy
                row_exponent = -flat * dy * dy
                base = np.uintp(y * TILE)
                for lane in range(_TILE):
                    at = base + lane
                    u = narrow * (np.float32(lane) - row_x)
                    alpha = min(ALPHA_MAX, opacity * falloff(row_exponent - u * u))
                    live, rest = state[at], state[at + _REST]
                    after = live * (_ONE - alpha)
                    touched = alpha >= _ALPHA_MIN
                    goes_on = after >= TRANSMITTANCE_MIN
                    drawn = touched & goes_on
                    weight = live * alpha if drawn else _ZERO
                    finished += int(touched & (live > _ZERO) & ~goes_on)
                    state[at] = (after if goes_on else _ZERO) if touched else live
                    state[at + _REST] = after if drawn else rest
                    state[at + _RED] += weight * red
                    state[at + _GREEN] += weight * green
                    state[at + _BLUE] += weight * blue
            unfinished -= finished
            if unfinished == 0:
                break
        for y in range(num_rows):
            for x in range(num_columns):
                pixel = y * TILE + x
                rest = state[pixel + _PIXELS]
                for channel in range(3):
                    image[top + y, left + x, channel] = (
                        state[pixel + (2 + channel) * _PIXELS] + rest * background[channel]
                    )


@kernel
def blend_tile(
    state: NDArray[np.float32],
    begin: int,
    end: int,
    members: NDArray[np.int32],
    ellipse: NDArray[np.float32],
    rows: NDArray[np.int32],
    colours: NDArray[np.float32],
    present: NDArray[np.bool_],
    top: int,
    left: int,
    num_rows: int,
    num_columns: int,
) -> int:
    """Blend the pairs of one tile over black, front to back; return the first that nothing reaches.

    What `_blend` does without a background, for walks that go over a tile again: row by row and
    without branches, likewise.

    Parameters
    ----------
    state : (at least 4 * TILE * TILE,) float32
        Filled: transmittance, red, green and blue, a tile's pixels of each.
    begin, end : int
        Pairs, front to back.
    members : (pairs,) int32
    ellipse, rows, colours
        Of every footprint.
    present : (footprints,) bool
        Which are drawn.
    top, left, num_rows, num_columns : int
        The tile's part of the picture, px.
    """
    state[:] = _ZERO
    for y in range(num_rows):
        for x in range(num_columns):
            state[y * TILE + x] = _ONE
    unfinished = num_rows * num_columns
    for pair in range(begin, end):
        i = members[pair]
        if not present[i]:
            continue
        narrow = ellipse[i, NARROW]
        shear = ellipse[i, SHEAR]
        flat = ellipse[i, FLAT]
        opacity = ellipse[i, OPACITY]
        centre_x = ellipse[i, X] - np.float32(left) - _HALF
        centre_y = ellipse[i, Y] - np.float32(top) - _HALF
        red, green, blue = colours[i, 0], colours[i, 1], colours[i, 2]
        finished = 0
        for y in range(max(rows[i, 0] - top, 0), min(rows[i, 1] - top, num_rows)):
            dy = np.float32(y) - centre_y
            row_x = centre_x + shear * dy
            row_exponent = -flat * dy * dy
            base = np.uintp(y * TILE)
            for lane in range(_TILE):
                at = base + lane
                u = narrow * (np.float32(lane) - row_x)
                alpha = min(ALPHA_MAX, opacity * falloff(row_exponent - u * u))
                live = state[at]
                after = live * (_ONE - alpha)
                touched = alpha >= _ALPHA_MIN
                goes_on = after >= TRANSMITTANCE_MIN
                weight = live * alpha if touched & goes_on else _ZERO
                finished += int(touched & (live > _ZERO) & ~goes_on)
                state[at] = (after if goes_on else _ZERO) if touched else live
                state[at + _TILE_RED] += weight * red
                state[at + _TILE_GREEN] += weight * green
                state[at + _TILE_BLUE] += weight * blue
        unfinished -= finished
        if unfinished == 0:
            return pair + 1
    return end


def _draw(
    splats: Splats, camera: Camera, config: RenderConfig, threads: int
) -> NDArray[np.float32]:
    footprints = project(
        splats,
        camera,
        kernel_px=config.kernel_px,
        antialiased=config.antialiased,
        near_plane=config.near_plane,
    )
    higher = splats.shN.shape[1]
    if config.sh_degree is not None:
        higher = min(higher, (config.sh_degree + 1) ** 2 - 1)
    colours = np.empty((len(footprints), 3), np.float32)
    _shade(
        footprints.index,
        splats.means,
        splats.sh0,
        splats.shN,
        camera.position,
        higher,
        colours,
    )
    background = np.array(config.background, np.float32)
    image = np.empty((camera.height, camera.width, 3), np.float32)
    for lists in tile_lists(footprints, camera.width, camera.height):
        _draw_tiles(lists, footprints, colours, background, image, threads)
    return image


def _draw_tiles(
    lists: TileLists,
    footprints: Footprints,
    colours: NDArray[np.float32],
    background: NDArray[np.float32],
    image: NDArray[np.float32],
    threads: int,
) -> None:
    def draw(tiles: tuple[int, int]) -> None:
        _blend(
            tiles[0],
            tiles[1],
            lists.first,
            lists.starts,
            lists.members,
            footprints.ellipse,
            footprints.rows,
            colours,
            background,
            image,
        )

    parts = 1 if threads == 1 else threads * _RANGES_PER_THREAD
    for _ in ordered_map(draw, lists.split(parts), threads):
        pass


def _config_of(splats: Splats) -> RenderConfig:
    return RenderConfig(kernel_px=splats.info.kernel_px, antialiased=splats.info.antialiased)


def render(
    splats: Splats, camera: Camera, config: RenderConfig | None = None
) -> NDArray[np.float32]:
    """Draw a scene from one camera.

    Parameters
    ----------
    splats : Splats
        Rows that cannot be drawn are left out.
    camera : Camera
        In the frame of the means (``info.origin`` is not applied).
    config : RenderConfig or None
        None for the kernel and anti-aliasing the scene states in `Splats.info`, over black.

    Returns
    -------
    (H, W, 3) float32
        The blend as it comes, in the scene's colour space, not clipped.

    Notes
    -----
    3DGS conventions (Kerbl et al. 2023, section 6 and the published rasteriser's constants): EWA
    projection, alpha capped at 0.99 and cut below 1/255, a pixel ends before its transmittance
    falls below 1e-4, order by camera-space z of the mean. A splat reaches exactly the pixels where
    its alpha is 1/255 or more.
    """
    config = config or _config_of(splats)
    return _draw(splats, camera, config, thread_count(config.threads))


def render_views(
    splats: Splats,
    cameras: Sequence[Camera],
    config: RenderConfig | None = None,
    *,
    progress: Progress = silent,
) -> list[NDArray[np.float32]]:
    """Draw a scene from several cameras, views in parallel.

    Parameters
    ----------
    splats, config
        As in `render`.
    cameras : sequence of Camera
        In the frame of the means.
    progress : Progress
        Called with ``("render", views done, views)``; raising from it stops the work.

    Returns
    -------
    list of (H, W, 3) float32
        In the order of the cameras, not clipped; each equals what `render` gives, bit for bit.
    """
    config = config or _config_of(splats)
    threads = thread_count(config.threads)
    by_view = len(cameras) >= threads
    images: list[NDArray[np.float32]] = []
    progress("render", 0, len(cameras))
    for image in ordered_map(
        lambda camera: _draw(splats, camera, config, 1 if by_view else threads),
        cameras,
        threads if by_view else 1,
    ):
        images.append(image)
        progress("render", len(images), len(cameras))
    return images
