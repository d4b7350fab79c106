"""Surfels of the synthetic scenes, with their sizes, opacities and materials."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .patches import Patch, dot, join_patches, unit

F64 = NDArray[np.float64]
Colour = tuple[float, float, float]

# Standard deviation of a surface splat divided by the distance to its neighbours. The smallest
# value without holes.
COVER = 0.79


@dataclass(frozen=True, eq=False)
class Surfels:
    """n surface elements (surfels) with their materials, y up, linear colours.

    Parameters
    ----------
    patch : Patch
        Positions, normals and tangents.
    sizes : (n, 3) float64
        Standard deviations along tangent, bitangent and normal, scene units.
    albedo : (n, 3) float64
        Diffuse reflectance, or emitted light where `glow` is 1.
    gloss : (n, 3) float64
        Brightness of the highlight, display space.
    spread : (n,) float64
        Width of the highlight: decay of band l is exp(-l(l+1)·spread).
    opacities_unit : (n,) float64
        Opacity in (0, 1).
    glow : (n,) float64
        1 for self-luminous surfels such as the sky, else 0.
    """

    patch: Patch
    sizes: F64
    albedo: F64
    gloss: F64
    spread: F64
    opacities_unit: F64
    glow: F64

    def take(self, rows: NDArray[np.integer] | slice) -> Surfels:
        """Return a selection of rows."""
        return Surfels(
            self.patch.take(rows),
            self.sizes[rows],
            self.albedo[rows],
            self.gloss[rows],
            self.spread[rows],
            self.opacities_unit[rows],
            self.glow[rows],
        )


@dataclass(frozen=True, eq=False)
class Edges:
    """Nearest edge of a tile, stripe or beam for each splat, which the splat does not cross.

    Parameters
    ----------
    distance : (n,) float64
        Distance to the edge, scene units; infinite without an edge.
    along : (n, 3) float64
        Unit vectors along the edge.
    """

    distance: F64
    along: F64

    @classmethod
    def none(cls, patch: Patch) -> Edges:
        """Return the edges of a patch without edges: infinite distances."""
        return cls(np.full(len(patch.points), np.inf), patch.tangents)

    def nearer(self, distance: F64, along: F64) -> Edges:
        """Return per splat the nearer of its edge and another edge."""
        closer = distance < self.distance
        along = np.broadcast_to(along, self.along.shape)
        return Edges(
            np.where(closer, distance, self.distance),
            np.where(closer[:, None], along, self.along),
        )


def split_count(n: int, weights: Sequence[float]) -> list[int]:
    """Split a count in proportion to weights: integers that sum to n, by largest remainder."""
    exact = np.array(weights) * (n / sum(weights))
    counts = np.floor(exact).astype(int)
    order = np.argsort(counts - exact, kind="stable")
    counts[order[: n - int(counts.sum())]] += 1
    return [int(count) for count in counts]


def cover(
    patch: Patch,
    rng: np.random.Generator,
    albedo: F64 | Colour,
    gloss: F64 | Colour | float = 0.0,
    spread: float = 0.2,
    glow: F64 | float = 0.0,
    edges: Edges | None = None,
) -> Surfels:
    """Return flat surfels that cover a patch, with sizes and opacities as in trained scenes.

    Parameters
    ----------
    patch : Patch
        Surface with n points.
    rng : numpy.random.Generator
        Source of sizes, opacities and rotations.
    albedo, gloss, spread, glow
        See `Surfels`; a single value applies to every surfel.
    edges : Edges, optional
        Surfels near an edge are narrowed and aligned with it.

    Returns
    -------
    Surfels
        n surfels; sizes are log-normal, and one surfel in eight is faint.
    """
    n = len(patch.points)
    full = COVER * np.sqrt(patch.areas)
    edges = edges or Edges.none(patch)
    width = np.clip(0.5 * edges.distance + 0.002, 0.4 * full, full)
    held = width < 0.95 * full
    length = np.where(held, 1.15 * full, full)
    # Surfels at an edge vary less, so that they do not cross it.
    vary = np.where(held, 0.4, 1.0)
    size = np.exp(0.22 * vary * rng.standard_normal(n))
    aspect = np.exp(0.25 * vary * rng.standard_normal(n))
    flat = 0.1 * width * np.exp(0.7 * rng.standard_normal(n))
    faint = rng.random(n) < 0.125
    tail = rng.random(n)
    turn = np.where(held, 0.0, 2.0 * np.pi * rng.random(n))
    straight = np.where(held[:, None], edges.along, patch.tangents)
    straight = unit(straight - patch.normals * dot(straight, patch.normals)[:, None])
    tangents = (
        straight * np.cos(turn)[:, None] + np.cross(patch.normals, straight) * np.sin(turn)[:, None]
    )
    turned = Patch(patch.points, patch.normals, tangents, patch.areas, patch.uv)
    return Surfels(
        turned,
        np.stack([length * size * aspect, width * size / aspect, flat], axis=1),
        np.array(np.broadcast_to(np.asarray(albedo, np.float64), (n, 3))),
        np.array(np.broadcast_to(np.asarray(gloss, np.float64), (n, 3))),
        np.full(n, spread),
        np.where(faint, 0.02 + 0.5 * tail**2, 0.998 - 0.18 * tail**2),
        np.array(np.broadcast_to(np.asarray(glow, np.float64), (n,))),
    )


def concatenate(parts: list[Surfels]) -> Surfels:
    """Concatenate several batches of surfels."""
    return Surfels(
        join_patches([part.patch for part in parts]),
        np.concatenate([part.sizes for part in parts]),
        np.concatenate([part.albedo for part in parts]),
        np.concatenate([part.gloss for part in parts]),
        np.concatenate([part.spread for part in parts]),
        np.concatenate([part.opacities_unit for part in parts]),
        np.concatenate([part.glow for part in parts]),
    )


def blend(a: F64 | Colour, b: F64 | Colour, share: F64) -> F64:
    """Interpolate colours from `a` at `share` 0 to `b` at 1; (n,) shares give (n, 3)."""
    low, high = np.asarray(a, np.float64), np.asarray(b, np.float64)
    result: F64 = low + (high - low) * share[:, None]
    return result


def move(surfels: Surfels, turn: float, offset: tuple[float, float, float]) -> Surfels:
    """Return the surfels turned about +y by `turn` radians, then shifted by `offset`."""
    return replace(surfels, patch=surfels.patch.move(turn, offset))
