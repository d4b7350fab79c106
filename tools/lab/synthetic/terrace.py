"""Procedural scene with cameras, labels and ground truth: objects on a terrace in a meadow.

It has the difficulties of trained scenes: a wide range of sizes and opacities, view-dependent
gloss, noise in the higher SH bands, hidden splats, floaters, unnormalised quaternions, and rows in
random order.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.splats import MAX_SH_DEGREE, Splats, empty

from . import landscape as land
from . import object_models as objects
from .lighting import BLOCK, TO_SCENE, Occluders, bake
from .materials import Surfels, concatenate, split_count
from .patches import dot, unit

F64 = NDArray[np.float64]
Maker = Callable[[int, np.random.Generator], Surfels]

# Rows per block: a multiple of `BLOCK`, since `bake` draws its noise block by block.
_BLOCK = 8 * BLOCK

LABELS = ("ground", "teapot", "knot", "marbles", "tree", "house", "surroundings")
"""Names of the labels of `synth_labels`."""

OBJECTS = ("teapot", "knot", "marbles")
"""Names of the objects that `synth_objects` labels."""


def _hidden(name: str) -> Maker:
    """Return the maker of an object's hidden splats."""
    return lambda n, rng: objects.hidden_splats(name, n, rng)


# Label, share of the splats, maker. Shares follow visibility in the views, as by densification.
_PARTS: tuple[tuple[int, float, Maker], ...] = (
    (0, 0.185, land.terrace),
    (0, 0.150, land.meadow),
    (0, 0.030, land.soil),
    (1, 0.125, objects.teapot),
    (1, 0.006, _hidden("teapot")),
    (2, 0.080, objects.knot),
    (2, 0.004, _hidden("knot")),
    (3, 0.080, objects.marbles),
    (3, 0.004, _hidden("marbles")),
    (4, 0.140, objects.tree),
    (4, 0.003, _hidden("tree")),
    (5, 0.120, objects.house),
    (5, 0.006, _hidden("house")),
    (6, 0.050, land.hills),
    (6, 0.035, land.sky),
    (6, 0.012, land.floaters),
)


def _layout(splats: int, seed: int) -> tuple[np.random.Generator, list[int], NDArray[np.intp]]:
    """Return the random generator, the splat count of each part, and the order of the rows."""
    if splats < 1:
        raise ValueError(f"{splats} splats, expected at least 1")
    rng = np.random.default_rng(seed)
    counts = split_count(splats, [share for _, share, _ in _PARTS])
    return rng, counts, rng.permutation(splats)


def synth(splats: int = 120_000, seed: int = 7, sh_degree: int = 3) -> Splats:
    """Generate the scene.

    Parameters
    ----------
    splats : int
        Number of splats, at least 1; below about 10,000 surfaces have gaps.
    seed : int
        Seed; equal seeds give equal bytes on one platform.
    sh_degree : int
        SH degree, 0 to 3; a lower degree truncates the same scene.

    Returns
    -------
    Splats
        In rows of no particular order, axes "RDF", scene units of about a metre.

    Raises
    ------
    ValueError
        If a parameter is out of range.
    """
    if not 0 <= sh_degree <= MAX_SH_DEGREE:
        raise ValueError(f"SH degree {sh_degree}, expected 0 to {MAX_SH_DEGREE}")
    rng, counts, order = _layout(splats, seed)
    parts = [make(count, rng) for (_, _, make), count in zip(_PARTS, counts, strict=True) if count]
    surfels = concatenate(parts)
    # Frees the parts: surfels need nearly as much memory as the splats.
    parts.clear()
    return splats_from_surfels(surfels, objects.occluders(), rng, sh_degree, order)


def splats_from_surfels(
    surfels: Surfels,
    occluders: Occluders,
    rng: np.random.Generator,
    sh_degree: int,
    order: NDArray[np.intp] | None = None,
) -> Splats:
    """Convert surfels into splats, with their lighting baked into SH.

    Parameters
    ----------
    surfels : Surfels
        n surfels, y up.
    occluders : Occluders
        Shapes that cast shadows.
    rng : numpy.random.Generator
        Source of training noise and of the order of axes.
    sh_degree : int
        0 to 3.
    order : (n,) int, optional
        Surfel of each row; the order of the surfels by default.

    Returns
    -------
    Splats
        n splats, axes "RDF".
    """
    n = len(surfels.spread)
    splats = empty(sh_degree, n)
    axis_choices = _AxisChoices.draw(n, rng)
    for start in range(0, n, _BLOCK):
        rows = slice(start, min(start + _BLOCK, n))
        part = surfels.take(rows if order is None else order[rows])
        out = splats.take(rows)
        out.quats[:], out.scales[:] = _orientation(part, axis_choices.take(rows))
        sh = bake(part, occluders, rng)
        out.means[:] = part.patch.points * TO_SCENE
        out.opacities[:] = np.log(part.opacities_unit / (1.0 - part.opacities_unit))
        out.sh0[:] = sh[:, 0]
        out.shN[:] = sh[:, 1 : 1 + splats.shN.shape[1]]
    return splats


def synth_labels(splats: int = 120_000, seed: int = 7) -> NDArray[np.uint16]:
    """Return the label of each splat of `synth`.

    Parameters
    ----------
    splats, seed : int
        Arguments of `synth`.

    Returns
    -------
    (splats,) uint16
        Index into `LABELS`: 0 is the ground, 1 to 5 objects with disjoint bounding boxes, 6 hills,
        sky and floaters.
    """
    _, counts, order = _layout(splats, seed)
    labels = np.repeat([label for label, _, _ in _PARTS], counts).astype(np.uint16)
    return labels[order]


def synth_objects(splats: int = 120_000, seed: int = 7) -> NDArray[np.uint8]:
    """Return labels of three objects of `synth`, for the attribute ``object``.

    Parameters
    ----------
    splats, seed : int
        Arguments of `synth`.

    Returns
    -------
    (splats,) uint8
        1 + index into `OBJECTS`, or 0.
    """
    numbers = np.array([OBJECTS.index(name) + 1 if name in OBJECTS else 0 for name in LABELS])
    return numbers.astype(np.uint8)[synth_labels(splats, seed)]


def synth_cameras(views: int = 48, width: int = 480, height: int = 360) -> list[Camera]:
    """Return cameras around the scene: two orbits, then closer looks at each object.

    Parameters
    ----------
    views : int
        Number of cameras; of 48, every eighth (held out by evaluation) covers all three groups.
    width, height : int
        Image size, px.

    Returns
    -------
    list of Camera
        Horizontal field of view 54°, named ``view_00``, ``view_01`` …
    """
    low, high, close = split_count(views, (20, 16, 12))
    poses: list[tuple[F64, F64]] = []
    for count, distance, eye, aim in ((low, 5.9, 1.25, 0.62), (high, 6.4, 3.3, 0.35)):
        for i in range(count):
            angle = 2.0 * np.pi * (i + 0.25) / count
            poses.append((_polar(distance, angle, eye), np.array([0.0, aim, 0.0])))
    for i in range(close):
        _, (x, _, z) = objects.object_pose(LABELS[1 + i % 5])
        target = np.array([x, 0.6, z])
        # The teapot is viewed through the gaps of the ring, the others from outside it.
        if i % 5 == 0:
            angle, distance = np.radians(85.0 + 90.0 * (i // 5)), 1.8
        else:
            angle, distance = float(np.arctan2(z, x)) + 0.9 * (i // 5 - 0.6), 2.3
        poses.append((target + _polar(distance, angle, 0.4 + 0.3 * (i % 3)), target))
    focal = 0.5 * width / np.tan(np.radians(27.0))
    cameras = []
    for i, (eye_point, target) in enumerate(poses):
        forward = unit((target - eye_point) * TO_SCENE)
        name = f"view_{i:02d}"
        cameras.append(camera_at(eye_point * TO_SCENE, forward, width, height, focal, name))
    return cameras


def camera_at(
    position: F64, forward: F64, width: int, height: int, focal: float, name: str
) -> Camera:
    """Return a camera without roll.

    Parameters
    ----------
    position : (3,) float64
        Scene units, axes "RDF".
    forward : (3,) float64
        Unit vector, not straight up or down.
    width, height : int
        Image size, px.
    focal : float
        Focal length, px.
    name : str
    """
    rotation = _level_rotation(forward)
    return Camera(
        width=width,
        height=height,
        fx=focal,
        fy=focal,
        cx=0.5 * width,
        cy=0.5 * height,
        rotation=rotation,
        translation=-dot(rotation, position),
        name=name,
    )


def _polar(distance: float, angle: float, height: float) -> F64:
    """Return the point at a distance and angle around the y axis, at a height."""
    return np.array([distance * np.cos(angle), height, distance * np.sin(angle)])


def _level_rotation(forward: F64) -> F64:
    """Return the world-to-camera rotation of a level camera, in scene axes with +y down."""
    right = unit(np.cross(np.array([0.0, 1.0, 0.0]), forward))
    return np.stack([right, np.cross(forward, right), forward])


@dataclass(frozen=True)
class _AxisChoices:
    """Random cyclic order of axes and random quaternion norm of n splats.

    Parameters
    ----------
    first : (n,) int64
        Surfel axis that becomes the first axis of the splat, 0 to 2.
    norm : (n,) float64
        Factor of the unit quaternion: 0.5 to 2, with a random sign.
    """

    first: NDArray[np.int64]
    norm: F64

    @classmethod
    def draw(cls, n: int, rng: np.random.Generator) -> _AxisChoices:
        first = rng.integers(0, 3, n)
        norm = np.clip(np.exp(0.25 * rng.standard_normal(n)), 0.5, 2.0)
        norm *= rng.choice([-1.0, 1.0], n)
        return cls(first, norm)

    def take(self, rows: slice) -> _AxisChoices:
        return _AxisChoices(self.first[rows], self.norm[rows])


def _orientation(surfels: Surfels, axis_choices: _AxisChoices) -> tuple[F64, F64]:
    """Return quaternions (n, 4) of norms 0.5 to 2 and log scales (n, 3) in scene axes."""
    normals, tangents = surfels.patch.normals, surfels.patch.tangents
    axes = np.stack([tangents, np.cross(normals, tangents), normals], axis=1) * TO_SCENE
    # In trained scenes the thin direction can be any of the three axes.
    chosen = (axis_choices.first[:, None] + np.arange(3)) % 3
    axes = np.take_along_axis(axes, chosen[:, :, None], axis=1)
    scales = np.log(np.take_along_axis(surfels.sizes, chosen, axis=1))
    quats = _quaternions(axes) * axis_choices.norm[:, None]
    return quats, scales


def _quaternions(axes: F64) -> F64:
    """Return wxyz quaternions of the rotations whose columns are (n, 3, 3) rows of axes."""
    m = axes.transpose(0, 2, 1)
    xx, yy, zz = m[:, 0, 0], m[:, 1, 1], m[:, 2, 2]
    # Four ways to the same quaternion; the one with the largest part loses least (Shepperd 1978).
    a, b, c = m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]
    d, e, f = m[:, 1, 0] + m[:, 0, 1], m[:, 0, 2] + m[:, 2, 0], m[:, 2, 1] + m[:, 1, 2]
    ways = np.stack(
        [
            np.stack([1.0 + xx + yy + zz, a, b, c], axis=1),
            np.stack([a, 1.0 + xx - yy - zz, d, e], axis=1),
            np.stack([b, d, 1.0 - xx + yy - zz, f], axis=1),
            np.stack([c, e, f, 1.0 - xx - yy + zz], axis=1),
        ],
        axis=1,
    )
    best = np.argmax(np.stack([ways[:, i, i] for i in range(4)], axis=1), axis=1)
    picked = np.take_along_axis(ways, best[:, None, None], axis=1)[:, 0]
    result: F64 = picked / np.sqrt((picked * picked).sum(axis=1, keepdims=True))
    return result
