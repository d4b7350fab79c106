"""Pictures of the conformance vectors: small scenes, cameras, and what each picture shows."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final

from cogsplat.codec.streams.records import Attribute
from cogsplat.formats.cogs.canonical_msgpack import Value

from . import handmade_streams as handmade
from .file_builder import build, one_chunk, pack_streams
from .reference_drawing import Camera

_FOCAL: Final = 45.0
_DISTANCE: Final = 4.0
_BEHIND: Final = (0.0, 0.0, -_DISTANCE)
"""Position of the usual camera."""

Row = list[float]


@dataclass(frozen=True)
class Drawing:
    """A picture of a scene.

    Parameters
    ----------
    name : str
    scene : str
        Name of the scene's file.
    camera : Camera
    note : str
        Description of the case.
    """

    name: str
    scene: str
    camera: Camera
    note: str


def _random(count: int, low: float, high: float, seed: int) -> Row:
    """Return pseudo-random multiples of 1/10,000 of a range."""
    return [low + (high - low) * k / 10_000 for k in handmade.pseudo_random(count, 10_001, seed)]


@dataclass(frozen=True)
class _Splat:
    """Mean, log scales and logit of a splat that is made for one rule."""

    mean: tuple[float, float, float]
    scales: tuple[float, float, float]
    logit: float


_SPECIAL: Final = (
    # A stack of opaque splats, by which pixels end.
    *(
        _Splat((0.3, 0.2, 0.3 * i - 0.3), (-1.0, -1.2, -2.0), logit)
        for i, logit in enumerate((2.5, 2.5, 9.0, 6.0, 6.0))
    ),
    # One that is opaque in the middle, before all others.
    _Splat((-0.95, -0.55, -1.0), (-1.2, -1.2, -1.2), 9.0),
    # Wide splats outside the picture, where tangents are clamped: right, left, above and below.
    _Splat((4.1, 0.5, 0.5), (0.2, -1.0, 0.3), 1.5),
    _Splat((-4.4, -0.3, 0.05), (-0.6, 0.1, 0.5), 1.0),
    _Splat((-0.5, -3.3, 0.2), (-0.9, 0.0, 0.4), 1.2),
    _Splat((0.6, 3.6, -0.1), (0.1, -0.2, 0.3), 0.8),
    # Before and behind the near plane of the usual camera, and behind that camera.
    _Splat((-0.07, -0.05, -_DISTANCE + 0.19), (-4.0, -4.0, -4.0), 3.0),
    _Splat((-0.07, 0.06, -_DISTANCE + 0.21), (-4.5, -5.0, -4.5), 3.0),
    _Splat((0.1, 0.1, -_DISTANCE - 1.0), (-0.5, -0.5, -0.5), 3.0),
    # Needles and a disc that are thinner than a pixel.
    _Splat((-0.8, 0.4, -0.6), (-0.4, -8.0, -8.5), 2.5),
    _Splat((0.9, -0.5, -0.41), (-8.0, -0.7, -7.0), 4.0),
    _Splat((-0.2, -0.7, -0.8), (-1.2, -1.4, -9.0), 2.0),
    # Fainter than 1/255 everywhere.
    _Splat((0.0, 0.0, -1.1), (-0.5, -0.5, -0.5), -5.6),
)
_RANDOM: Final = 28


def _scene(degree: int, seed: int, **root: Value) -> bytes:
    """Return the file of a scene: splats that are made for a rule, and pseudo-random ones."""
    rows = _RANDOM + len(_SPECIAL)
    means = zip(
        *(_random(_RANDOM, -w, w, seed + i) for i, w in enumerate((1.3, 1.0, 0.9))), strict=True
    )
    scales = zip(*(_random(_RANDOM, -4.5, -0.9, seed + 10 + i) for i in range(3)), strict=True)
    logits = _random(_RANDOM, -1.5, 4.0, seed + 20)
    dc = zip(*(_random(rows, -1.8, 1.8, seed + 30 + i) for i in range(3)), strict=True)
    head = [
        handmade.floats(Attribute.SCALES, [*scales, *(splat.scales for splat in _SPECIAL)]),
        handmade.random_quats(rows, seed + 40, largest=[row % 4 for row in range(rows)]),
        handmade.floats(Attribute.MEANS, [*means, *(splat.mean for splat in _SPECIAL)]),
        handmade.floats(
            Attribute.OPACITIES, [[x] for x in [*logits, *(splat.logit for splat in _SPECIAL)]]
        ),
        handmade.floats(Attribute.SH0, list(dc)),
    ]
    bands = [
        handmade.floats(
            attribute, [_random(3 * count, -0.25, 0.25, seed + 50 + row) for row in range(rows)]
        )
        for attribute, count in ((Attribute.SH1, 3), (Attribute.SH2, 5), (Attribute.SH3, 7))
    ]
    tail = pack_streams(bands[:degree]) if degree else None
    draft = one_chunk(pack_streams(head), rows, tail=tail, sh_degree=degree, reach=16.0)
    return build(draft, lambda _, index: index.update(root))


def _capture(*viewpoints: tuple[float, float, float, float]) -> bytes:
    return b"".join(struct.pack("<4f", *viewpoint) for viewpoint in viewpoints)


_AROUND: Final = (
    (0.5, -0.25, -3.0, 90.0),
    (-3.0, 1.0, -4.0, 25.0),
    (4.0, 2.0, 3.0, 200.0),
    (-1.0, 0.5, -12.0, 60.0),
)


def scenes() -> dict[str, bytes]:
    """Return the files of the scenes by name; the first three have the same splats."""
    viewpoint = _capture((*_BEHIND, _FOCAL))
    return {
        "kernel": _scene(3, 5),
        "mip": _scene(3, 5, kernel_px=0.1, antialiased=True, capture=viewpoint),
        "viewpoint": _scene(3, 5, capture=viewpoint),
        "viewpoints": _scene(0, 6, kernel_px=0.15, capture=_capture(*_AROUND)),
    }


_AHEAD: Final = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
_TURNED: Final = [0.6, 0.0, -0.8, 0.48, 0.8, 0.36, 0.64, -0.6, 0.48]


def _camera(
    width: int,
    height: int,
    focal: float,
    translation: tuple[float, float, float] = (0.0, 0.0, _DISTANCE),
    rotation: Row = _AHEAD,
) -> Camera:
    """Return a camera with its principal point in the middle; by default it looks along +z."""
    return Camera(width, height, focal, focal, width / 2, height / 2, rotation, list(translation))


def drawings() -> list[Drawing]:
    """Return the pictures, in the order of the manifest."""
    whole = _camera(48, 36, _FOCAL)
    half, quarter = _camera(24, 18, _FOCAL / 2), _camera(12, 9, _FOCAL / 4)
    oblique = Camera(48, 36, 42.0, 47.0, 21.0, 20.5, _TURNED, [0.2, -0.1, 3.5])
    far, near = (0.0, 0.0, 4 * _DISTANCE), (0.0, 0.0, 1.5)
    x, y, z, focal = _AROUND[0]
    return [
        Drawing("usual", "kernel", whole, "no viewpoints: `kernel_px` in every picture"),
        Drawing("usual-half", "kernel", half, "half the size, with the same `kernel_px`"),
        Drawing("oblique", "kernel", oblique, "turned, pixels not square, principal point aside"),
        Drawing("antialiased", "mip", half, "`antialiased`; `capture` is there and not used"),
        Drawing("same", "viewpoint", whole, "the picture of training, equal to `usual`"),
        Drawing("half", "viewpoint", half, "half the size"),
        Drawing("quarter", "viewpoint", quarter, "a quarter of the size"),
        Drawing("far", "viewpoint", _camera(24, 18, _FOCAL, far), "4 times the distance"),
        Drawing("near", "viewpoint", _camera(48, 36, _FOCAL, near), "nearer than in training"),
        Drawing("large", "viewpoint", _camera(48, 36, 2.3 * _FOCAL), "2.3 times the focal length"),
        Drawing(
            "between",
            "viewpoints",
            _camera(48, 36, 45.0, (0.1, 0.2, 4.5), _TURNED),
            "four viewpoints of several focal lengths; SH degree 0; `kernel_px` 0.15",
        ),
        Drawing(
            "at-one",
            "viewpoints",
            _camera(48, 36, focal / 2, (-x, -y, -z)),
            "at one of the viewpoints, with half its focal length",
        ),
    ]
