"""Streams for the conformance vectors, with codes from integer arithmetic instead of a quantiser.

The streams do not depend on the version of a numerical library, so the files never change.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.geometry import morton
from cogsplat.codec.streams import bit_fields, grid_planes
from cogsplat.codec.streams import sorted_means as sorted_streams
from cogsplat.codec.streams.adaptive_step import StepModel
from cogsplat.codec.streams.grid import Grid
from cogsplat.codec.streams.quaternion import PER_ROW
from cogsplat.codec.streams.records import (
    COMPONENTS,
    ESCAPE,
    INFINITIES,
    Attribute,
    Kind,
    Stream,
)

U32 = NDArray[np.uint32]

GridRow = tuple[float, float, int]
"""Minimum, maximum and number of levels of one component's grid."""

NO_EXTRA_BITS: Final = StepModel.constant(0)
"""Step model of means without extra bits."""


def pseudo_random(count: int, below: int, seed: int) -> list[int]:
    """Return `count` pseudo-random integers in [0, below), the same on every platform."""
    state, out = seed * 2654435761 + 1, []
    for _ in range(count):
        state = (state * 6364136223846793005 + 1442695040888963407) % (1 << 64)
        out.append((state >> 33) % below)
    return out


def grid(rows: Sequence[GridRow]) -> Grid:
    """Return a grid, given minimum, maximum and number of levels of each component."""
    low, high, levels = zip(*rows, strict=True)
    return Grid(np.array(low, np.float32), np.array(high, np.float32), np.array(levels, np.uint32))


def scalar(
    attribute: Attribute,
    rows: Sequence[GridRow],
    codes: Sequence[Sequence[int]],
    *,
    flags: int = 0,
    levels: Sequence[int] | None = None,
) -> Stream:
    """Return a scalar stream of given codes.

    Parameters
    ----------
    attribute : Attribute
    rows : sequence of (float, float, int)
        Grid of each component.
    codes : sequence of sequence of int
        Codes of each component, one per row of the stream.
    flags : int
    levels : sequence of int, optional
        Number of levels from which the planes of each component are counted; by default those of
        the grid.
    """
    extra = 2 if flags & INFINITIES else 0
    cut = levels or [count + extra for _, _, count in rows]
    planes = [
        plane
        for column, count in zip(codes, cut, strict=True)
        for plane in grid_planes.split_planes(np.array(column, np.uint32), count)
    ]
    return Stream(attribute, Kind.SCALAR, len(codes[0]), grid(rows).pack(), planes, flags)


def random_scalar(
    attribute: Attribute,
    rows: int,
    seed: int,
    *,
    span: float = 1.0,
    levels: int = 100,
    escape: bool = False,
) -> Stream:
    """Return a scalar stream of pseudo-random codes; each component has its own range."""
    components = COMPONENTS[attribute]
    ranges = [(-span - 0.1 * i, span + 0.3 * i, levels + i) for i in range(components)]
    codes = [pseudo_random(rows, count, seed + 97 * i) for i, (_, _, count) in enumerate(ranges)]
    return scalar(attribute, ranges, codes, flags=ESCAPE if escape else 0)


def constant(attribute: Attribute, rows: int, *values: float) -> Stream:
    """Return a scalar stream without planes: one value per component, shared by all rows."""
    columns = [[0] * rows] * len(values)
    return scalar(attribute, [(value, value, 1) for value in values], columns)


def random_quats(
    rows: int,
    seed: int,
    *,
    largest: int | Sequence[int] = 0,
    ranges: Sequence[GridRow] = ((-0.5, 0.5, 64), (-0.4, 0.6, 300), (-0.3, 0.5, 33)),
    escape: bool = False,
) -> Stream:
    """Return a quat stream of pseudo-random codes.

    Parameters
    ----------
    rows, seed : int
        Number of rows; seed of the codes.
    largest : int or sequence of int
        Index of the omitted component, for all rows or per row.
    ranges : sequence of (float, float, int)
        Grids of the three stored components.
    escape : bool
        Whether the stream holds escape rows.
    """
    each = not isinstance(largest, int)
    codes = [pseudo_random(rows, count, seed + 31 * i) for i, (_, _, count) in enumerate(ranges)]
    body = scalar(Attribute.QUATS, ranges, codes)
    params = struct.pack("<B3x", PER_ROW if each else largest) + body.params
    first = [np.array(largest, np.uint8)] if each else []
    flags = ESCAPE if escape else 0
    return Stream(Attribute.QUATS, Kind.QUAT, rows, params, [*first, *body.planes], flags)


def sorted_means(
    cells: Sequence[Sequence[int]],
    rows: Sequence[GridRow],
    model: StepModel = NO_EXTRA_BITS,
    extra_bits: Sequence[int] | None = None,
    seed: int = 1,
) -> Stream:
    """Return a sorted stream of means.

    Parameters
    ----------
    cells : sequence of sequence of int
        Cell coordinates of each row, in any order.
    rows : sequence of (float, float, int)
        Grid of the cells, by component.
    model : StepModel
    extra_bits : sequence of int, optional
        Number of extra bits per axis that the model gives each row; 0 by default. The values of
        the bits are pseudo-random.
    seed : int
    """
    codes = np.array(cells, np.uint32)
    keys = np.sort(morton.interleave(codes), kind="stable")
    classes, differences = sorted_streams.pack_differences(keys)
    wide = np.array(extra_bits if extra_bits is not None else [0] * len(codes), np.uint8)
    fields = [pseudo_random(1, 1 << 3 * int(h), seed + 5 * i)[0] for i, h in enumerate(wide)]
    below = bit_fields.pack(np.array(fields, np.uint64), wide * np.uint8(3))
    params = grid(rows).pack() + model.pack()
    planes = [classes, differences, below]
    return Stream(Attribute.MEANS, Kind.SORTED, len(codes), params, planes)


def vq(attribute: Attribute, codes: Sequence[int], book: int, size: int, escape: int) -> Stream:
    """Return a vq stream of indices into codebook `book`; `size` stands for an escape row."""
    planes = grid_planes.split_planes(np.array(codes, np.uint32), size + min(escape, 1))
    return Stream(attribute, Kind.VQ, len(codes), struct.pack("<II", book, escape), planes)


def floats(attribute: Attribute, values: Sequence[Sequence[float]]) -> Stream:
    """Return a float stream of rows of values."""
    rows = [struct.pack(f"<{len(row)}f", *row) for row in values]
    octets = np.frombuffer(b"".join(rows), np.uint8).reshape(len(values), -1)
    planes = [np.ascontiguousarray(octets[:, i]) for i in range(octets.shape[1])]
    return Stream(attribute, Kind.FLOAT, len(values), b"", planes)


def random_head(rows: int, seed: int, *changed: Stream) -> list[Stream]:
    """Return the streams of a pseudo-random chunk head; `changed` replaces some by attribute."""
    plain = [
        random_scalar(Attribute.SCALES, rows, seed + 3, span=4.0, levels=90),
        random_quats(rows, seed + 4),
        random_scalar(Attribute.MEANS, rows, seed, span=3.0, levels=1000),
        random_scalar(Attribute.OPACITIES, rows, seed + 1, span=5.0, levels=30),
        random_scalar(Attribute.SH0, rows, seed + 2, span=1.5, levels=200),
    ]
    return _replaced(plain, changed)


def _replaced(plain: Sequence[Stream], changed: Sequence[Stream]) -> list[Stream]:
    """Return the streams of `plain`, replaced by the streams in `changed` of equal attribute."""
    found = {stream.attribute: stream for stream in changed}
    return [found.get(stream.attribute, stream) for stream in plain]


def stream_index(body: Sequence[Stream], attribute: Attribute) -> int:
    """Return the index of an attribute's stream."""
    return [stream.attribute for stream in body].index(attribute)


def uniform_head(rows: int, *changed: Stream) -> list[Stream]:
    """Return the streams of a head of equal splats; `changed` replaces some by attribute."""

    def flat(attribute: Attribute) -> Stream:
        return constant(attribute, rows, *[0.5] * COMPONENTS[attribute])

    others = [flat(a) for a in (Attribute.MEANS, Attribute.OPACITIES, Attribute.SH0)]
    turned = random_quats(rows, 1, ranges=[(0.0, 0.0, 1)] * 3)
    return _replaced([flat(Attribute.SCALES), turned, *others], changed)


def vq_head(
    rows: int, seed: int, shape: Stream, *escape: Stream, still: bool = False
) -> list[Stream]:
    """Return the streams of a head whose shapes come from a codebook.

    With `still`, the other attributes are equal for all splats, otherwise pseudo-random.
    """
    return [
        *escape,
        shape,
        random_scalar(Attribute.SCALE_FACTOR, rows, seed + 5, span=2.0, levels=50),
        *(uniform_head(rows) if still else random_head(rows, seed))[2:],
    ]


def shape_codebook(rows: int, seed: int) -> list[Stream]:
    """Return the pseudo-random streams of a shape codebook."""
    return [
        random_scalar(Attribute.SCALES, rows, seed, span=1.0, levels=60),
        random_quats(rows, seed + 1, largest=[i % 4 for i in range(rows)]),
    ]


def band(number: int, rows: int, seed: int, *, escape: bool = False) -> Stream:
    """Return a pseudo-random stream of SH band `number`, which is 1 to 3."""
    attribute = (Attribute.SH1, Attribute.SH2, Attribute.SH3)[number - 1]
    return random_scalar(attribute, rows, seed + number, span=0.5, levels=17, escape=escape)


def bands(degree: int, rows: int, seed: int, *, escape: bool = False) -> list[Stream]:
    """Return pseudo-random streams of all SH bands up to a degree."""
    return [band(number, rows, seed, escape=escape) for number in range(1, degree + 1)]
