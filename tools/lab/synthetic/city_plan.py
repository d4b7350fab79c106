"""Plan of a synthetic city: streets in a grid, and what stands on each block.

Lengths are metres, y is up. A block is a square from the middle of a street to the middle of the
next; its coordinates start at its corner with the least x and z.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from itertools import pairwise
from typing import Final

import numpy as np

BLOCK_SIDE: Final = 64.0
"""Distance between the middles of neighbouring streets."""

HALF_STREET: Final = 8.0
"""Distance of the house fronts from the middle of the street."""

HALF_ROAD: Final = 4.5
"""Distance of the kerb from the middle of the street."""

KERB: Final = 0.12
"""Height of the pavement above the road."""

SPLATS_PER_BLOCK: Final = 150_000
"""Splats per block at which neighbours on a wall are about 0.25 m apart."""

# Depth of the houses around a court.
_DEPTH: Final = 12.0
_LOW, _HIGH = HALF_STREET, BLOCK_SIDE - HALF_STREET


class Use(IntEnum):
    """Use of a block."""

    COURT = 0
    TOWER = 1
    ROWS = 2
    PARK = 3


class Roof(IntEnum):
    """Shape of a roof; a ridge runs along x or z."""

    FLAT = 0
    RIDGE_X = 1
    RIDGE_Z = 2


# Blocks of each use among a hundred.
_USES: Final = (60, 14, 16, 10)

HOUSE_STYLES: Final = 8
"""Number of looks of houses; the looks of towers follow."""

TOWER_STYLES: Final = 2


@dataclass(frozen=True)
class Box:
    """A house, tower or roof box.

    Parameters
    ----------
    x0, z0, x1, z1 : float
        Footprint in the block.
    y0, y1 : float
        Bottom and eaves.
    roof : Roof
    style : int
        Look of its walls.
    floors : int
        Storeys with windows above the ground floor; 0 for walls without windows.
    base : float
        Height of the ground floor.
    salt : float
        Random number in [0, 1) that varies its colours.
    """

    x0: float
    z0: float
    x1: float
    z1: float
    y0: float
    y1: float
    roof: Roof = Roof.FLAT
    style: int = 0
    floors: int = 0
    base: float = 0.0
    salt: float = 0.0


@dataclass(frozen=True)
class Tree:
    """A tree: foot, height of the crown's middle, and radius of the crown."""

    x: float
    z: float
    middle: float
    radius: float
    hue: float


@dataclass(frozen=True)
class Car:
    """A parked car: middle, whether it stands along x, and number of its colour."""

    x: float
    z: float
    along_x: bool
    colour: int


@dataclass(frozen=True)
class Lamp:
    """A street lamp: foot, and the direction of its arm along x and z."""

    x: float
    z: float
    arm_x: float
    arm_z: float


@dataclass(frozen=True)
class Block:
    """Contents of a block, in its own coordinates."""

    use: Use
    boxes: list[Box] = field(default_factory=list)
    trees: list[Tree] = field(default_factory=list)
    cars: list[Car] = field(default_factory=list)
    lamps: list[Lamp] = field(default_factory=list)
    benches: list[tuple[float, float]] = field(default_factory=list)

    @property
    def weight(self) -> float:
        """Surface in m², weighted by detail: the block's share of the splats."""
        walls = sum(2.0 * (b.x1 - b.x0 + b.z1 - b.z0) * (b.y1 - b.y0) for b in self.boxes)
        return BLOCK_SIDE**2 + 0.8 * walls + 60.0 * len(self.trees) + 20.0 * len(self.cars)


@dataclass(frozen=True)
class City:
    """A grid of blocks around the origin.

    Parameters
    ----------
    columns, rows : int
        Number of blocks along x and z.
    blocks : list of Block
        Blocks in rows.
    """

    columns: int
    rows: int
    blocks: list[Block]

    @property
    def half_x(self) -> float:
        """Half of the city's length along x."""
        return 0.5 * BLOCK_SIDE * self.columns

    @property
    def half_z(self) -> float:
        """Half of the city's length along z."""
        return 0.5 * BLOCK_SIDE * self.rows

    def corner(self, number: int) -> tuple[float, float]:
        """Return the corner of a block with the least x and z."""
        row, column = divmod(number, self.columns)
        return column * BLOCK_SIDE - self.half_x, row * BLOCK_SIDE - self.half_z

    def around(self, number: int) -> list[tuple[float, float, Block]]:
        """Return a block and its neighbours, each with the offset of its corner."""
        row, column = divmod(number, self.columns)
        found = []
        for down in (-1, 0, 1):
            for across in (-1, 0, 1):
                if 0 <= row + down < self.rows and 0 <= column + across < self.columns:
                    block = self.blocks[number + down * self.columns + across]
                    found.append((across * BLOCK_SIDE, down * BLOCK_SIDE, block))
        return found


def plan_city(splats: int, seed: int) -> City:
    """Plan a city with room for a number of splats.

    Parameters
    ----------
    splats : int
        Number of splats, at least 1; there is a block for each `SPLATS_PER_BLOCK`.
    seed : int
        Seed; a block depends on it and on its place in the grid.
    """
    blocks = max(1.0, splats / SPLATS_PER_BLOCK)
    columns = max(1, round(blocks**0.5))
    rows = max(1, round(blocks / columns))
    places = [(column, row) for row in range(rows) for column in range(columns)]
    return City(columns, rows, [_block(np.random.default_rng([seed, 0, *at])) for at in places])


def _block(rng: np.random.Generator) -> Block:
    """Return a block of random use."""
    use = Use(int(rng.choice(len(_USES), p=np.array(_USES) / sum(_USES))))
    block = Block(use)
    make = {Use.COURT: _court, Use.TOWER: _tower, Use.ROWS: _rows, Use.PARK: _park}
    make[use](block, rng)
    _street(block, rng)
    return block


def _house(
    rng: np.random.Generator, corners: tuple[float, float, float, float], floors: int, roof: Roof
) -> list[Box]:
    """Return a house, and the boxes on its roof where that is flat."""
    x0, z0, x1, z1 = corners
    base = float(rng.uniform(3.4, 4.2))
    height = base + 3.1 * floors
    style, salt = int(rng.integers(HOUSE_STYLES)), float(rng.random())
    made = [Box(x0, z0, x1, z1, 0.0, height, roof, style, floors, base, salt)]
    if roof is Roof.FLAT:
        for _ in range(int(rng.integers(1, 4))):
            x, z = rng.uniform(x0 + 1.5, x1 - 3.5), rng.uniform(z0 + 1.5, z1 - 3.5)
            size = rng.uniform(0.9, 2.2, 3)
            made.append(
                Box(x, z, x + size[0], z + size[2], height, height + size[1], style=-1, salt=salt)
            )
    return made


def _court(block: Block, rng: np.random.Generator) -> None:
    """Put attached houses around a court with trees."""
    cuts = [_LOW, _LOW + _DEPTH, 0.5 * round(2.0 * rng.uniform(30.0, 34.0)), _HIGH - _DEPTH, _HIGH]
    usual = int(rng.integers(3, 6))
    for first, last in pairwise(cuts):
        for low, high in ((_LOW, _LOW + _DEPTH), (_HIGH - _DEPTH, _HIGH)):
            floors = max(2, usual + int(rng.integers(-1, 2)))
            corner = first == _LOW or last == _HIGH
            # A corner house has neighbours on two sides, which a ridge does not suit.
            roof = Roof.FLAT if corner or rng.random() < 0.35 else Roof.RIDGE_X
            block.boxes.extend(_house(rng, (first, low, last, high), floors, roof))
    cuts[2] = 0.5 * round(2.0 * rng.uniform(30.0, 34.0))
    for first, last in pairwise(cuts[1:-1]):
        for low, high in ((_LOW, _LOW + _DEPTH), (_HIGH - _DEPTH, _HIGH)):
            floors = max(2, usual + int(rng.integers(-1, 2)))
            roof = Roof.FLAT if rng.random() < 0.35 else Roof.RIDGE_Z
            block.boxes.extend(_house(rng, (low, first, high, last), floors, roof))
    for _ in range(int(rng.integers(3, 7))):
        x, z = rng.uniform(24.0, 40.0, 2)
        block.trees.append(_tree(rng, x, z, 3.5, 6.0))


def _tower(block: Block, rng: np.random.Generator) -> None:
    """Put a tower and a pavilion on a square."""
    x, z = (0.5 * round(2.0 * value) for value in rng.uniform(20.0, 26.0, 2))
    floors, side = int(rng.integers(9, 14)), 0.5 * round(2.0 * rng.uniform(14.0, 18.0))
    height = 4.5 + 3.2 * floors
    style = HOUSE_STYLES + int(rng.integers(TOWER_STYLES))
    salt = float(rng.random())
    block.boxes.append(
        Box(x, z, x + side, z + side, 0.0, height, Roof.FLAT, style, floors, 4.5, salt)
    )
    inner = (x + 3.0, z + 3.0, x + side - 3.0, z + side - 3.0)
    block.boxes.append(Box(*inner, height, height + 3.0, style=-1, salt=salt))
    block.boxes.extend(_house(rng, (_LOW, _HIGH - 10.0, _HIGH - 14.0, _HIGH), 1, Roof.FLAT))
    for i in range(5):
        for j in range(2):
            block.trees.append(_tree(rng, 50.0 + 4.5 * j, 12.0 + 8.0 * i, 2.6, 4.6))
            block.benches.append((48.0 + 4.5 * j, 16.0 + 8.0 * i))


def _rows(block: Block, rng: np.random.Generator) -> None:
    """Put two rows of ridged houses and gardens on a block."""
    for low, high in ((_LOW + 3.0, _LOW + 13.0), (_HIGH - 13.0, _HIGH - 3.0)):
        for i in range(4):
            first = _LOW + 1.0 + 12.0 * i
            floors = int(rng.integers(1, 3))
            corners = (first, low, first + 0.5 * round(2.0 * rng.uniform(8.0, 10.0)), high)
            roof = Roof.RIDGE_X if rng.random() < 0.5 else Roof.RIDGE_Z
            block.boxes.extend(_house(rng, corners, floors, roof))
    for i in range(6):
        for z in (26.0, 38.0):
            x = _LOW + 3.0 + 8.0 * i + rng.uniform(-1.5, 1.5)
            block.trees.append(_tree(rng, x, z + rng.uniform(-3.0, 3.0), 2.4, 5.0))


def _park(block: Block, rng: np.random.Generator) -> None:
    """Put trees and benches on a block, and leave its paths free."""
    for i in range(7):
        for j in range(7):
            x, z = 12.0 + 6.7 * np.array([i, j]) + rng.uniform(-2.0, 2.0, 2)
            if park_path(x, z) > 2.0 and rng.random() < 0.8:
                block.trees.append(_tree(rng, x, z, 3.2, 7.5))
    for i in range(4):
        block.benches.append((29.6, 14.0 + 11.0 * i))


def park_path(x: float, z: float) -> float:
    """Return the distance of a point to the nearest path of a park."""
    return min(abs(x - 32.0), abs(z - 32.0), abs(float(np.hypot(x - 32.0, z - 32.0)) - 14.0))


def _tree(rng: np.random.Generator, x: float, z: float, low: float, high: float) -> Tree:
    """Return a tree with its crown's middle between two heights."""
    middle = float(rng.uniform(low, high))
    return Tree(x, z, middle, middle * float(rng.uniform(0.34, 0.48)), float(rng.random()))


def _street(block: Block, rng: np.random.Generator) -> None:
    """Put trees, lamps and parked cars along the four half-streets of a block."""
    for side in range(4):
        near = side < 2
        along_x = side % 2 == 0

        def place(
            across: float, along: float, near: bool = near, along_x: bool = along_x
        ) -> tuple[float, float]:
            edge = across if near else BLOCK_SIDE - across
            return (along, edge) if along_x else (edge, along)

        if rng.random() < 0.75:
            for i in range(5):
                if rng.random() < 0.85:
                    x, z = place(5.5, 14.0 + 9.0 * i + rng.uniform(-0.5, 0.5))
                    block.trees.append(_tree(rng, x, z, 3.4, 4.8))
        arm = -1.0 if near else 1.0
        for along in (18.5, 45.5):
            x, z = place(5.0, along)
            block.lamps.append(Lamp(x, z, 0.0 if along_x else arm, arm if along_x else 0.0))
        for i in range(6):
            if rng.random() < 0.55:
                x, z = place(3.3, 15.0 + 6.4 * i + rng.uniform(-0.4, 0.4))
                block.cars.append(Car(x, z, along_x, int(rng.integers(7))))
        if rng.random() < 0.5:
            block.benches.append(place(6.4, 23.0))
