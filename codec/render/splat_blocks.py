"""Blocks of splats that lie close together, and where a camera sees each block."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.compiling import called_with
from cogsplat.codec.geometry.frustum import ALPHA_MIN
from cogsplat.codec.geometry.morton import interleave
from cogsplat.codec.splats import Splats
from cogsplat.codec.workspace import IN_MEMORY, Workspace

from .depth_order import key_order
from .jit import kernel
from .projection import (
    BALL,
    BALL_EDGE,
    FILTER,
    GUARD,
    PIXEL_VARIANCE,
    THICKNESS,
    slack,
    view_kernel,
)

F64 = NDArray[np.float64]

BLOCK_SPLATS: Final = 256
"""Splats of a block. Scoring a view of a city of three million splats takes 0.58 of the time of all
splats at once with blocks of 64, 0.59 with 256, and 0.66 with 1,024."""

MIN_BLOCKED_SPLATS = 100_000
"""Minimum splats of a scene that is grouped into blocks: in smaller ones the sort takes longer."""

# Bits of a mean's place along each axis, three digits of `key_order` in all, and the number of
# means that tell the extent of the scene: few distant splats must not push all others together.
_AXIS_BITS: Final = 11
_SAMPLED: Final = 1 << 16
_TAIL: Final = 0.01

# Rows that are read at once.
_ROWS: Final = 1 << 18

# Share of the bounds of a block's picture, and of its depth, that covers rounding.
_MARGIN: Final = 1e-6

OUTSIDE, INSIDE, EDGE = range(3)
"""Kinds of blocks in a view: no splat reaches a pixel; every drawable splat's centre lies in the
picture; neither is known."""

# Columns of `BlockViews.pixels`.
LEFT, RIGHT, TOP, BOTTOM = range(4)

# Largest reach of a splat, px, for which its centre alone tells that it has a footprint.
_FAR_REACH: Final = 1e12
# Least variance, px², that a camera adds to splats where this holds: else an ellipse may be flat.
_LEAST_THICKNESS: Final = 1e-3
# Least and largest squared length of a quaternion, and largest log scale, likewise.
_LEAST_SQUARE, _LARGEST_SQUARE = 1e-12, 1e12
_LARGEST_SCALE: Final = 30.0


@dataclass(frozen=True, eq=False)
class SplatBlocks:
    """Blocks of a scene of N splats.

    Parameters
    ----------
    rows : (N,) int32
        Rows of the splats, block by block of `BLOCK_SPLATS`; the last block may be smaller.
    low, high : (B, 3) float32
        Bounds of the means of each block, scene units; infinite where a mean is not finite.
    widest : (B,) float32
        Largest log scale of each block.
    plain : (B,) bool
        Blocks without values for which a splat inside the picture may have no footprint.
    """

    rows: NDArray[np.int32]
    low: NDArray[np.float32]
    high: NDArray[np.float32]
    widest: NDArray[np.float32]
    plain: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.widest)

    def rows_of(self, blocks: NDArray[np.int64]) -> NDArray[np.int32]:
        """Return the rows of the splats of some blocks, ascending."""
        places = (blocks[:, None] * BLOCK_SPLATS + np.arange(BLOCK_SPLATS)).ravel()
        rows: NDArray[np.int32] = self.rows[places[places < len(self.rows)]]
        rows.sort()
        return rows


@dataclass(frozen=True, eq=False)
class BlockViews:
    """Positions of blocks in a camera's picture; bounds hold for every splat of a block.

    Parameters
    ----------
    kinds : (B,) int8
        `OUTSIDE`, `INSIDE` or `EDGE`.
    nearest, furthest : (B,) float64
        Bounds of the depth of the means, scene units.
    pixels : (B, 4) int32
        Half-open ranges of image columns and rows that the splats may reach: columns `LEFT`,
        `RIGHT`, `TOP`, `BOTTOM`.
    """

    kinds: NDArray[np.int8]
    nearest: F64
    furthest: F64
    pixels: NDArray[np.int32]


@called_with(
    "float32[:, ::1], float32[:, ::1], float32[:, ::1], int64, int32[::1], float32[:, ::1], "
    "float32[:, ::1], float32[::1], boolean[::1]"
)
@kernel
def _bound(
    means: NDArray[np.float32],
    scales: NDArray[np.float32],
    quats: NDArray[np.float32],
    first: int,
    block_of: NDArray[np.int32],
    low: NDArray[np.float32],
    high: NDArray[np.float32],
    widest: NDArray[np.float32],
    plain: NDArray[np.bool_],
) -> None:
    """Widen the bounds of blocks by the splats from the row `first` on."""
    for i in range(len(means)):
        block = block_of[first + i]
        square = 0.0
        for k in range(4):
            square += float(quats[i, k]) * float(quats[i, k])
        if not (_LEAST_SQUARE < square < _LARGEST_SQUARE):
            plain[block] = False
        for k in range(3):
            value, scale = means[i, k], scales[i, k]
            if not abs(value) < np.inf:
                low[block, k], high[block, k] = -np.inf, np.inf
                plain[block] = False
            else:
                low[block, k] = min(low[block, k], value)
                high[block, k] = max(high[block, k], value)
            if not scale < _LARGEST_SCALE:
                plain[block] = False
            # A scale that is no number draws nothing, and must not hide others.
            if scale > widest[block]:
                widest[block] = scale


def blocks_if_large(splats: Splats, workspace: Workspace = IN_MEMORY) -> SplatBlocks | None:
    """Return the blocks of a scene; None of a small one, which is drawn as a whole."""
    return splat_blocks(splats, workspace) if len(splats) >= MIN_BLOCKED_SPLATS else None


def splat_blocks(splats: Splats, workspace: Workspace = IN_MEMORY) -> SplatBlocks:
    """Group the splats of a scene into blocks by their Morton code.

    Parameters
    ----------
    splats : Splats
        Scene of N splats, fewer than 2^31; values that are not finite are allowed.
    workspace : Workspace
        Allocator of the rows. The sort takes 28 bytes of memory for each splat.

    Returns
    -------
    SplatBlocks
    """
    n = len(splats)
    count = -(-n // BLOCK_SPLATS)
    rows = workspace.zeros((n,), np.int32)
    rows[:] = key_order(_morton_keys(splats, workspace))
    block_of = np.empty(n, np.int32)
    for start in range(0, n, _ROWS):
        part = rows[start : start + _ROWS]
        block_of[part] = np.arange(start, start + len(part)) // BLOCK_SPLATS
    low = np.full((count, 3), np.inf, np.float32)
    high = np.full((count, 3), -np.inf, np.float32)
    widest = np.full(count, -np.inf, np.float32)
    plain = np.ones(count, np.bool_)
    for start in range(0, n, _ROWS):
        run = slice(start, start + _ROWS)
        _bound(
            splats.means[run], splats.scales[run], splats.quats[run], start, block_of,
            low, high, widest, plain,
        )  # fmt: skip
        workspace.trim()
    return SplatBlocks(rows, low, high, widest, plain)


def _morton_keys(splats: Splats, workspace: Workspace) -> NDArray[np.uint64]:
    """Return the Morton code of each mean's place in the scene, without its furthest splats."""
    n, levels = len(splats), 1 << _AXIS_BITS
    sample = splats.means[:: max(1, n // _SAMPLED)]
    sample = sample[np.isfinite(sample).all(axis=1)]
    first, last = np.quantile(sample, (_TAIL, 1.0 - _TAIL), axis=0) if len(sample) else (0.0, 1.0)
    step = np.maximum(np.asarray(last) - first, np.finfo(np.float32).tiny) / (levels - 2)
    keys = np.empty(n, np.uint64)
    for start in range(0, n, _ROWS):
        run = slice(start, start + _ROWS)
        with np.errstate(all="ignore"):  # means that are not finite go to the first level
            places = np.clip((splats.means[run] - first) / step + 1.0, 0, levels - 1)
        keys[run] = interleave(np.nan_to_num(places).astype(np.uint32))
        workspace.trim()
    return keys


@called_with(
    "float32[:, ::1], float32[:, ::1], float32[::1], boolean[::1], float64[:, ::1], float64[::1], "
    "float64[::1], float64[::1], float64[::1], int64, int64, float64, int8[::1], float64[::1], "
    "float64[::1], int32[:, ::1]"
)
@kernel
def _locate(
    low: NDArray[np.float32],
    high: NDArray[np.float32],
    widest: NDArray[np.float32],
    plain: NDArray[np.bool_],
    rotation: F64,
    translation: F64,
    intrinsics: F64,
    variances: F64,
    pixel: F64,
    width: int,
    height: int,
    near_plane: float,
    kinds: NDArray[np.int8],
    nearest: F64,
    furthest: F64,
    pixels: NDArray[np.int32],
) -> None:
    """Compute the arrays of `BlockViews` for a camera."""
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    guard_x = GUARD * width / (2.0 * fx)
    guard_y = GUARD * height / (2.0 * fy)
    # Largest squared slopes to which `projection._project` clamps a mean's.
    slope_x = max(abs(-cx / fx - guard_x), abs((width - cx) / fx + guard_x)) ** 2
    slope_y = max(abs(-cy / fy - guard_y), abs((height - cy) / fy + guard_y)) ** 2
    added = variances[THICKNESS] + variances[FILTER]
    sized = len(pixel) > 0
    counted = not sized and variances[FILTER] == 0.0 and variances[THICKNESS] > _LEAST_THICKNESS
    r = rotation
    corner = np.empty(3, np.float64)
    for block in range(len(widest)):
        near, far = np.inf, -np.inf
        left, right, top, bottom = np.inf, -np.inf, np.inf, -np.inf
        size = 0.0
        for number in range(8):
            for k in range(3):
                corner[k] = float(high[block, k] if number >> k & 1 else low[block, k])
                size = max(size, abs(corner[k]))
            z = r[2, 0] * corner[0] + r[2, 1] * corner[1] + r[2, 2] * corner[2] + translation[2]
            x = r[0, 0] * corner[0] + r[0, 1] * corner[1] + r[0, 2] * corner[2] + translation[0]
            y = r[1, 0] * corner[0] + r[1, 1] * corner[1] + r[1, 2] * corner[2] + translation[1]
            near, far = min(near, z), max(far, z)
            px, py = fx * x / z + cx, fy * y / z + cy
            left, right = min(left, px), max(right, px)
            top, bottom = min(top, py), max(bottom, py)
        kinds[block] = EDGE
        pixels[block, LEFT], pixels[block, RIGHT] = 0, width
        pixels[block, TOP], pixels[block, BOTTOM] = 0, height
        if not size < np.inf:
            nearest[block], furthest[block] = -np.inf, np.inf
            continue
        margin = _MARGIN * (size + abs(translation[2]))
        near -= margin
        far += margin
        nearest[block], furthest[block] = near, far
        if far <= near_plane:
            kinds[block] = OUTSIDE
            continue
        # Pictures of corners bound those of the splats only where all corners are in front.
        if not near > 0.5 * near_plane:
            continue
        if sized:
            square = 0.0
            for k in range(3):
                away = max(abs(low[block, k] - pixel[k]), abs(high[block, k] - pixel[k]))
                square += away * away
            share = (pixel[3] * square + pixel[4]) * fx * fy / (near * near)
            added = variances[THICKNESS] * (1.0 + share) + PIXEL_VARIANCE
        ball = BALL * (1.0 + 1e-3) * math.exp(2.0 * widest[block]) / (near * near)
        reach_x = BALL_EDGE * math.sqrt(ball * fx * fx * (1.0 + slope_x) + added)
        reach_y = BALL_EDGE * math.sqrt(ball * fy * fy * (1.0 + slope_y) + added)
        error = _MARGIN * (width + height) + margin / near * max(fx, fy)
        inner = 0.5 + error
        if (
            counted
            and plain[block]
            and near > near_plane
            and left > inner
            and right < width - inner
            and top > inner
            and bottom < height - inner
            and max(reach_x, reach_y) < _FAR_REACH
        ):
            kinds[block] = INSIDE
        reach_x += slack(max(abs(left), abs(right)), reach_x) + error
        reach_y += slack(max(abs(top), abs(bottom)), reach_y) + error
        left, right, top, bottom = left - reach_x, right + reach_x, top - reach_y, bottom + reach_y
        if right <= 0.0 or left >= width or bottom <= 0.0 or top >= height:
            kinds[block] = OUTSIDE
            continue
        # Clamped as floats; what is no number leaves the whole picture.
        if left > 0.0:
            pixels[block, LEFT] = int(left)
        if right < width:
            pixels[block, RIGHT] = int(right) + 1
        if top > 0.0:
            pixels[block, TOP] = int(top)
        if bottom < height:
            pixels[block, BOTTOM] = int(bottom) + 1


def block_views(
    blocks: SplatBlocks, splats: Splats, camera: Camera, *, near_plane: float
) -> BlockViews:
    """Find where a camera sees the blocks of a scene.

    Parameters
    ----------
    blocks : SplatBlocks
        Blocks of the scene.
    splats : Splats
        The scene, for the kernel of ``splats.info``.
    camera : Camera
        Camera in the frame of the means.
    near_plane : float
        Camera-space depth up to which nothing is drawn, scene units.
    """
    count = len(blocks)
    kinds = np.empty(count, np.int8)
    nearest, furthest = np.empty(count, np.float64), np.empty(count, np.float64)
    pixels = np.empty((count, 4), np.int32)
    _locate(
        blocks.low, blocks.high, blocks.widest, blocks.plain,
        camera.rotation, camera.translation,
        np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float64),
        *view_kernel(splats, camera),
        camera.width, camera.height, float(near_plane),
        kinds, nearest, furthest, pixels,
    )  # fmt: skip
    return BlockViews(kinds, nearest, furthest, pixels)


@called_with("int32[::1], int64, float32[::1], int32[::1], int32[::1]")
@kernel
def _add_hidden(
    rows: NDArray[np.int32],
    block_splats: int,
    opacities: NDArray[np.float32],
    views: NDArray[np.int32],
    totals: NDArray[np.int32],
) -> None:
    """Add the number of views of each block to its splats that are not too transparent to draw."""
    for place in range(len(rows)):
        count = views[place // block_splats]
        if count > 0:
            i = rows[place]
            opacity = 1.0 / (1.0 + math.exp(-float(opacities[i])))
            if opacity >= ALPHA_MIN:
                totals[i] += count


def add_hidden(
    blocks: SplatBlocks,
    opacities: NDArray[np.float32],
    views: NDArray[np.int32],
    totals: NDArray[np.int32],
) -> None:
    """Count blocks `INSIDE` a picture as footprints of all their splats that can be drawn.

    Parameters
    ----------
    blocks : SplatBlocks
        Blocks of the scene.
    opacities : (N,) float32
        Opacities of the scene, logits.
    views : (B,) int32
        Number of views to count for each block.
    totals : (N,) int32
        Number of views that each splat's footprint reaches, increased in place.
    """
    _add_hidden(blocks.rows, BLOCK_SPLATS, opacities, views, totals)
