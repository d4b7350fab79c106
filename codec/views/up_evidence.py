"""Evidence for the up direction of a scene: shape, symmetry, shading, and what the scene stands on.

An axis is upright if surfaces are parallel or orthogonal to it, and if planes through it mirror the
scene. Of its two directions, up has the wide base below, light from above, and mass on its ground.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from .low_discrepancy import even_directions
from .pose import level_axes
from .surfaces import Surfaces

F64 = NDArray[np.float64]

# Splats of the sample.
_SAMPLED: Final = 1500
# Candidates closer than this to a better one are left out: cosine of 1.5°.
_SAME: Final = math.cos(math.radians(1.5))
# Resting faces: directions searched, cosine of their least angle to each other, faces tried, and
# the share of the splats that may lie below a face.
_DIRECTIONS: Final = even_directions(1000)
_APART: Final = math.cos(math.radians(14.0))
_FACES: Final = 6
_STRAY: Final = 0.004
# Mirrors: directions of their normals, and the sine of the angle to an axis within which a mirror
# contains the axis.
_MIRRORS: Final = np.array([d for d in even_directions(800) if d[2] >= 0.0])
_CONTAINS: Final = math.sin(math.radians(5.0))
# Density for mirrors: cells across, and half the width, in root mean square radii.
_CELLS, _REACH = 20, 3.0
# Angle of a normal to an axis, or to the plane across it, at which a surface's weight is 1 / e.
_ALIGNED: Final = math.radians(10.0)
# Share of the height at each end that is base or top, and azimuths of their reach.
_END: Final = 0.05
_AZIMUTHS: Final = 24
# Softening length in votes for the outer side of a surface, root mean square radii.
_SOFT: Final = 0.05
# Least standard deviation of brightness: evenly lit scenes show no direction of light.
_LEAST_LIGHT: Final = 0.03

# Weights, fitted by maximum likelihood of the true direction among the candidates, in some 250 made
# objects of 33 families (furniture, vehicles, people, animals, plants, buildings, rooms, ...), and
# checked on families that were left out: 67 % of the objects come upright within 6°.
_WALLS, _LEVEL, _SYMMETRY, _TALL = 12.0, 24.0, 44.0, -2.6
_FOOTING, _BASE, _TOP, _LIGHT, _LOW = 6.2, 2.1, -1.0, 3.5, -7.1
_GROUND: Final = 3.0
# Share of level flat area below which a direction has no ground worth scoring.
_LEAST_LEVEL_SHARE: Final = 0.04
# Bounds of the least reach of the base: an object that leans over its base by more still leans.
_LEAST_FOOTING, _MOST_FOOTING = -0.3, 0.4


@dataclass(frozen=True, eq=False)
class UpEvidence:
    """Sampled splats in which up directions are scored.

    Parameters
    ----------
    surfaces : Surfaces
        Sample of the scene's surfaces.
    means : (n, 3) float64
        Positions relative to the centre of the area, in root mean square radii.
    flat : (n,) float64
        `Surfaces.flat`, divided by its sum.
    shading : (3,) float64
        Slope of the brightness by each component of the outer normals, in standard deviations of
        the brightness.
    mirrors : (m,) float64
        Overlap of the scene with its mirror image for each normal of `_MIRRORS`, 0 to 1.
    """

    surfaces: Surfaces
    means: F64
    flat: F64
    shading: F64
    mirrors: F64

    @classmethod
    def of(cls, scene: Surfaces) -> UpEvidence:
        """Sample a scene and measure its symmetry and shading."""
        surfaces = scene.sample(_SAMPLED)
        means = surfaces.means - surfaces.areas @ surfaces.means
        means = means / (math.sqrt(float(surfaces.areas @ np.square(means).sum(axis=1))) or 1.0)
        flat = surfaces.flat / (float(surfaces.flat.sum()) or 1.0)
        shading = _shading(surfaces, means, flat)
        return cls(surfaces, means, flat, shading, _mirror_overlaps(means, surfaces.areas))

    def candidates(self, usual: F64) -> F64:
        """Return directions that may be up, each with its opposite next to it; `usual` first.

        They are the principal axes of the normals and of the positions, the normals of planes, the
        faces on which the scene could stand, and refinements of these.
        """
        normals, areas = self.surfaces.normals, self.surfaces.areas[:, None]
        found = [usual]
        for vectors, weights in ((normals, self.flat[:, None]), (self.means, areas)):
            found.extend(np.linalg.eigh((vectors * weights).T @ vectors)[1].T)
        found.extend([*self.surfaces.normals_of_planes(), *self._resting_faces()])
        kept = np.zeros((0, 3))
        for axis in found:
            tried = (axis,) if axis is usual else (axis, self.surfaces.refine(axis))
            for one in tried:
                if not (np.abs(kept @ one) > _SAME).any():
                    kept = np.concatenate([kept, [one, -one]])
        return kept

    def _resting_faces(self) -> F64:
        """Return the up directions in which the centre of the area is lowest, the lowest first."""
        part = self.means[::2]
        row = min(len(part) - 1, int(_STRAY * len(part)) + 1)
        heights = -np.partition(part @ _DIRECTIONS.T, row, axis=0)[row]
        found: list[F64] = []
        for row in np.argsort(heights, kind="stable"):
            direction = _DIRECTIONS[row]
            near = _DIRECTIONS @ direction > _APART
            if heights[row] <= heights[near].min():
                found.append(direction)
            if len(found) == _FACES:
                break
        return np.array(found)

    def scores(self, candidates: F64) -> tuple[F64, F64]:
        """Score candidates: log likelihoods, but for a constant.

        Parameters
        ----------
        candidates : (2m, 3) float64
            Result of `candidates`.

        Returns
        -------
        (scores, levels) : (2m,) float64, (2m,) float64
            Scores, and `Surfaces.level_score` of each direction; 0 where little area is level.
        """
        axes = candidates[::2]
        angles = np.arccos(np.minimum(np.abs(self.surfaces.normals @ axes.T), 1.0))
        level = self.flat @ np.exp(-np.square(angles / _ALIGNED))
        walls = self.flat @ np.exp(-np.square((0.5 * math.pi - angles) / _ALIGNED))
        light = axes @ self.shading
        scores, levels = np.empty(len(candidates)), np.empty(len(candidates))
        for row, axis in enumerate(axes):
            both = [0.0, 0.0]
            if level[row] >= _LEAST_LEVEL_SHARE:
                both = [self.surfaces.level_score(axis), self.surfaces.level_score(-axis)]
            ground = _GROUND * min(1.0, max(-1.0, both[0] - both[1]))
            upright = _WALLS * walls[row] + _LEVEL * level[row] + _SYMMETRY * self._symmetry(axis)
            tall, low, (least, mean), (top_least, top_mean) = self._stance(axis)
            upright += _TALL * tall
            signed = _LIGHT * light[row] + _LOW * low + ground
            upwards = _FOOTING * _bounded(least) + _BASE * mean + _TOP * top_mean
            downwards = _FOOTING * _bounded(top_least) + _BASE * top_mean + _TOP * mean
            scores[2 * row : 2 * row + 2] = upright + signed + upwards, upright - signed + downwards
            levels[2 * row : 2 * row + 2] = both
        return scores, levels

    def _symmetry(self, axis: F64) -> float:
        """Return the mean overlap of the best third of the mirrors that contain an axis."""
        overlaps = np.sort(self.mirrors[np.abs(_MIRRORS @ axis) < _CONTAINS])
        return float(overlaps[-max(1, len(overlaps) // 3) :].mean())

    def _stance(self, axis: F64) -> tuple[float, float, tuple[float, float], tuple[float, float]]:
        """Measure a scene along an axis: height, centre of its area, and reach of both ends.

        Returns
        -------
        tall : float
            Logarithm of height by width, 0 for a flat scene.
        low : float
            Height of the middle over the centre of the area, as a share of the height.
        base, top : (float, float)
            Least and mean over azimuths of the horizontal reach of each end, as shares of the
            scene's own reach; the centre of the area lies outside the end where the least reach is
            negative.
        """
        heights = self.means @ axis
        flat = self.means @ np.stack(level_axes(axis), axis=1)
        turns = np.linspace(0.0, 2.0 * math.pi, _AZIMUTHS, endpoint=False)
        reaches = flat @ np.stack([np.cos(turns), np.sin(turns)])
        stray = int(_STRAY * len(heights))
        ordered = np.sort(heights)
        bottom, top = float(ordered[stray]), float(ordered[-1 - stray])
        height = max(top - bottom, 1e-12)
        part = reaches[::2]
        third = max(0, len(part) - 3)
        whole = np.maximum(np.partition(part, third, axis=0)[third], 0.05)
        ends = []
        for end in (heights < bottom + _END * height, heights > top - _END * height):
            shares = np.clip(reaches[end].max(axis=0, initial=-np.inf) / whole, -1.0, 1.0)
            ends.append((float(shares.min()), float(shares.mean())))
        areas = self.surfaces.areas
        width = math.sqrt(0.5 * float(areas @ np.square(flat).sum(axis=1))) + 1e-12
        tall = math.sqrt(float(areas @ np.square(heights))) / width
        return math.log(max(tall, 1.0)), 0.5 + bottom / height, ends[0], ends[1]


def _bounded(least: float) -> float:
    """Return the least reach of a base within its bounds."""
    return min(_MOST_FOOTING, max(_LEAST_FOOTING, least))


def _shading(surfaces: Surfaces, means: F64, flat: F64) -> F64:
    """Return the linear dependence of brightness on outer normals, (3,).

    The outer side of a surface is the side with less area near it.
    """
    part, areas = means[::5], surfaces.areas[::5]
    ahead = part @ surfaces.normals.T - (means * surfaces.normals).sum(axis=1)
    squares = np.square(part).sum(axis=1)[:, None] + np.square(means).sum(axis=1)
    squares = np.maximum(squares - 2.0 * part @ means.T, 0.0)
    votes = areas @ (ahead / (np.sqrt(squares) + _SOFT) / (_SOFT + squares))
    outer = np.column_stack(
        [surfaces.normals * np.where(votes > 0.0, -1.0, 1.0)[:, None], np.ones(len(means))]
    )
    offsets = surfaces.light - float(flat @ surfaces.light)
    spread = math.sqrt(float(flat @ np.square(offsets)))
    weighted = outer * flat[:, None]
    slopes = np.linalg.solve(weighted.T @ outer + 1e-3 * np.eye(4), weighted.T @ offsets)
    return np.asarray(slopes[:3] / (spread + _LEAST_LIGHT), np.float64)


def _mirror_overlaps(means: F64, areas: F64) -> F64:
    """Return the overlap of the scene with its image in each mirror through its centre."""

    def cells(points: F64) -> NDArray[np.int64]:
        rows = np.clip((points + _REACH) * (0.5 * _CELLS / _REACH), 0, _CELLS - 1).astype(np.int64)
        return np.asarray((rows[..., 0] * _CELLS + rows[..., 1]) * _CELLS + rows[..., 2])

    total = np.bincount(cells(means), areas, _CELLS**3)
    density: F64 = total.astype(np.float64).reshape(_CELLS, _CELLS, _CELLS)
    for axis in range(3):
        density = 0.5 * density + 0.25 * (np.roll(density, 1, axis) + np.roll(density, -1, axis))
    smooth = np.sqrt(density).ravel()
    part, weights = means[::2], areas[::2]
    here = smooth[cells(part)]
    offsets = 2.0 * part @ _MIRRORS.T
    overlaps = [
        float(weights @ np.minimum(smooth[cells(part - offset[:, None] * mirror)], here))
        for offset, mirror in zip(offsets.T, _MIRRORS, strict=True)
    ]
    return np.array(overlaps) / max(float(weights @ here), 1e-300)
