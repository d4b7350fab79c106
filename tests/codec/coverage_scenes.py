"""Test scenes that are hard to cover with views: long, thin, hollow, flat, or seen from inside.

Each scene comes with held-out test views, at random poses around an object or along the floors of
a building. The encoder does not use these views.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.splats import Splats
from cogsplat.tools.lab.synthetic.lighting import TO_SCENE, Occluders
from cogsplat.tools.lab.synthetic.materials import Surfels, blend, concatenate, cover, split_count
from cogsplat.tools.lab.synthetic.patches import (
    Patch,
    noise,
    quad,
    revolve,
    smooth_curve,
    smoothstep,
    tube,
    unit,
)
from cogsplat.tools.lab.synthetic.terrace import camera_at, splats_from_surfels

F64 = NDArray[np.float64]
Point = tuple[float, float, float]
Part = Callable[[int, np.random.Generator], Surfels]
Floor = tuple[float, float, float, float]

TEST_VIEWS: Final = 24
_WIDTH, _HEIGHT = 480, 360

# Range of eye heights of visitors of a building, scene units.
_EYES_LOW, _EYES_HIGH = 1.1, 1.8


@dataclass(frozen=True, eq=False)
class CoverageScene:
    """A scene and its held-out test views.

    Parameters
    ----------
    splats : Splats
        In rows of no particular order, axes "RDF".
    test_views : list of Camera
        480 x 360 px, horizontal field of view 60 degrees.
    """

    splats: Splats
    test_views: list[Camera]


def _paint(patch: Patch, rng: np.random.Generator, grain: float, hue: int) -> Surfels:
    """Return surfels of a patch, with a colour pattern of spatial frequency `grain`."""
    palette = np.array(
        [[0.70, 0.32, 0.16], [0.16, 0.42, 0.62], [0.30, 0.52, 0.20], [0.62, 0.58, 0.50]]
    )
    light = palette[hue % 4]
    coarse = noise(patch.points, grain, 3, salt=hue)
    fine = smoothstep(0.45, 0.55, noise(patch.points, 4.0 * grain, 2, salt=hue + 7))
    albedo = blend(0.25 * light, light, coarse) * (0.55 + 0.45 * fine)[:, None]
    return cover(patch, rng, albedo, 0.15, spread=0.3)


def _bar(start: Point, end: Point, radius: float, hue: int, grain: float) -> Part:
    """Return a part: a straight tube."""
    path = np.linspace(start, end, 33)

    def make(n: int, rng: np.random.Generator) -> Surfels:
        return _paint(tube(path, np.full(33, radius), n, rng), rng, grain, hue)

    return make


def _lathe(outline: list[tuple[float, float]], offset: Point, hue: int, grain: float) -> Part:
    """Return a part: a surface of revolution."""
    profile = smooth_curve([*outline])

    def make(n: int, rng: np.random.Generator) -> Surfels:
        return _paint(revolve(profile, n, rng).move(0.0, offset), rng, grain, hue)

    return make


def _sheet(corner: Point, u: Point, v: Point, hue: int, grain: float) -> Part:
    """Return a part: a parallelogram."""

    def make(n: int, rng: np.random.Generator) -> Surfels:
        return _paint(quad(corner, u, v, n, rng), rng, grain, hue)

    return make


def _crate(low: Point, high: Point, hue: int, grain: float) -> list[tuple[float, Part]]:
    """Return the six sides of a box as (area, part) pairs."""
    a, size = np.array(low), np.array(high) - np.array(low)
    sides: list[tuple[float, Part]] = []
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        u, v, across = np.zeros(3), np.zeros(3), np.zeros(3)
        u[first], v[second], across[axis] = size[first], size[second], size[axis]
        area = float(size[first] * size[second])
        for corner in (a, a + across):
            part = _sheet(_point(corner), _point(u), _point(v), hue, grain)
            sides.append((area, part))
    return sides


def _point(values: F64) -> Point:
    x, y, z = values.tolist()
    return (x, y, z)


def _lamp() -> list[tuple[float, Part]]:
    """Return the weighted parts of a street lamp."""
    head = [(0.02, 0.0), (0.22, 0.10), (0.26, 0.30), (0.12, 0.48), (0.01, 0.52)]
    foot = [(0.20, 0.0), (0.19, 0.15), (0.10, 0.35), (0.06, 0.6)]
    return [
        (0.20, _lathe(foot, (0.0, 0.0, 0.0), 0, 6.0)),
        (0.25, _bar((0.0, 0.5, 0.0), (0.0, 6.0, 0.0), 0.05, 3, 8.0)),
        (0.10, _bar((0.0, 5.9, 0.0), (1.6, 6.3, 0.0), 0.035, 1, 8.0)),
        (0.45, _lathe(head, (1.6, 5.85, 0.0), 2, 8.0)),
    ]


def _fence() -> list[tuple[float, Part]]:
    """Return the weighted parts of a fence."""
    parts: list[tuple[float, Part]] = []
    for k in range(25):
        x = 0.4 * k - 4.8
        parts.append((1.0, _bar((x, 0.0, 0.0), (x, 1.2, 0.0), 0.03, k, 7.0)))
    rails = [_bar((-4.9, y, 0.05), (4.9, y, 0.05), 0.025, 3, 7.0) for y in (0.25, 1.0)]
    return parts + [(5.0, rail) for rail in rails]


def _shell() -> list[tuple[float, Part]]:
    """Return the weighted parts of an open bowl."""
    # Open at the top: the inner side is visible only from above.
    outside = [(0.05, -1.0), (0.7, -0.75), (1.0, 0.0), (0.8, 0.62), (0.5, 0.85)]
    inside = [(0.47, 0.82), (0.76, 0.58), (0.94, 0.0), (0.66, -0.70), (0.05, -0.94)]
    return [
        (0.55, _lathe(outside, (0.0, 0.0, 0.0), 1, 5.0)),
        (0.45, _lathe(inside, (0.0, 0.0, 0.0), 0, 5.0)),
    ]


def _card() -> list[tuple[float, Part]]:
    """Return the weighted part of a flat card."""
    return [(1.0, _sheet((-1.0, -0.6, 0.0), (2.0, 0.0, 0.0), (0.0, 1.2, 0.0), 1, 9.0))]


def _room() -> list[tuple[float, Part]]:
    """Return the weighted parts of a furnished room."""
    parts = _crate((-3.0, 0.0, -2.5), (3.0, 2.6, 2.5), 3, 2.0)
    parts += _crate((-2.8, 0.0, -2.3), (-1.6, 0.8, -1.3), 0, 5.0)
    parts += _crate((1.2, 0.0, 1.3), (2.6, 1.9, 2.2), 2, 5.0)
    return parts


def _two_rooms() -> list[tuple[float, Part]]:
    """Return the parts of two rooms, joined by a door 0.9 wide in a wall at x = 0."""
    parts = _crate((-5.0, 0.0, -2.0), (0.0, 2.6, 2.0), 3, 2.0)
    del parts[1]
    far = _crate((0.1, 0.0, -2.0), (4.5, 2.6, 2.0), 1, 2.0)
    del far[0]
    parts += far
    for x in (0.0, 0.1):
        for z, width in ((-2.0, 2.6), (1.5, 0.5)):
            wall = _sheet((x, 0.0, z), (0.0, 2.6, 0.0), (0.0, 0.0, width), 2, 2.5)
            parts.append((2.6 * width, wall))
        lintel = _sheet((x, 2.1, 0.6), (0.0, 0.5, 0.0), (0.0, 0.0, 0.9), 2, 2.5)
        parts.append((0.45, lintel))
    parts += _crate((3.0, 0.0, -1.8), (4.2, 1.0, -0.6), 0, 5.0)
    return parts


def _statue() -> list[tuple[float, Part]]:
    """Return the parts of a figure with a staff: most detail in a small part of the height."""
    body = [(0.32, 0.0), (0.36, 0.35), (0.24, 0.75), (0.30, 1.05), (0.10, 1.30)]
    head = [(0.01, 0.0), (0.13, 0.08), (0.15, 0.20), (0.09, 0.30), (0.01, 0.33)]
    return [
        (0.55, _lathe(body, (0.0, 0.0, 0.0), 0, 9.0)),
        (0.20, _lathe(head, (0.0, 1.28, 0.0), 3, 14.0)),
        (0.10, _bar((0.25, 1.0, 0.0), (0.70, 0.85, 0.10), 0.05, 1, 14.0)),
        (0.10, _bar((0.70, 0.0, 0.10), (0.70, 3.6, 0.10), 0.018, 2, 14.0)),
        (0.05, _bar((0.70, 3.5, 0.10), (1.70, 3.6, 0.10), 0.010, 1, 14.0)),
    ]


_OBJECTS: Final[Mapping[str, Callable[[], list[tuple[float, Part]]]]] = MappingProxyType(
    {"lamp": _lamp, "fence": _fence, "shell": _shell, "card": _card, "statue": _statue}
)
# Parts of each building, and the floor areas where visitors may stand, clear of walls and
# furniture: x and z of opposite corners.
_BUILDINGS: Final[
    Mapping[str, tuple[Callable[[], list[tuple[float, Part]]], tuple[Floor, ...]]]
] = MappingProxyType(
    {
        "room": (_room, ((-2.4, -0.8, 2.4, 0.8), (-1.2, -1.9, 2.4, -0.8))),
        "two-rooms": (
            _two_rooms,
            ((-4.4, -1.4, -0.6, 1.4), (0.7, -0.2, 3.9, 1.4), (-0.2, 0.9, 0.3, 1.2)),
        ),
    }
)

COVERAGE_SCENES: Final = (*_OBJECTS, *_BUILDINGS)
"""Names of the scenes of `coverage_scene`."""


def coverage_scene(
    name: str, splats: int = 20_000, seed: int = 5, sh_degree: int = 0
) -> CoverageScene:
    """Make one of the scenes.

    Parameters
    ----------
    name : str
        One of `COVERAGE_SCENES`.
    splats : int
        Number of splats.
    seed : int
        Seed of the scene and of its test views.
    sh_degree : int
        0 to 3.

    Returns
    -------
    CoverageScene
        Equal for equal arguments on one platform.

    Raises
    ------
    ValueError
        An unknown name.
    """
    if name not in COVERAGE_SCENES:
        raise ValueError(f"scene {name!r}, expected one of {COVERAGE_SCENES}")
    rng = np.random.default_rng(seed)
    parts = _OBJECTS[name]() if name in _OBJECTS else _BUILDINGS[name][0]()
    counts = split_count(splats, [share for share, _ in parts])
    surfels = concatenate([make(n, rng) for n, (_, make) in zip(counts, parts, strict=True) if n])
    surfels = surfels.take(rng.permutation(splats))
    made = splats_from_surfels(
        surfels, Occluders(np.zeros((0, 5)), np.zeros((0, 7))), rng, sh_degree
    )
    # A second generator keeps the test views when the scene draws more random numbers.
    draws = np.random.default_rng([seed, COVERAGE_SCENES.index(name)])
    if name in _OBJECTS:
        return CoverageScene(made, _orbit_views(surfels.patch.points, draws))
    return CoverageScene(made, _visitor_views(_BUILDINGS[name][1], draws))


def _orbit_views(points: F64, rng: np.random.Generator) -> list[Camera]:
    """Return test views around an object, from close-ups to views in which it is small."""
    low, high = points.min(axis=0), points.max(axis=0)
    radius = 0.5 * float(np.linalg.norm(high - low))
    cameras: list[Camera] = []
    for view in range(TEST_VIEWS):
        rise, angle = rng.uniform(-0.3, 0.9), 2.0 * np.pi * rng.random()
        ring = np.sqrt(1.0 - rise * rise)
        back = np.array([ring * np.cos(angle), rise, ring * np.sin(angle)])
        target = 0.5 * (low + high) + 0.2 * (high - low) * rng.uniform(-1.0, 1.0, 3)
        cameras.append(_camera(view, target + radius * rng.uniform(0.9, 2.2) * back, -back))
    return cameras


def _visitor_views(floors: tuple[Floor, ...], rng: np.random.Generator) -> list[Camera]:
    """Return test views from random points of a building's floors, in random directions."""
    cameras: list[Camera] = []
    for view in range(TEST_VIEWS):
        x0, z0, x1, z1 = floors[view % len(floors)]
        place = np.array(
            [
                rng.uniform(x0, x1),
                rng.uniform(_EYES_LOW, _EYES_HIGH),
                rng.uniform(z0, z1),
            ]
        )
        turn, rise = 2.0 * np.pi * rng.random(), rng.uniform(-0.5, 0.2)
        forward = unit(np.array([np.cos(turn), rise, np.sin(turn)]))
        cameras.append(_camera(view, place, forward))
    return cameras


def _camera(view: int, eye: F64, forward: F64) -> Camera:
    """Return a test view of 480 x 360 px."""
    return camera_at(
        eye * TO_SCENE,
        forward * TO_SCENE,
        _WIDTH,
        _HEIGHT,
        0.5 * _WIDTH / np.tan(np.radians(30.0)),
        f"test_{view:02d}",
    )
