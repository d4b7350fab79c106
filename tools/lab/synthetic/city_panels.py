"""Flat panels of a city block: walls, roofs, sides of cars and marks on the road."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.geometry.rotations import from_matrices

from .city_plan import BLOCK_SIDE, HALF_ROAD, Block, Box, Car, Roof
from .patches import unit

F64 = NDArray[np.float64]
Vector = Sequence[float]

_UP: Final = (0.0, 1.0, 0.0)
_OVERHANG: Final = 0.45

# Rise of a roof over its half width.
_PITCH: Final = 0.75


class Kind(IntEnum):
    """Material of a panel."""

    WALL = 0
    PLAIN = 1
    FLAT_ROOF = 2
    TILES = 3
    GABLE = 4
    CAR = 5
    CAR_GLASS = 6
    MARK = 7
    WOOD = 8


@dataclass(frozen=True)
class Panel:
    """A rectangle, or the triangle over its lower side.

    Parameters
    ----------
    kind : Kind
    corner : (3,) sequence of float
        Lower left corner, as seen from outside, in the block.
    right, up : (3,) sequence of float
        Unit vectors along the sides; right × up points outwards.
    width, height : float
        Lengths of the sides.
    style : int
        Look.
    salt : float
        Random number in [0, 1) that varies the colours.
    floors : int
        Storeys with windows.
    base, storey : float
        Height of the first of them over the lower side, and of each.
    street : bool
        Whether there are shops on the ground floor.
    """

    kind: Kind
    corner: Vector
    right: Vector
    up: Vector
    width: float
    height: float
    style: int = 0
    salt: float = 0.0
    floors: int = 0
    base: float = 0.0
    storey: float = 0.0
    street: bool = False


@dataclass(frozen=True, eq=False)
class PanelTable:
    """Panels as arrays of one row each; see `Panel`.

    Parameters
    ----------
    corner, right, up, out : (m, 3) float64
    frame : (m, 4) float32
        Quaternion, wxyz, that turns x, y, z to right, up and outwards.
    width, height, salt, base, storey : (m,) float64
    kind, style, floors : (m,) int64
    street : (m,) bool
    """

    corner: F64
    right: F64
    up: F64
    out: F64
    frame: NDArray[np.float32]
    width: F64
    height: F64
    salt: F64
    base: F64
    storey: F64
    kind: NDArray[np.int64]
    style: NDArray[np.int64]
    floors: NDArray[np.int64]
    street: NDArray[np.bool_]


def panel_table(panels: list[Panel]) -> PanelTable:
    """Return panels as arrays."""
    right = np.array([p.right for p in panels], np.float64).reshape(-1, 3)
    up = np.array([p.up for p in panels], np.float64).reshape(-1, 3)
    out = np.cross(right, up)
    return PanelTable(
        np.array([p.corner for p in panels], np.float64).reshape(-1, 3),
        right,
        up,
        out,
        frames_of(right, up, out),
        np.array([p.width for p in panels], np.float64),
        np.array([p.height for p in panels], np.float64),
        np.array([p.salt for p in panels], np.float64),
        np.array([p.base for p in panels], np.float64),
        np.array([p.storey for p in panels], np.float64),
        np.array([p.kind for p in panels], np.int64),
        np.array([p.style for p in panels], np.int64),
        np.array([p.floors for p in panels], np.int64),
        np.array([p.street for p in panels], np.bool_),
    )


def frames_of(right: F64, up: F64, out: F64) -> NDArray[np.float32]:
    """Return wxyz quaternions (m, 4) that turn x, y, z to three orthogonal unit vectors."""
    return from_matrices(np.stack([right, up, out], axis=2)).astype(np.float32)


def block_panels(block: Block) -> list[Panel]:
    """Return the panels of a block; walls between attached houses are left out."""
    panels: list[Panel] = []
    for box in block.boxes:
        panels += _walls(block, box)
        panels += _roof(box)
    for car in block.cars:
        panels += _car(car)
    for x, z in block.benches:
        panels.append(Panel(Kind.WOOD, (x - 0.8, 0.55, z + 0.25), _X, (0, 0, -1), 1.6, 0.5))
        panels.append(Panel(Kind.WOOD, (x - 0.8, 0.6, z - 0.25), _X, _UP, 1.6, 0.45))
        panels.append(Panel(Kind.WOOD, (x + 0.8, 0.6, z - 0.27), (-1, 0, 0), _UP, 1.6, 0.45))
    panels += _marks()
    return panels


_X: Final = (1.0, 0.0, 0.0)


def _sides(box: Box) -> list[tuple[float, float, tuple[float, float, float], float]]:
    """Return x and z of the left corner, direction to the right, and width of a box's sides."""
    x0, z0, x1, z1 = box.x0, box.z0, box.x1, box.z1
    return [
        (x0, z1, (1.0, 0.0, 0.0), x1 - x0),
        (x1, z1, (0.0, 0.0, -1.0), z1 - z0),
        (x1, z0, (-1.0, 0.0, 0.0), x1 - x0),
        (x0, z0, (0.0, 0.0, 1.0), z1 - z0),
    ]


def _walls(block: Block, box: Box) -> list[Panel]:
    """Return the visible walls of a box, without walls behind neighbours."""
    storey = (box.y1 - box.y0 - box.base) / max(box.floors, 1)
    panels = []
    for x, z, right, width in _sides(box):
        out_x, out_z = -right[2], right[0]
        middle_x = x + 0.5 * width * right[0] + 0.4 * out_x
        middle_z = z + 0.5 * width * right[2] + 0.4 * out_z
        hidden = 0.0 if box.y0 > 0.0 else _height_at(block, middle_x, middle_z)
        if hidden >= box.y1:
            continue
        bottom = max(hidden, box.y0)
        if hidden > 0.0 or box.floors == 0:
            panels.append(
                Panel(
                    Kind.PLAIN,
                    (x, bottom, z),
                    right,
                    _UP,
                    width,
                    box.y1 - bottom,
                    box.style,
                    box.salt,
                )
            )
            continue
        distance = min(middle_x, middle_z, BLOCK_SIDE - middle_x, BLOCK_SIDE - middle_z)
        panels.append(
            Panel(
                Kind.WALL,
                (x, bottom, z),
                right,
                _UP,
                width,
                box.y1 - bottom,
                box.style,
                box.salt,
                box.floors,
                box.base,
                storey,
                distance < 8.1,
            )
        )
    return panels


def _height_at(block: Block, x: float, z: float) -> float:
    """Return the eaves of the highest box on the ground over a point, or 0."""
    return max(
        (b.y1 for b in block.boxes if b.y0 == 0.0 and b.x0 <= x <= b.x1 and b.z0 <= z <= b.z1),
        default=0.0,
    )


def _roof(box: Box) -> list[Panel]:
    """Return a flat roof with its parapet, or two slopes and two gables."""
    x0, z0, x1, z1, y = box.x0, box.z0, box.x1, box.z1, box.y1
    look = (box.style, box.salt)
    if box.roof is Roof.FLAT:
        flat = Panel(Kind.FLAT_ROOF, (x0, y, z1), _X, (0, 0, -1), x1 - x0, z1 - z0, *look)
        if box.floors == 0:
            return [flat]
        panels = [flat]
        # Both sides of a parapet.
        for x, z, (along, _, across), width in _sides(box):
            right, back = (along, 0.0, across), (-along, 0.0, -across)
            end = (x + along * width + 0.25 * across, y, z + across * width - 0.25 * along)
            panels.append(Panel(Kind.PLAIN, (x, y, z), right, _UP, width, 0.7, *look))
            panels.append(Panel(Kind.PLAIN, end, back, _UP, width, 0.7, *look))
        return panels
    return _ridge_roof(box)


def _ridge_roof(box: Box) -> list[Panel]:
    """Return the slopes and gables of a roof with a ridge."""
    x0, z0, x1, z1 = box.x0, box.z0, box.x1, box.z1
    look = (box.style, box.salt)
    along_x = box.roof is Roof.RIDGE_X
    length, half = (x1 - x0, 0.5 * (z1 - z0)) if along_x else (z1 - z0, 0.5 * (x1 - x0))
    rise = _PITCH * half
    middle = np.array([0.5 * (x0 + x1), 0.0, 0.5 * (z0 + z1)])
    panels = []
    for side in (1.0, -1.0):
        # Towards the eaves, and along the ridge, with the slope to the right.
        down = np.array([0.0, 0.0, side]) if along_x else np.array([side, 0.0, 0.0])
        right = np.array([side, 0.0, 0.0]) if along_x else np.array([0.0, 0.0, -side])
        up = unit(np.array([0.0, rise, 0.0]) - half * down)
        eaves = middle + down * (half + _OVERHANG) - right * 0.5 * length
        eaves[1] = box.y1 - _OVERHANG * _PITCH
        slope = float(np.hypot(half, rise)) * (half + _OVERHANG) / half
        panels.append(
            Panel(Kind.TILES, _vector(eaves), _vector(right), _vector(up), length, slope, *look)
        )
        gable = middle + right * 0.5 * length + down * half
        gable[1] = box.y1
        panels.append(
            Panel(Kind.GABLE, _vector(gable), _vector(-down), _UP, 2.0 * half, rise, *look)
        )
    return panels


def _vector(values: F64) -> Vector:
    """Return three numbers as a tuple."""
    x, y, z = values.tolist()
    return (x, y, z)


# Sides of a car along x: kind, then its lower left and right, and upper left corner.
_CAR: Final = (
    (Kind.CAR, (-2.1, 0.3, 0.9), (2.1, 0.3, 0.9), (-2.1, 0.85, 0.88)),
    (Kind.CAR, (2.1, 0.3, -0.9), (-2.1, 0.3, -0.9), (2.1, 0.85, -0.88)),
    (Kind.CAR, (2.1, 0.3, 0.9), (2.1, 0.3, -0.9), (2.15, 0.85, 0.9)),
    (Kind.CAR, (-2.1, 0.3, -0.9), (-2.1, 0.3, 0.9), (-2.15, 0.85, -0.9)),
    (Kind.CAR, (1.0, 0.92, 0.88), (2.1, 0.85, 0.88), (1.0, 0.92, -0.88)),
    (Kind.CAR, (-2.1, 0.88, 0.88), (-1.5, 0.9, 0.88), (-2.1, 0.88, -0.88)),
    (Kind.CAR_GLASS, (-1.6, 0.85, 0.88), (1.1, 0.85, 0.88), (-1.6, 1.42, 0.70)),
    (Kind.CAR_GLASS, (1.1, 0.85, -0.88), (-1.6, 0.85, -0.88), (1.1, 1.42, -0.70)),
    (Kind.CAR_GLASS, (1.1, 0.88, 0.85), (1.1, 0.88, -0.85), (0.45, 1.42, 0.85)),
    (Kind.CAR_GLASS, (-1.65, 0.88, -0.85), (-1.65, 0.88, 0.85), (-1.35, 1.42, -0.85)),
    (Kind.CAR, (-1.35, 1.43, 0.72), (0.45, 1.43, 0.72), (-1.35, 1.43, -0.72)),
)


def _car(car: Car) -> list[Panel]:
    """Return the sides of a car."""
    panels = []
    for kind, *corners in _CAR:
        a, b, c = np.array(corners)
        if not car.along_x:
            a, b, c = (np.array([p[2], p[1], -p[0]]) for p in (a, b, c))
        width, height = float(np.linalg.norm(b - a)), float(np.linalg.norm(c - a))
        right = (b - a) / width
        up = c - a - right * float((c - a) @ right)
        foot = a + np.array([car.x, 0.0, car.z])
        panels.append(
            Panel(kind, _vector(foot), _vector(right), _vector(unit(up)), width, height, car.colour)
        )
    return panels


def _marks() -> list[Panel]:
    """Return the white marks on the roads from a block's corner along x and along z."""
    panels = []

    def mark(x0: float, z0: float, x1: float, z1: float) -> None:
        panels.append(Panel(Kind.MARK, (x0, 0.012, z1), _X, (0, 0, -1), x1 - x0, z1 - z0))

    for i in range(8):
        low = 13.0 + 5.0 * i
        mark(low, -0.09, low + 2.6, 0.09)
        mark(-0.09, low, 0.09, low + 2.6)
    for i in range(8):
        low = -HALF_ROAD + 0.4 + 1.1 * i
        for start in (6.0, -9.0):
            mark(low, start, low + 0.55, start + 3.0)
            mark(start, low, start + 3.0, low + 0.55)
    return panels
