"""Objects of the synthetic scene: their shapes, materials and places.

Lengths are scene units (about a metre), y is up, the terrace's centre is the origin.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .house import ROOF_RISE, WALLS, cottage
from .lighting import Occluders
from .materials import COVER, Colour, Edges, Surfels, blend, concatenate, cover, move, split_count
from .patches import (
    Patch,
    annulus,
    any_tangents,
    noise,
    revolve,
    rotate_about_y,
    smooth_curve,
    smoothstep,
    tube,
    unit,
)

F64 = NDArray[np.float64]

# The teapot stands in the middle, the others on a ring around it at these angles, degrees. Their
# bounding boxes do not overlap.
_RING_RADIUS = 2.25
_RING = {"knot": 40.0, "tree": 130.0, "marbles": 220.0, "house": 310.0}


def object_pose(name: str) -> tuple[float, tuple[float, float, float]]:
    """Return an object's rotation about +y, in radians, and its position."""
    if name not in _RING:
        return 0.5, (0.0, 0.0, 0.0)
    angle = float(np.radians(_RING[name]))
    x, z = _RING_RADIUS * float(np.cos(angle)), _RING_RADIUS * float(np.sin(angle))
    return 0.5 * float(np.pi) - angle, (x, 0.0, z)


def move_to_pose(name: str, surfels: Surfels) -> Surfels:
    """Move an object from the origin, where its front faces +z, to its pose."""
    return move(surfels, *object_pose(name))


def _ball(
    centre: tuple[float, float, float], radius: float, n: int, rng: np.random.Generator
) -> Patch:
    """Return n points on a sphere."""
    angle = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 65)
    profile = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    return revolve(profile, n, rng).move(0.0, centre)


def _plinth(radius: float, height: float, n: int, rng: np.random.Generator) -> Surfels:
    """Return n surfels of a round marble plinth."""
    r, h = radius, height
    outline = [(r, 0.0), (r, 0.05), (r * 0.9, 0.09), (r * 0.87, h - 0.09), (r * 0.97, h - 0.05)]
    corners = np.array([*outline, (r * 0.97, h), (0.0, h)])
    fine = np.linspace(0.0, len(corners) - 1.0, 20 * (len(corners) - 1) + 1)
    knots = np.arange(len(corners))
    profile = np.stack([np.interp(fine, knots, corners[:, i]) for i in range(2)], axis=1)
    patch = revolve(profile, n, rng)
    veins = np.abs(noise(patch.points, 3.0, 4, 31) - 0.5) * 2.0
    albedo = blend((0.50, 0.47, 0.44), (0.74, 0.72, 0.70), smoothstep(0.0, 0.25, veins))
    steps = np.diff(corners, axis=0)
    lengths = np.concatenate([[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]))])
    along = patch.uv[:, 0] * lengths[-1]
    edge = np.abs(along[:, None] - lengths[1:-1]).min(axis=1)
    return cover(patch, rng, albedo, 0.28, 0.14, edges=Edges(edge, patch.tangents))


def teapot(n: int, rng: np.random.Generator) -> Surfels:
    """Return n surfels of a glazed teapot with a painted band and gilded lid, on a plinth."""
    plinth, body, spout, handle = split_count(n, (0.24, 0.58, 0.10, 0.08))
    outline = [(0.0, 0.0), (0.30, 0.0), (0.33, 0.025), (0.47, 0.13), (0.565, 0.30), (0.53, 0.47)]
    outline += [
        (0.40, 0.585),
        (0.335, 0.625),
        (0.34, 0.65),
        (0.27, 0.69),
        (0.13, 0.735),
        (0.05, 0.755),
    ]
    outline += [(0.045, 0.78), (0.085, 0.82), (0.075, 0.865), (0.0, 0.89)]
    patch = revolve(smooth_curve(list(outline)), body, rng)
    y, angle = patch.points[:, 1], patch.uv[:, 1]
    glaze = blend((0.012, 0.16, 0.19), (0.035, 0.33, 0.34), noise(patch.points, 5.0, 3, 41))
    cream = blend((0.80, 0.73, 0.58), (0.86, 0.80, 0.68), noise(patch.points, 12.0, 2, 42))
    # A frieze of petals and a vine between two gilded lines.
    petal = np.abs(np.sin(6.0 * angle)) * 0.085 - np.abs(y - 0.33)
    vine = 0.012 - np.abs(y - 0.33 - 0.05 * np.sin(12.0 * angle))
    soft = 0.004 + 0.25 * float(np.sqrt(patch.areas[:1].sum()))
    painted = np.maximum(smoothstep(-soft, soft, petal - 0.03), smoothstep(-soft, soft, vine))
    band = smoothstep(-soft, soft, 0.115 - np.abs(y - 0.33))
    albedo = blend(glaze, blend(cream, (0.03, 0.06, 0.30), painted), band)
    gilt = smoothstep(-soft, soft, 0.012 - np.abs(np.abs(y - 0.33) - 0.125))
    gilt = np.maximum(gilt, smoothstep(0.765 - soft, 0.765 + soft, y))
    gilt = np.maximum(gilt, smoothstep(-soft, soft, 0.014 - np.abs(y - 0.637)))
    albedo = blend(albedo, (0.55, 0.33, 0.08), gilt)
    shine = blend((0.75, 0.75, 0.75), (0.85, 0.65, 0.30), gilt)
    edges = Edges.none(patch)
    for line in (np.abs(y - 0.33) - 0.125, y - 0.637):
        edges = edges.nearer(np.abs(line), patch.tangents)
    parts = [cover(patch, rng, albedo, shine, 0.075, edges=edges)]

    path = smooth_curve(
        [(0.44, 0.24, 0.0), (0.66, 0.30, 0.0), (0.78, 0.47, 0.0), (0.93, 0.62, 0.0)]
    )
    along = np.linspace(0.0, 1.0, len(path))
    radii = 0.125 - 0.085 * smoothstep(0.0, 0.8, along) + 0.015 * smoothstep(0.9, 1.0, along)
    patch = tube(path, radii, spout, rng)
    lip = smoothstep(0.93, 0.95, patch.uv[:, 0])
    glaze = blend((0.012, 0.16, 0.19), (0.035, 0.33, 0.34), noise(patch.points, 5.0, 3, 41))
    parts.append(cover(patch, rng, blend(glaze, (0.55, 0.33, 0.08), lip), 0.75, 0.075))

    loop = [(-0.43, 0.50, 0.0), (-0.66, 0.60, 0.0), (-0.84, 0.52, 0.0), (-0.84, 0.32, 0.0)]
    path = smooth_curve([*loop, (-0.68, 0.18, 0.0), (-0.46, 0.16, 0.0)])
    patch = tube(path, np.full(len(path), 0.042), handle, rng)
    glaze = blend((0.012, 0.16, 0.19), (0.035, 0.33, 0.34), noise(patch.points, 5.0, 3, 41))
    parts.append(cover(patch, rng, glaze, 0.75, 0.075))

    raised = [move(part, 0.0, (0.0, 0.28, 0.0)) for part in parts]
    return move_to_pose("teapot", concatenate([_plinth(0.62, 0.28, plinth, rng), *raised]))


def _knot_path() -> F64:
    """Return the centre line of the trefoil knot."""
    t = np.linspace(0.0, 2.0 * np.pi, 481)
    radius = 0.40 + 0.17 * np.cos(3.0 * t)
    # A trefoil that stands on its side, like a wreath.
    x, y, z = radius * np.cos(2.0 * t), radius * np.sin(2.0 * t), 0.19 * np.sin(3.0 * t)
    return np.stack([x, y + 1.02, z], axis=1)


def knot(n: int, rng: np.random.Generator) -> Surfels:
    """Return n surfels of a trefoil knot of anodised metal on a marble plinth."""
    plinth, metal = split_count(n, (0.30, 0.70))
    path = _knot_path()
    patch = tube(path, np.full(len(path), 0.105), metal, rng)
    # Anodised: violet where it faces the eye, its highlights run to cyan.
    stain = noise(patch.points, 2.5, 3, 45)
    albedo = blend((0.05, 0.010, 0.17), (0.30, 0.020, 0.22), smoothstep(0.3, 0.7, stain))
    tubing = cover(patch, rng, albedo, (0.62, 0.85, 0.95), 0.075)
    parts = [_plinth(0.46, 0.34, plinth, rng), tubing]
    return move_to_pose("knot", concatenate(parts))


_MARBLES: tuple[tuple[tuple[float, float, float], float], ...] = (
    ((-0.28, 0.42, -0.10), 0.42),
    ((0.36, 0.31, 0.12), 0.31),
    ((0.00, 0.20, 0.50), 0.20),
    ((-0.42, 0.13, 0.45), 0.13),
)


def marbles(n: int, rng: np.random.Generator) -> Surfels:
    """Return n surfels of four balls: red lacquer, striped satin, cobalt glass and brass."""
    parts = []
    for i, count in enumerate(split_count(n, [radius**1.6 for _, radius in _MARBLES])):
        centre, radius = _MARBLES[i]
        patch = _ball(centre, radius, count, rng)
        albedo: F64 | Colour
        gloss: float | Colour
        if i == 0:
            albedo, gloss, spread = (0.50, 0.016, 0.012), 0.85, 0.075
        elif i == 1:
            tilted = patch.points - np.array(centre)
            height = 0.8 * tilted[:, 1] + 0.6 * tilted[:, 0]
            soft = 0.05 + 0.8 * float(np.sqrt(patch.areas[:1].sum())) / radius
            stripe = smoothstep(-soft, soft, np.sin(height * 34.0))
            albedo, gloss, spread = (
                blend((0.80, 0.74, 0.62), (0.70, 0.26, 0.03), stripe),
                0.22,
                0.30,
            )
        elif i == 2:
            swirl = noise(patch.points * np.array([1.0, 3.0, 1.0]), 4.0, 3, 51)
            albedo, gloss, spread = (
                blend((0.006, 0.02, 0.20), (0.02, 0.16, 0.62), swirl),
                0.9,
                0.115,
            )
        else:
            albedo, gloss, spread = (0.30, 0.19, 0.06), (0.8, 0.68, 0.4), 0.12
        parts.append(cover(patch, rng, albedo, gloss, spread))
    return move_to_pose("marbles", concatenate(parts))


def _crown() -> F64:
    """Return centre and radius of the clumps of the tree's crown, (12, 4), tree at the origin."""
    i = np.arange(12.0)
    height = 1.0 - 2.0 * (i + 0.5) / 12.0
    ring, angle = np.sqrt(1.0 - height**2), i * (np.pi * (3.0 - np.sqrt(5.0)))
    reach = 0.46 + 0.07 * np.sin(5.0 * i)
    x, z = reach * ring * np.cos(angle), reach * ring * np.sin(angle)
    return np.stack([x, 1.62 + 0.40 * height, z, 0.27 + 0.05 * np.cos(3.0 * i)], axis=1)


def tree(n: int, rng: np.random.Generator) -> Surfels:
    """Return n surfels of a blossoming tree in a glazed pot; each petal and leaf is one."""
    pot, soil, trunk, twigs, leaves = split_count(n, (0.14, 0.02, 0.07, 0.07, 0.70))
    outline = [(0.0, 0.0), (0.24, 0.0), (0.26, 0.02), (0.34, 0.20), (0.37, 0.30), (0.40, 0.32)]
    patch = revolve(smooth_curve([*outline, (0.40, 0.36), (0.35, 0.36), (0.34, 0.31)]), pot, rng)
    ring = np.abs(patch.points[:, 1] - 0.20) < 0.02
    edges = Edges(np.abs(patch.points[:, 1] - 0.33), patch.tangents)
    albedo = np.where(ring[:, None], [0.75, 0.66, 0.50], [0.10, 0.19, 0.42])
    albedo = albedo * (0.75 + 0.5 * noise(patch.points, 8.0, 3, 61))[:, None]
    parts = [cover(patch, rng, albedo, 0.45, 0.14, edges=edges)]
    patch = annulus(0.0, 0.35, soil, rng).move(0.0, (0.0, 0.32, 0.0))
    parts.append(cover(patch, rng, blend((0.03, 0.02, 0.01), (0.10, 0.06, 0.03), rng.random(soil))))

    stem = [(0.0, 0.30, 0.0), (0.03, 0.60, 0.02), (-0.04, 0.90, 0.0), (0.02, 1.25, -0.02)]
    path = smooth_curve(list(stem))
    patch = tube(path, np.linspace(0.10, 0.05, len(path)), trunk, rng)
    parts.append(_bark(patch, rng))
    crown = _crown()
    for clump, count in zip(crown, split_count(twigs, [1.0] * len(crown)), strict=True):
        x, y, z, _ = (float(value) for value in clump)
        foot = (0.0, 0.95 + 0.12 * (y - 1.3), 0.0)
        bough = smooth_curve([foot, (0.45 * x, 0.5 * (foot[1] + y) - 0.05, 0.45 * z), (x, y, z)])
        parts.append(_bark(tube(bough, np.linspace(0.035, 0.010, len(bough)), count, rng), rng))

    clump_of = rng.integers(0, len(crown), leaves)
    away = unit(rng.standard_normal((leaves, 3)))
    depth = np.cbrt(0.12 + 0.88 * rng.random(leaves)) * np.exp(0.10 * rng.standard_normal(leaves))
    spot = crown[clump_of, :3] + away * (crown[clump_of, 3] * depth)[:, None]
    normals = unit(
        0.9 * away
        + 0.6 * unit(spot - np.array([0.0, 1.5, 0.0]))
        + 0.55 * rng.standard_normal((leaves, 3))
    )
    size = 0.022 * (12000.0 / max(leaves, 1)) ** 0.4
    patch = Patch(
        spot, normals, any_tangents(normals), np.full(leaves, (size / COVER) ** 2), spot[:, :2]
    )
    petal = blend(
        (0.72, 0.16, 0.30),
        (0.95, 0.66, 0.74),
        np.clip(depth - 0.3 + 0.5 * rng.random(leaves), 0.0, 1.0),
    )
    green = blend((0.10, 0.20, 0.03), (0.28, 0.36, 0.06), rng.random(leaves))
    kind = rng.random(leaves) < 0.20
    leaf = cover(patch, rng, np.where(kind[:, None], green, petal), 0.10, 0.25)
    longer = np.where(kind, 1.7, 1.15)[:, None] ** np.array([1.0, -1.0, 0.0])
    parts.append(
        Surfels(
            leaf.patch,
            leaf.sizes * longer,
            leaf.albedo,
            leaf.gloss,
            leaf.spread,
            leaf.opacities_unit,
            leaf.glow,
        )
    )
    return move_to_pose("tree", concatenate(parts))


def _bark(patch: Patch, rng: np.random.Generator) -> Surfels:
    """Return surfels of bark on a patch."""
    tone = noise(patch.points * np.array([1.0, 0.35, 1.0]), 28.0, 2, 62)
    return cover(patch, rng, blend((0.05, 0.028, 0.016), (0.20, 0.13, 0.085), tone))


def house(n: int, rng: np.random.Generator) -> Surfels:
    """Return n surfels of the cottage at its pose, with its front door outwards."""
    return move_to_pose("house", cottage(n, rng))


def occluders() -> Occluders:
    """Return the spheres and boxes that cast the objects' shadows."""
    arc = np.linspace(-0.9, 0.9, 8) * np.pi
    spout = [(0.62, 0.57, 0.0, 0.09), (0.72, 0.65, 0.0, 0.08), (0.80, 0.77, 0.0, 0.06)]
    handle = [(-0.64 + 0.21 * np.sin(a), 0.66 + 0.21 * np.cos(a), 0.0, 0.04) for a in arc]
    crown = [(x, y, z, radius, 0.55) for x, y, z, radius in _crown()]
    trunk = [(0.0, 0.40 + 0.11 * i, 0.0, 0.07) for i in range(8)]
    balls: dict[str, list[tuple[float, ...]]] = {
        "teapot": [(0.0, 0.58, 0.0, 0.50), (0.0, 0.90, 0.0, 0.28), (0.0, -0.18, 0.0, 0.60)],
        "knot": [(*centre, 0.088) for centre in _knot_path()[:-1:12]] + [(0.0, 0.0, 0.0, 0.40)],
        "marbles": [(*centre, radius) for centre, radius in _MARBLES],
        "tree": [*crown, *trunk, (0.0, 0.17, 0.0, 0.30)],
    }
    balls["teapot"] += [*spout, (0.90, 0.87, 0.0, 0.05), *handle]
    rows = []
    for name, group in balls.items():
        turn, offset = object_pose(name)
        centres = rotate_about_y(np.array([ball[:3] for ball in group]), turn) + np.array(offset)
        for centre, ball in zip(centres, group, strict=True):
            rows.append([*centre, ball[3], ball[4] if len(ball) > 4 else 1.0])

    turn, (x, _, z) = object_pose("house")
    hx, hz, h = WALLS
    boxes = [
        [x, 0.5 * h, z, hx, 0.5 * h, hz, turn],
        [x, h + 0.25 * ROOF_RISE, z, hx, 0.25 * ROOF_RISE, 0.62 * hz, turn],
        [x, h + 0.65 * ROOF_RISE, z, hx, 0.20 * ROOF_RISE, 0.28 * hz, turn],
    ]
    return Occluders(np.array(rows), np.array(boxes))


# Centre and radius of a hidden sphere inside each object, before it is moved to its pose.
_INSIDES = {
    "teapot": ((0.0, 0.55, 0.0), 0.28),
    "knot": ((0.0, 0.16, 0.0), 0.14),
    "marbles": ((-0.28, 0.42, -0.10), 0.20),
    "tree": ((0.0, 0.15, 0.0), 0.09),
    "house": ((0.0, 0.36, 0.0), 0.26),
}


def hidden_splats(name: str, n: int, rng: np.random.Generator) -> Surfels:
    """Return n surfels inside an object, hidden from all views, as in trained scenes."""
    middle, reach = _INSIDES[name]
    away = unit(rng.standard_normal((n, 3)))
    spot = away * (reach * np.cbrt(rng.random(n)))[:, None] + np.array(middle)
    normals = unit(rng.standard_normal((n, 3)))
    areas = np.minimum(0.04 * np.exp(0.6 * rng.standard_normal(n)), 0.07) ** 2
    patch = Patch(spot, normals, any_tangents(normals), areas, spot[:, :2])
    return move_to_pose(name, cover(patch, rng, rng.random((n, 3)) * 0.25))
