"""Surfaces of the synthetic scenes as evenly spread points, and value noise for textures."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

R2 = np.array([0.7548776662466927, 0.5698402909980532])
"""Generators of the R2 sequence: powers of the inverse plastic number, the root of x³ = x + 1
(M. Roberts, "The unreasonable effectiveness of quasirandom sequences", 2018)."""

# Segments of a smoothed outline: far finer than the splats that sit on it.
_OUTLINE_STEPS = 24


@dataclass(frozen=True, eq=False)
class Patch:
    """n points spread evenly over a surface, with normals; y is up.

    Parameters
    ----------
    points : (n, 3) float64
        Scene units.
    normals, tangents : (n, 3) float64
        Unit and orthogonal; normals point outwards.
    areas : (n,) float64
        Surface area per point, scene units².
    uv : (n, 2) float64
        Texture coordinates, defined by each shape.
    """

    points: F64
    normals: F64
    tangents: F64
    areas: F64
    uv: F64

    def move(self, turn: float, offset: tuple[float, float, float]) -> Patch:
        """Return the patch turned about +y by `turn` radians, then shifted by `offset`."""
        return Patch(
            rotate_about_y(self.points, turn) + np.array(offset),
            rotate_about_y(self.normals, turn),
            rotate_about_y(self.tangents, turn),
            self.areas,
            self.uv,
        )

    def take(self, rows: NDArray[np.integer] | slice) -> Patch:
        """Return a selection of rows."""
        return Patch(
            self.points[rows],
            self.normals[rows],
            self.tangents[rows],
            self.areas[rows],
            self.uv[rows],
        )


def rotate_about_y(vectors: F64, turn: float) -> F64:
    """Return (n, 3) vectors turned about +y by `turn` radians, +z towards +x."""
    c, s = np.cos(turn), np.sin(turn)
    x, y, z = vectors[:, 0], vectors[:, 1], vectors[:, 2]
    return np.stack([c * x + s * z, y, c * z - s * x], axis=1)


def dot(a: F64, b: F64) -> F64:
    """Return the row-wise dot product of (…, 3) arrays, without BLAS."""
    result: F64 = a[..., 0] * b[..., 0] + a[..., 1] * b[..., 1] + a[..., 2] * b[..., 2]
    return result


def unit(vectors: F64) -> F64:
    """Return (…, 3) vectors scaled to length 1; zeros stay zeros."""
    length = np.sqrt(dot(vectors, vectors))
    result: F64 = vectors / np.maximum(length, 1e-12)[..., None]
    return result


def any_tangents(normals: F64) -> F64:
    """Return unit vectors orthogonal to (n, 3) unit normals."""
    helper = np.where(np.abs(normals[:, 1:2]) < 0.9, [[0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0]])
    return unit(np.cross(helper, normals))


def lattice(n: int, rng: np.random.Generator) -> F64:
    """Return n points of the R2 sequence in the unit square from a random start, (n, 2)."""
    points: F64 = (rng.random(2) + np.arange(n, dtype=np.float64)[:, None] * R2) % 1.0
    return points


def smooth_curve(points: list[tuple[float, ...]], closed: bool = False) -> F64:
    """Return a Catmull-Rom curve through control points as a dense polyline, (m, dimensions)."""
    p = np.array(points, dtype=np.float64)
    ends = (p[-1:], p[:2]) if closed else (2 * p[:1] - p[1:2], 2 * p[-1:] - p[-2:-1])
    p = np.concatenate([ends[0], p, ends[1]])
    t = np.linspace(0.0, 1.0, _OUTLINE_STEPS, endpoint=False)[None, :, None]
    a, b, c, d = (p[i : len(p) - 3 + i, None, :] for i in range(4))
    curve = b + 0.5 * t * ((c - a) + t * ((2 * a - 5 * b + 4 * c - d) + t * (3 * (b - c) + d - a)))
    return np.concatenate([curve.reshape(-1, p.shape[1]), p[-2:-1]])


def revolve(profile: F64, n: int, rng: np.random.Generator) -> Patch:
    """Spread points over a surface of revolution about +y.

    Parameters
    ----------
    profile : (m, 2) float64
        Outline as (radius, height) from bottom to top; normals point to its right.
    n : int
        Points.
    rng : numpy.random.Generator
        Source of the start of the lattice.

    Returns
    -------
    Patch
        ``uv`` is the share of the outline's length and the angle in radians.
    """
    step = np.diff(profile, axis=0)
    length = np.hypot(step[:, 0], step[:, 1])
    weight = np.maximum(profile[:-1, 0] + profile[1:, 0], 1e-6) * length
    cumulative = np.concatenate([[0.0], np.cumsum(weight)])
    uv = lattice(n, rng)
    where = np.interp(uv[:, 0], cumulative / cumulative[-1], np.arange(len(profile)))
    knots = np.arange(len(profile))
    radius, height = (np.interp(where, knots, profile[:, i]) for i in range(2))
    slope = np.gradient(profile, axis=0)
    out = np.interp(where, knots, slope[:, 1])
    up = -np.interp(where, knots, slope[:, 0])
    angle = 2.0 * np.pi * uv[:, 1]
    c, s = np.cos(angle), np.sin(angle)
    along = np.interp(where, knots, np.concatenate([[0.0], np.cumsum(length)])) / length.sum()
    return Patch(
        np.stack([radius * c, height, radius * s], axis=1),
        unit(np.stack([out * c, up, out * s], axis=1)),
        np.stack([-s, np.zeros(n), c], axis=1),
        np.full(n, np.pi * cumulative[-1] / max(n, 1)),
        np.stack([along, angle], axis=1),
    )


def tube(path: F64, radii: F64, n: int, rng: np.random.Generator) -> Patch:
    """Spread points over a tube of varying radius about a curve.

    Parameters
    ----------
    path : (m, 3) float64
        Centre line.
    radii : (m,) float64
        Radius at each point of the centre line.
    n : int
        Points.
    rng : numpy.random.Generator
        Source of the start of the lattice.

    Returns
    -------
    Patch
        ``uv`` is the share of the curve's length and the angle about it in radians.
    """
    step = np.diff(path, axis=0)
    length = np.sqrt(dot(step, step))
    cumulative = np.concatenate([[0.0], np.cumsum((radii[:-1] + radii[1:]) * length)])
    uv = lattice(n, rng)
    knots = np.arange(len(path))
    where = np.interp(uv[:, 0], cumulative / cumulative[-1], knots)

    def at(values: F64) -> F64:
        return np.stack([np.interp(where, knots, values[:, i]) for i in range(3)], axis=1)

    forward = unit(np.gradient(path, axis=0))
    # Carrying one side vector along the curve keeps the frame from spinning where it bends.
    side = np.empty_like(forward)
    side[0] = any_tangents(forward[:1])[0]
    for i in range(1, len(path)):
        side[i] = unit(side[i - 1] - forward[i] * dot(side[i - 1], forward[i]))
    bend = (
        np.gradient(forward, axis=0)
        / np.maximum(np.gradient(cumulative_length(path)), 1e-9)[:, None]
    )
    axis, first = unit(at(forward)), at(side)
    first = unit(first - axis * dot(first, axis)[:, None])
    angle = 2.0 * np.pi * uv[:, 1]
    normals = first * np.cos(angle)[:, None] + np.cross(axis, first) * np.sin(angle)[:, None]
    radius = np.interp(where, knots, radii)
    stretch = np.clip(1.0 - radius * dot(at(bend), normals), 0.3, 3.0)
    return Patch(
        at(path) + normals * radius[:, None],
        normals,
        axis,
        # Few points leave gaps rather than fatten a thin tube.
        np.minimum(np.pi * cumulative[-1] / max(n, 1) * stretch, (0.55 * radius) ** 2),
        np.stack([uv[:, 0], angle], axis=1),
    )


def cumulative_length(path: F64) -> F64:
    """Return the length of a polyline (m, 3) up to each of its points, (m,)."""
    step = np.diff(path, axis=0)
    return np.concatenate([[0.0], np.cumsum(np.sqrt(dot(step, step)))])


def quad(
    corner: tuple[float, float, float],
    edge_u: tuple[float, float, float],
    edge_v: tuple[float, float, float],
    n: int,
    rng: np.random.Generator,
    triangle: bool = False,
) -> Patch:
    """Spread points over a parallelogram, or the triangle at its corner; the normal is u × v.

    Returns
    -------
    Patch
        ``uv`` is the share of each edge.
    """
    u, v = np.array(edge_u), np.array(edge_v)
    uv = lattice(n, rng)
    if triangle:
        uv = np.where(uv.sum(axis=1, keepdims=True) > 1.0, 1.0 - uv, uv)
    normal = np.cross(u, v)
    area = float(np.sqrt(dot(normal, normal))) * (0.5 if triangle else 1.0)
    return Patch(
        np.array(corner) + uv[:, :1] * u + uv[:, 1:] * v,
        np.tile(unit(normal), (n, 1)),
        np.tile(unit(u), (n, 1)),
        np.full(n, area / max(n, 1)),
        uv,
    )


def annulus(
    inner: float, outer: float, n: int, rng: np.random.Generator, growth: float = 0.0
) -> Patch:
    """Spread points over a flat ring at height 0.

    Parameters
    ----------
    inner, outer : float
        Radii, scene units.
    n : int
        Points.
    rng : numpy.random.Generator
        Source of the start of the lattice.
    growth : float
        0 for uniform density; at 1 the point spacing is proportional to the radius.

    Returns
    -------
    Patch
        ``uv`` is radius and angle in radians.
    """
    uv = lattice(n, rng)
    power = 2.0 * (1.0 - growth)
    if power > 1e-6:
        radius = (inner**power + uv[:, 0] * (outer**power - inner**power)) ** (1.0 / power)
        span = (outer**power - inner**power) / power
    else:
        radius = inner * (outer / inner) ** uv[:, 0]
        span = np.log(outer / inner)
    angle = 2.0 * np.pi * uv[:, 1]
    c, s = np.cos(angle), np.sin(angle)
    flat = np.zeros(n)
    return Patch(
        np.stack([radius * c, flat, radius * s], axis=1),
        np.tile([0.0, 1.0, 0.0], (n, 1)),
        np.stack([-s, flat, c], axis=1),
        2.0 * np.pi * span * radius ** (2.0 - power) / max(n, 1),
        np.stack([radius, angle], axis=1),
    )


def join_patches(patches: list[Patch]) -> Patch:
    """Concatenate several patches."""
    return Patch(
        np.concatenate([patch.points for patch in patches]),
        np.concatenate([patch.normals for patch in patches]),
        np.concatenate([patch.tangents for patch in patches]),
        np.concatenate([patch.areas for patch in patches]),
        np.concatenate([patch.uv for patch in patches]),
    )


def noise(points: F64, frequency: float, octaves: int = 1, salt: int = 0) -> F64:
    """Return smooth value noise in [0, 1] at (n, 3) points, each octave twice as fine."""
    total = np.zeros(len(points))
    weight, weights = 1.0, 0.0
    for octave in range(octaves):
        scaled = points * (frequency * 2.0**octave)
        total += weight * _value_noise(scaled, salt + 101 * octave)
        weights += weight
        weight *= 0.5
    return total / weights


def _value_noise(points: F64, salt: int) -> F64:
    """Return value noise in [0, 1] of unit frequency at (n, 3) points."""
    floor = np.floor(points)
    cell = floor.astype(np.int64).astype(np.uint32)
    f = points - floor
    f = f * f * (3.0 - 2.0 * f)
    # Odd multipliers from the usual spatial hash (Teschner et al., VMV 2003), one per axis.
    factors = (73856093, 19349663, 83492791)
    lower = [cell[:, i] * np.uint32(factors[i]) for i in range(3)]
    upper = [(cell[:, i] + np.uint32(1)) * np.uint32(factors[i]) for i in range(3)]
    total = np.zeros(len(points))
    for corner in range(8):
        bits = [(corner >> i) & 1 for i in range(3)]
        h = np.full(len(points), (salt * 2654435761) & 0xFFFFFFFF, dtype=np.uint32)
        share = np.ones(len(points))
        for i in range(3):
            h ^= upper[i] if bits[i] else lower[i]
            share = share * (f[:, i] if bits[i] else 1.0 - f[:, i])
        h ^= h >> np.uint32(15)
        h *= np.uint32(0x2C1B3C6D)
        h ^= h >> np.uint32(12)
        h *= np.uint32(0x297A2D39)
        h ^= h >> np.uint32(15)
        total += share * (h * (1.0 / 0xFFFFFFFF))
    return total


def smoothstep(low: float, high: float, values: F64) -> F64:
    """Return 0 below `low`, 1 above `high`, and a smooth ramp between."""
    t = np.clip((values - low) / (high - low), 0.0, 1.0)
    result: F64 = t * t * (3.0 - 2.0 * t)
    return result
