"""Surfaces of a scene, sampled by its splats: planes, and the mass above a plane."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.geometry.rotations import matrices, unit
from cogsplat.codec.geometry.sh import C0, COLOUR_OFFSET
from cogsplat.codec.trained_arrays import opacities_from_logits

from .low_discrepancy import even_directions
from .pose import level_axes
from .subsample import Subsample

F64 = NDArray[np.float64]

# Fewest splats from which surfaces are estimated.
_LEAST_SPLATS: Final = 50
# Quantile of the splats' areas at which areas are clipped: skies and blurred walls lie above.
_LARGEST: Final = 0.99
# Directions searched for planes, planes found at most, and cosine of the least angle between two
# planes.
_DIRECTIONS: Final = 1000
_PLANES: Final = 6
_LEAST_APART: Final = math.cos(math.radians(20.0))
# Cosines of normals are raised to the power 2^(1 + this) in the search for planes, which halves
# the weight at about 12°.
_SQUARINGS: Final = 4
# Width of the Gaussian of angles between a plane and its splats' normals, radians: in a score, and
# in each round of refinement.
_PLANE_ANGLE: Final = math.radians(12.0)
_REFINEMENT_ANGLES: Final = (
    math.radians(15.0),
    math.radians(10.0),
    math.radians(6.0),
    math.radians(6.0),
)
# Thickness below which a scene is a sheet, as a share of its size; both root mean square.
_SHEET: Final = 0.01
# Histograms of heights from -1 to 1: bin size, in half diagonals of the core box, and bins.
_STEP: Final = 0.025
_STEPS: Final = 80
# Mass added to the denominator when the masses above and below a plane are compared. It lowers the
# score of a plane that holds nearly all mass itself.
_OWN_SHARE: Final = 0.1
# Weights in a direction's score: of the largest level plane with mass above, and of all level area.
_GROUND, _LEVEL = 4.0, 2.0
# Quantiles of the heights of mass outside level surfaces that count as its bottom and its top.
_ENDS: Final = (0.03, 0.97)
# Cells across the core box in which a plane and the mass above it are compared.
_CELLS: Final = 24
# Reciprocal of the share of area that is not level from which on level area counts in full.
_OTHERS: Final = 5.0
# Weights of the colour channels in brightness.
_LUMA: Final = np.array([0.3, 0.6, 0.1])


@dataclass(frozen=True, eq=False)
class Surfaces:
    """Splats of a scene as samples of its surfaces.

    Parameters
    ----------
    means : (n, 3) float64
        Positions relative to the middle of the core box, in half diagonals of it.
    normals : (n, 3) float64
        Shortest axis of each splat.
    mass : (n,) float64
        Share of the scene's splats, weighted by opacity.
    areas : (n,) float64
        Share of the area, weighted by opacity.
    flat : (n,) float64
        Share of the area, weighted by opacity and by how thin the splat is: 0 for a sphere or a
        needle.
    light : (n,) float64
        Brightness of each splat, 0 to 1.
    """

    means: F64
    normals: F64
    mass: F64
    areas: F64
    flat: F64
    light: F64

    @classmethod
    def of(cls, scene: Subsample, core: F64) -> Surfaces | None:
        """Return the surfaces within the core box; None if there are too few splats."""
        splats = scene.splats
        means = splats.means.astype(np.float64)
        inside = ((means >= core[:3]) & (means <= core[3:])).all(axis=1)
        if inside.sum() < _LEAST_SPLATS:
            return None
        means = means[inside]
        log_scales = np.clip(splats.scales[inside].astype(np.float64), -40.0, 40.0)
        order = np.argsort(log_scales, axis=1)
        thin, middle, large = np.take_along_axis(log_scales, order, axis=1).T
        axes = matrices(unit(splats.quats[inside])).astype(np.float64)
        normals = np.take_along_axis(axes, order[:, None, :1], axis=2)[:, :, 0]
        opacity = opacities_from_logits(splats.opacities[inside])
        log_areas = middle + large
        areas = opacity * np.exp(np.minimum(log_areas, np.quantile(log_areas, _LARGEST)))
        if not areas.sum() > 0.0:
            return None
        flat = np.square(1.0 - np.exp(thin - middle))
        half = 0.5 * float(np.linalg.norm(core[3:] - core[:3])) or 1.0
        areas = areas / areas.sum()
        mass = opacity * scene.counts[inside]
        means = (means - 0.5 * (core[:3] + core[3:])) / half
        light = (
            np.clip(COLOUR_OFFSET + C0 * splats.sh0[inside].astype(np.float64), 0.0, 1.0) @ _LUMA
        )
        return cls(means, normals, mass / mass.sum(), areas, areas * flat, light)

    def sample(self, count: int) -> Surfaces:
        """Return about `count` of the splats, evenly drawn; shares are of the sample."""
        step = max(1, len(self.means) // count)
        rows = slice(step // 2, None, step)
        mass, areas = self.mass[rows], self.areas[rows]
        total = float(areas.sum()) or 1.0
        return Surfaces(
            self.means[rows], self.normals[rows], mass / (float(mass.sum()) or 1.0),
            areas / total, self.flat[rows] / total, self.light[rows],
        )  # fmt: skip

    def is_sheet(self) -> bool:
        """Return whether the scene is a single plane, such as a painting."""
        offsets = self.means - self.areas @ self.means
        spread = np.linalg.eigvalsh((offsets * self.areas[:, None]).T @ offsets)
        return bool(spread[0] <= _SHEET**2 * spread.sum())

    def normals_of_planes(self) -> list[F64]:
        """Return the normals of the largest planes, by falling area."""
        directions = even_directions(_DIRECTIONS)
        directions = directions[directions[:, 2] >= 0.0]
        facing = np.square(directions @ self.normals.T)
        for _ in range(_SQUARINGS):
            np.square(facing, out=facing)
        facing = facing @ self.flat
        found: list[F64] = []
        while len(found) < _PLANES and facing.max() > 0.0:
            row = int(facing.argmax())
            found.append(directions[row])
            facing[np.abs(directions @ directions[row]) > _LEAST_APART] = 0.0
        return found

    def refine(self, up: F64) -> F64:
        """Return the direction near `up` most orthogonal to floors and most parallel to walls."""
        for angle in _REFINEMENT_ANGLES:
            cosines = self.normals @ up
            level = self.flat * np.exp(
                -np.square(np.arccos(np.minimum(np.abs(cosines), 1.0)) / angle)
            )
            upright = self.flat * np.exp(
                -np.square(np.arcsin(np.minimum(np.abs(cosines), 1.0)) / angle)
            )
            weights = level - upright
            values, vectors = np.linalg.eigh((self.normals * weights[:, None]).T @ self.normals)
            found: F64 = vectors[:, 2] * np.sign(vectors[:, 2] @ up)
            if values[2] <= 0.0 or float(found @ up) < _LEAST_APART:
                return up
            up = found
        return up

    def level_score(self, up: F64) -> float:
        """Return the score of an up direction, by level area and its most extended plane.

        The plane is the level one with most area and mass on it; other mass that lies low adds.
        """
        cosines = np.minimum(np.abs(self.normals @ up), 1.0)
        level = self.flat * np.exp(-np.square(np.arccos(cosines) / _PLANE_ANGLE))
        heights = self.means @ up
        rows = np.clip(((heights + 1.0) / _STEP).astype(np.int64), 0, _STEPS - 1)
        planes = np.bincount(rows, level, _STEPS)
        planes = planes + np.roll(planes, 1)
        mass = np.bincount(rows, self.mass, _STEPS)
        # Mass below and above each plane, without a slab of two bins on each side of it.
        total = np.concatenate([[0.0], np.cumsum(mass)])
        below = total[np.maximum(np.arange(_STEPS) - 2, 0)]
        above = total[-1] - total[np.minimum(np.arange(_STEPS) + 2, _STEPS)]
        rests = (above - below) / (above + below + _OWN_SHARE)
        grounds = planes * np.maximum(rests, 0.0)
        row = int(grounds.argmax())
        slab = (rows >= row - 1) & (rows <= row) & (level > 0.5 * self.flat)
        ground = float(grounds[row]) * self._supported_share(up, slab, rows > row + 1)
        clutter = self.mass * (1.0 - level / np.maximum(self.areas, 1e-300))
        order = np.argsort(heights, kind="stable")
        ends = np.searchsorted(np.cumsum(clutter[order]), np.array(_ENDS) * clutter.sum())
        low, high = heights[order[np.minimum(ends, len(order) - 1)]]
        share = np.clip((heights - low) / (high - low + 1e-12), 0.0, 1.0)
        lean = 1.0 - 2.0 * float(clutter @ share) / float(clutter.sum())
        # The normal of a lone plane, such as a painting, is no evidence of up.
        lone = min(1.0, _OTHERS * (1.0 - float(level.sum() / self.flat.sum())))
        found = (_GROUND * ground + _LEVEL * float(level.sum()) * lone) * (1.0 + lean)
        return float(found)

    def _supported_share(self, up: F64, slab: NDArray[np.bool_], above: NDArray[np.bool_]) -> float:
        """Return the share of the mass above a plane that lies over covered cells of the plane.

        Parameters
        ----------
        up : (3,) float64
            Normal of the plane, a unit vector.
        slab : (n,) bool
            Splats of the plane.
        above : (n,) bool
            Splats above the plane.
        """
        flat = self.means @ np.stack(level_axes(up), axis=1)
        cells = np.clip(((flat + 1.0) * (0.5 * _CELLS)).astype(np.int64), 0, _CELLS - 1)
        cell = cells[:, 0] * _CELLS + cells[:, 1]
        covered = np.bincount(cell[slab], minlength=_CELLS * _CELLS) > 0
        mass = float(self.mass[above].sum())
        return float(self.mass[above & covered[cell]].sum()) / mass if mass > 0.0 else 0.0
