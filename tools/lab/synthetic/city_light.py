"""Light in a synthetic city: shadows by height map, and splats with their light baked in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.geometry import sh
from cogsplat.codec.splats import Splats, sh_coefficients

from .city_plan import BLOCK_SIDE, Block, Roof
from .lighting import (
    BOUNCE_COLOUR,
    SKY_COLOUR,
    SUN_COLOUR,
    SUN_DIRECTION,
    TO_SCENE,
    highlights,
)

F32 = NDArray[np.float32]

# Cells of the height maps per metre, and the band around a block that its maps cover, metres.
_FINE: Final = 2
_BAND: Final = 12.0

# Distance in which the sun falls by the height of the highest tower, metres.
_REACH: Final = 60.0

# Light that the crown of a tree keeps off.
_CROWN_SHADE: Final = 0.7

_BLOCK: Final = 8192


@dataclass(frozen=True, eq=False)
class Elements:
    """n splats before they are lit, y up, linear colours.

    Parameters
    ----------
    points : (n, 3) float32
        Centres in the block, metres.
    frames : (n, 4) float32
        Unit quaternions, wxyz, that turn x, y, z to the axes of `sizes`.
    sizes : (n, 3) float32
        Standard deviations, metres.
    normals : (n, 3) float32
        Directions that the surface faces.
    albedo : (n, 3) float32
        Diffuse reflectance.
    opacities_unit : (n,) float32
    gloss : float
        Brightness of the highlight.
    spread : float
        Width of the highlight; see `Surfels`.
    offset : float
        Distance along the normal at which light is looked up, metres.
    """

    points: F32
    frames: F32
    sizes: F32
    normals: F32
    albedo: F32
    opacities_unit: F32
    gloss: float = 0.0
    spread: float = 0.2
    offset: float = 0.3

    def take(self, rows: NDArray[np.int64] | slice) -> Elements:
        """Return a selection of rows."""
        return Elements(
            self.points[rows],
            self.frames[rows],
            self.sizes[rows],
            self.normals[rows],
            self.albedo[rows],
            self.opacities_unit[rows],
            self.gloss,
            self.spread,
            self.offset,
        )


@dataclass(frozen=True, eq=False)
class LightMap:
    """Heights of shadow and of surroundings over a block.

    Parameters
    ----------
    shadow, crowns : (k, k) float32
        Height below which houses, and crowns of trees, keep the sun off; by x, then z.
    around : (k, k) float32
        Mean height of the houses around a point.
    built : (k, k) bool
        Whether a house stands on a point.
    """

    shadow: F32
    crowns: F32
    around: F32
    built: NDArray[np.bool_]

    def cells(self, x: F32, z: F32) -> NDArray[np.intp]:
        """Return the cells of points as indices into the flattened maps."""
        last = self.shadow.shape[0] - 1
        i = np.clip((x + np.float32(_BAND)) * np.float32(_FINE), 0, last).astype(np.intp)
        j = np.clip((z + np.float32(_BAND)) * np.float32(_FINE), 0, last).astype(np.intp)
        result: NDArray[np.intp] = i * self.shadow.shape[1] + j
        return result


def light_map(around: list[tuple[float, float, Block]]) -> LightMap:
    """Return the map of a block from the blocks around it, with the offsets of their corners."""
    low = -_BAND - _REACH
    size = round((BLOCK_SIDE - 2.0 * low) * _FINE)
    heights, crowns = (np.zeros((size, size), np.float32) for _ in range(2))
    grid = (np.arange(size, dtype=np.float32) + 0.5) / _FINE + np.float32(low)
    for x, z, block in around:
        for box in block.boxes:
            columns = slice(*np.searchsorted(grid, (box.x0 + x, box.x1 + x)).tolist())
            rows = slice(*np.searchsorted(grid, (box.z0 + z, box.z1 + z)).tolist())
            part = heights[columns, rows]
            top = np.full(part.shape, box.y1, np.float32)
            if box.roof is not Roof.FLAT:
                across = grid[rows][None, :] - z if box.roof is Roof.RIDGE_X else 0.0
                if box.roof is Roof.RIDGE_X:
                    half, middle = 0.5 * (box.z1 - box.z0), 0.5 * (box.z0 + box.z1)
                else:
                    across = grid[columns][:, None] - x
                    half, middle = 0.5 * (box.x1 - box.x0), 0.5 * (box.x0 + box.x1)
                top += 0.75 * (half - np.abs(across - middle))
            np.maximum(part, top, out=part)
        for tree in block.trees:
            reach = tree.radius
            columns = slice(*np.searchsorted(grid, (tree.x + x - reach, tree.x + x + reach)))
            rows = slice(*np.searchsorted(grid, (tree.z + z - reach, tree.z + z + reach)))
            part = crowns[columns, rows]
            away = np.hypot(
                grid[columns][:, None] - (tree.x + x), grid[rows][None, :] - (tree.z + z)
            )
            top = np.where(away < reach, tree.middle + 0.4 * reach, 0.0).astype(np.float32)
            np.maximum(part, top, out=part)
    pad = round(_REACH * _FINE)
    inner = slice(pad, size - pad)
    return LightMap(
        _shadow(heights, pad, round(_REACH * _FINE)),
        _shadow(crowns, pad, 14 * _FINE),
        _blurred(heights, 8 * _FINE)[inner, inner],
        heights[inner, inner] > 0.0,
    )


def _shadow(heights: F32, pad: int, steps: int) -> F32:
    """Return the height below which the sun is hidden, for the inner cells of a map."""
    lx, ly, lz = SUN_DIRECTION.tolist()
    ground = float(np.hypot(lx, lz))
    size = heights.shape[0] - 2 * pad
    highest = np.zeros((size, size), np.float32)
    for step in range(steps):
        i, j = pad + round(step * lx / ground), pad + round(step * lz / ground)
        seen = heights[i : i + size, j : j + size] - np.float32(step / _FINE * ly / ground)
        np.maximum(highest, seen, out=highest)
    return highest


def _blurred(values: F32, reach: int) -> F32:
    """Return means over squares of 2 reach + 1 cells."""
    for axis in (0, 1):
        padded = np.concatenate(
            [
                np.zeros_like(values.take([0], axis)),
                np.cumsum(
                    np.pad(
                        values,
                        [(reach, reach) if a == axis else (0, 0) for a in (0, 1)],
                        mode="edge",
                    ),
                    axis=axis,
                    dtype=np.float64,
                ),
            ],
            axis=axis,
        )
        length = values.shape[axis]
        width = 2 * reach + 1
        upper = padded.take(np.arange(width, width + length), axis)
        values = ((upper - padded.take(np.arange(length), axis)) / width).astype(np.float32)
    return values


def bake_elements(
    elements: Elements,
    maps: LightMap,
    out: Splats,
    corner: tuple[float, float],
    rng: np.random.Generator,
    noise: list[np.random.Generator],
) -> None:
    """Write the splats of elements, lit by the map of their block.

    Parameters
    ----------
    elements : Elements
        n elements.
    maps : LightMap
        Light of their block.
    out : Splats
        n splats, which are overwritten.
    corner : tuple of float
        Place of the block in the city, x and z.
    rng : numpy.random.Generator
        Source of the order of axes and of the norms of quaternions.
    noise : list of numpy.random.Generator
        Source for each SH band above 0 of the noise that training leaves: with a generator of its
        own, a band has the same noise whatever the degree.
    """
    shift = np.array([corner[0], 0.0, corner[1]], np.float32)
    for start in range(0, len(elements.points), _BLOCK):
        part = elements.take(slice(start, start + _BLOCK))
        rows = out.take(slice(start, start + _BLOCK))
        _bake_block(part, maps, rows, noise)
        _orient(part, rows, rng)
        rows.means[:] = (part.points + shift) * TO_SCENE.astype(np.float32)


def _bake_block(
    part: Elements, maps: LightMap, out: Splats, noise: list[np.random.Generator]
) -> None:
    """Write colours and opacities of a block of elements."""
    n = len(part.points)
    normals, y = part.normals, part.points[:, 1]
    aside = part.points + normals * np.float32(part.offset)
    cells = maps.cells(aside[:, 0], aside[:, 2])
    sunlit = _ramp((y - maps.shadow.ravel()[cells]) * np.float32(1.4) + np.float32(0.3))
    sunlit *= 1.0 - np.float32(_CROWN_SHADE) * (1.0 - _ramp(y - maps.crowns.ravel()[cells] + 1.0))
    over = np.maximum(maps.around.ravel()[cells] - y, np.float32(0.0))
    open_sky = 1.0 / (1.0 + np.float32(0.11) * over)
    lx, ly, lz = SUN_DIRECTION.astype(np.float32)
    facing = normals[:, 0] * lx + normals[:, 1] * ly + normals[:, 2] * lz
    sun = np.maximum(facing, np.float32(0.0)) * sunlit
    up = np.float32(0.5) + np.float32(0.5) * normals[:, 1]
    shown = np.empty((n, 3), np.float32)
    for channel in range(3):
        bounce, sky = np.float32(BOUNCE_COLOUR[channel]), np.float32(SKY_COLOUR[channel])
        light = (bounce + up * (sky - bounce)) * open_sky
        light += np.float32(SUN_COLOUR[channel]) * sun
        shown[:, channel] = np.sqrt(-np.expm1(-part.albedo[:, channel] * light))
    out.sh0[:] = (shown - np.float32(0.5)) * np.float32(1.0 / sh.C0)
    # Noise that training leaves in the higher bands, mostly brightness, which the channels share.
    faint = 1.0 - part.opacities_unit
    sigma = np.float32(0.012) + np.float32(0.05) * faint * faint
    for band in range(1, out.sh_degree + 1):
        rows = slice(sh_coefficients(band - 1) - 1, sh_coefficients(band) - 1)
        count = 2 * band + 1
        drawn = noise[band - 1].standard_normal((n, count, 4), dtype=np.float32)
        drawn *= sigma[:, None, None]
        out.shN[:, rows] = np.float32(0.6) * drawn[:, :, :3] + np.float32(0.8) * drawn[:, :, 3:]
    if part.gloss:
        shine = highlights(
            normals.astype(np.float64),
            shown.astype(np.float64),
            np.full((n, 3), part.gloss),
            np.full(n, part.spread),
            sunlit.astype(np.float64),
            open_sky.astype(np.float64),
        )
        out.sh0[:] += shine[:, 0]
        out.shN[:] += shine[:, 1 : 1 + out.shN.shape[1]]
    out.opacities[:] = np.log(part.opacities_unit / faint)


def _orient(part: Elements, out: Splats, rng: np.random.Generator) -> None:
    """Write quaternions of any norm and log scales, with the thin axis at any of three places."""
    w, x, y, z = part.frames.T
    # Half a turn about x leads from y up to the axes of the scene.
    turned = np.stack([-x, w, -z, y], axis=1)
    norm = np.float32(0.6) + rng.random(len(w), dtype=np.float32)
    turned *= (norm * np.where(rng.random(len(w), dtype=np.float32) < 0.5, 1, -1))[:, None]
    sizes = np.log(part.sizes)
    for first in range(3):
        rows = slice(first, None, 3)
        for axis in range(3):
            out.scales[rows, axis] = sizes[rows, (first + axis) % 3]
        w, x, y, z = turned[rows].T
        if first == 0:
            out.quats[rows] = turned[rows]
            continue
        # A third of a turn about (1, 1, 1), forwards or back, renames the axes.
        s = np.float32(0.5 if first == 1 else -0.5)
        h = np.float32(0.5)
        out.quats[rows] = np.stack(
            [
                h * w - s * (x + y + z),
                h * x + s * (w + y - z),
                h * y + s * (w - x + z),
                h * z + s * (w + x - y),
            ],
            axis=1,
        )


def _ramp(values: F32) -> F32:
    """Return a smooth ramp from 0 at 0 to 1 at 1."""
    t = np.clip(values, np.float32(0.0), np.float32(1.0))
    result: F32 = t * t * (np.float32(3.0) - np.float32(2.0) * t)
    return result
