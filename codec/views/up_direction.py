"""Up direction of a scene: from its cameras, or from level surfaces with splats above."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.geometry.rotations import matrices, unit
from cogsplat.codec.trained_arrays import opacities_from_logits

from .low_discrepancy import even_directions
from .pose import level_axes
from .subsample import Subsample

F64 = NDArray[np.float64]

# Mean square of the cameras' right axes along the second direction below which all cameras have
# nearly the same heading (about 6° apart). Their right axes then say nothing of the pitch.
_LEAST_SPREAD: Final = 0.01
# Share of the spread of the right axes out of the horizontal plane, relative to that within it,
# above which the cameras roll too much to agree on a horizontal plane.
_MOST_ROLL: Final = 0.4
# Sine of the angle out of the horizontal plane from which on a camera's weight falls, and rounds of
# iterative reweighting.
_OUTLIER_SINE: Final = 0.03
_ROUNDS: Final = 10
# Length of the mean up axis below which the cameras point up in all directions.
_LEAST_MEAN: Final = 0.2

# Fewest splats from which surfaces are estimated.
_LEAST_SPLATS: Final = 50
# Quantile of the splats' areas at which areas are clipped: skies and blurred walls lie above.
_LARGEST: Final = 0.99
# Directions searched for planes, planes tried at most, and cosine of the least angle between two
# planes.
_DIRECTIONS: Final = 1200
_PLANES: Final = 6
_LEAST_APART: Final = math.cos(math.radians(20.0))
# Width of the Gaussian of angles between a plane and its splats' normals, radians: in the search,
# and in each round of refinement.
_PLANE_ANGLE: Final = math.radians(12.0)
_REFINEMENT_ANGLES: Final = (
    math.radians(15.0),
    math.radians(10.0),
    math.radians(6.0),
    math.radians(6.0),
)
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
# Penalty on the score of a direction that is far from the usual up, and the angles from which on it
# rises and is full, radians.
_NEAR, _FAR = math.radians(10.0), math.radians(35.0)
_FULL_PENALTY: Final = 0.4
# Cosine of the angle between a plane's normal and the usual up above which the scene is aligned
# with the axes of the format, and the factor on the score of the usual up in such a scene.
_ALIGNED: Final = math.cos(math.radians(8.0))
_ALIGNED_FACTOR: Final = 2.0
# Cosine of the angle between the usual up and its refinement above which the usual up is kept.
_EXACT: Final = math.cos(math.radians(1.0))


def up_from_cameras(cameras: Sequence[Camera], usual: F64) -> F64:
    """Return the up direction that cameras agree on.

    People hold cameras level: up is orthogonal to their right axes. Where the right axes do not
    show it, up is the mean of the cameras' up axes.

    Parameters
    ----------
    cameras : sequence of Camera
        At least one.
    usual : (3,) float64
        Unit vector against gravity by the axes of the format, for cameras that contradict each
        other.

    Returns
    -------
    (3,) float64
        Unit vector in the frame of the cameras.
    """
    rights = np.array([camera.rotation[0] for camera in cameras])
    mean = -np.mean([camera.rotation[1] for camera in cameras], axis=0)
    length = float(np.linalg.norm(mean))
    fallback = mean / length if length >= _LEAST_MEAN else usual
    values = np.linalg.eigvalsh(rights.T @ rights)
    if values[0] > _MOST_ROLL * values[1]:
        return fallback
    weights = np.ones(len(rights))
    for _ in range(_ROUNDS):
        values, vectors = np.linalg.eigh((rights * weights[:, None]).T @ rights / weights.sum())
        found: F64 = vectors[:, 0]
        weights = 1.0 / np.maximum(np.abs(rights @ found), _OUTLIER_SINE)
    if values[1] < _LEAST_SPREAD:
        # One heading: the mean up axis, made orthogonal to the right axis that all share.
        level = fallback - (fallback @ vectors[:, 2]) * vectors[:, 2]
        size = float(np.linalg.norm(level))
        return level / size if size > math.sqrt(_LEAST_SPREAD) else fallback
    towards = float(found @ fallback)
    return found if towards >= 0.0 else -found


def up_from_splats(scene: Subsample, core: F64, usual: F64) -> F64:
    """Return the up direction that a scene's splats show.

    Flat splats show surfaces. Candidates are the normals of the largest surfaces, and `usual`. A
    candidate scores by the area of its level surfaces and by the mass above them. Directions far
    from `usual` need a higher score.

    Parameters
    ----------
    scene : Subsample
        Scene.
    core : (6,) float64
        Bounding box without stray splats, scene units.
    usual : (3,) float64
        Unit vector against gravity by the axes of the format.

    Returns
    -------
    (3,) float64
        Unit vector in the frame of the means.
    """
    surface = _Surface.of(scene, core)
    if surface is None:
        return usual
    best, best_score = usual, surface.score(usual)
    planes = surface.normals_of_planes()
    if any(abs(float(normal @ usual)) > _ALIGNED for normal in planes):
        # Planes along the axes of the format: somebody has aligned the scene.
        refined = surface.refine(usual)
        if float(refined @ usual) < _EXACT:
            best = refined
        best_score *= _ALIGNED_FACTOR
    for normal in planes:
        for sign in (1.0, -1.0):
            refined = surface.refine(sign * normal)
            angle = math.acos(min(1.0, max(-1.0, float(refined @ usual))))
            score = surface.score(refined) - _penalty(angle)
            if score > best_score:
                best, best_score = refined, score
    return best


def _penalty(angle: float) -> float:
    """Return the penalty on a direction's score for its angle to the usual up, radians."""
    return _FULL_PENALTY * min(1.0, max(0.0, angle - _NEAR) / (_FAR - _NEAR))


@dataclass(frozen=True, eq=False)
class _Surface:
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
        Share of the area, weighted by opacity and by how thin the splat is: 0 for a sphere.
    """

    means: F64
    normals: F64
    mass: F64
    areas: F64
    flat: F64

    @classmethod
    def of(cls, scene: Subsample, core: F64) -> _Surface | None:
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
        return cls(means, normals, mass / mass.sum(), areas, areas * flat)

    def normals_of_planes(self) -> list[F64]:
        """Return the normals of the largest planes, by falling area."""
        directions = even_directions(_DIRECTIONS)
        directions = directions[directions[:, 2] >= 0.0]
        cosines = np.abs(directions @ self.normals.T)
        facing = np.exp(-np.square(np.arccos(np.minimum(cosines, 1.0)) / _PLANE_ANGLE)) @ self.flat
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

    def score(self, up: F64) -> float:
        """Return the score of an up direction: level area, and mass above the largest plane."""
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
        clutter = self.mass * (1.0 - level / self.areas)
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
