"""Panels of a city block as elements: walls, windows, roofs, cars."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from .city_cover import hashed, normal_numbers, sheet, uneven
from .city_light import Elements
from .city_panels import Kind, PanelTable
from .city_plan import HOUSE_STYLES
from .materials import split_count
from .patches import R2

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
Rows = NDArray[np.int64]

# Wall, trim and roof of each look, linear colours; towers last, and roof boxes as number -1.
_LOOKS: Final = np.array(
    [
        [(0.42, 0.16, 0.10), (0.66, 0.62, 0.54), (0.30, 0.10, 0.06)],
        [(0.68, 0.58, 0.40), (0.74, 0.72, 0.68), (0.36, 0.13, 0.07)],
        [(0.62, 0.60, 0.55), (0.42, 0.40, 0.37), (0.14, 0.14, 0.16)],
        [(0.55, 0.34, 0.24), (0.72, 0.66, 0.56), (0.20, 0.16, 0.14)],
        [(0.36, 0.42, 0.44), (0.74, 0.73, 0.70), (0.12, 0.12, 0.14)],
        [(0.72, 0.66, 0.60), (0.50, 0.30, 0.22), (0.40, 0.16, 0.09)],
        [(0.30, 0.12, 0.09), (0.58, 0.55, 0.50), (0.16, 0.15, 0.15)],
        [(0.58, 0.50, 0.30), (0.34, 0.28, 0.20), (0.28, 0.11, 0.07)],
        [(0.30, 0.33, 0.36), (0.50, 0.53, 0.56), (0.22, 0.22, 0.23)],
        [(0.56, 0.54, 0.50), (0.20, 0.21, 0.23), (0.24, 0.24, 0.24)],
        [(0.40, 0.41, 0.42), (0.40, 0.41, 0.42), (0.30, 0.31, 0.32)],
    ]
)

# Half width of a window as a share of its bay, and its height as a share of the storey.
_OPENINGS: Final = np.array(
    [
        (0.21, 0.52),
        (0.19, 0.56),
        (0.27, 0.48),
        (0.20, 0.54),
        (0.32, 0.50),
        (0.18, 0.60),
        (0.24, 0.50),
        (0.21, 0.58),
        (0.46, 0.80),
        (0.40, 0.62),
    ]
)
_BAY: Final = 2.9

_PAINTS: Final = np.array(
    [
        (0.50, 0.04, 0.03),
        (0.05, 0.11, 0.32),
        (0.62, 0.63, 0.65),
        (0.03, 0.03, 0.035),
        (0.34, 0.36, 0.38),
        (0.06, 0.20, 0.12),
        (0.70, 0.66, 0.55),
    ]
)
_SIGNS: Final = np.array(
    [(0.45, 0.05, 0.04), (0.04, 0.16, 0.30), (0.06, 0.24, 0.10), (0.55, 0.38, 0.05)]
)


def _spread(table: PanelTable, rows: Rows, counts: NDArray[np.int64]) -> tuple[Rows, F32, F32]:
    """Return the panel of each point, and its place along both sides, metres."""
    total = int(counts.sum())
    of = np.repeat(np.arange(len(rows)), counts)
    number = np.arange(total) - np.repeat(np.cumsum(counts) - counts, counts)
    start = (rows * 0.6180339887498949) % 1.0
    u = (number * R2[0] + start[of]) % 1.0
    v = (number * R2[1] + 0.5 + start[of]) % 1.0
    of = rows[of]
    return of, (u * table.width[of]).astype(np.float32), (v * table.height[of]).astype(np.float32)


def _places(table: PanelTable, of: Rows, u: F32, v: F32, out: F32 | float = 0.0) -> F32:
    """Return points on panels, or `out` metres in front."""
    corner, right = table.corner.astype(np.float32)[of], table.right.astype(np.float32)[of]
    up = table.up.astype(np.float32)[of]
    points: F32 = corner + right * u[:, None] + up * v[:, None]
    if np.any(out):
        normal = table.out.astype(np.float32)[of]
        points += normal * np.broadcast_to(np.asarray(out, np.float32), u.shape)[:, None]
    return points


def _bays(table: PanelTable, of: Rows) -> tuple[F32, F32]:
    """Return number and width of the bays of walls."""
    number = np.maximum(1.0, np.round(table.width[of] / _BAY))
    return number.astype(np.float32), (table.width[of] / number).astype(np.float32)


def _opening(
    table: PanelTable, of: Rows, u: F32, v: F32
) -> tuple[F32, F32, F32, F32, NDArray[np.bool_]]:
    """Return offsets from the middle of the nearest opening, its half sizes, and if it is a shop.

    A wall without shops has windows on the ground floor as well.
    """
    _, bay = _bays(table, of)
    base, storey = table.base[of].astype(np.float32), table.storey[of].astype(np.float32)
    look = table.style[of]
    across = u % bay - 0.5 * bay
    low = v < base
    shop = low & table.street[of]
    level = np.where(low, base, storey)
    middle = np.where(shop, 0.44, 0.54).astype(np.float32) * level
    above = np.where(low, v, (v - base) % storey) - middle
    half = np.where(shop, 0.44 * bay, _OPENINGS[look, 0].astype(np.float32) * bay)
    share = np.where(shop, np.float32(0.62), _OPENINGS[look, 1].astype(np.float32))
    tall = np.where(low & ~shop, 0.45 * share * level, 0.5 * share * level)
    return across, above.astype(np.float32), half.astype(np.float32), tall.astype(np.float32), shop


def walls(table: PanelTable, n: int, rng: np.random.Generator) -> Elements:
    """Return n elements of walls with openings, which they leave free."""
    rows = np.flatnonzero(table.kind == Kind.WALL)
    areas = table.width[rows] * table.height[rows]
    more = 1.6
    while True:
        counts = np.ceil(areas * (more * n / areas.sum())).astype(np.int64)
        of, u, v = _spread(table, rows, counts)
        across, above, half, tall, shop = _opening(table, of, u, v)
        dx, dy = np.abs(across) - half, np.abs(above) - tall
        outside = np.maximum(dx, dy)
        free = np.flatnonzero(outside > 0.0)
        if len(free) >= n:
            break
        more *= 1.3
    side = float(np.sqrt(areas.sum() / counts.sum()))
    kept = free[(np.arange(n) * (len(free) / n)).astype(np.int64)]
    of, u, v, shop = of[kept], u[kept], v[kept], shop[kept]
    outside, dx, dy, above, tall = (x[kept] for x in (outside, dx, dy, above, tall))
    look, salt = table.style[of], table.salt[of].astype(np.float32)
    colours = _LOOKS.astype(np.float32)
    tint = np.float32(0.82) + np.float32(0.36) * salt[:, None]
    wall, trim = colours[look, 0] * tint, colours[look, 1]
    # Courses of bricks and stones are finer than the elements: their tone varies one by one.
    tone = 1.0 + 0.10 * uneven(u, v, salt) + 0.07 * normal_numbers(n, rng)
    below = (np.abs(dx) < 3.0) & (dx < 0.0) & (above < -tall)
    tone = tone - 0.12 * below * np.exp(np.minimum(above + tall, 0.0))
    tone -= 0.25 * np.exp(-v / 0.5)
    albedo = wall * tone[:, None]
    base, storey = table.base[of].astype(np.float32), table.storey[of].astype(np.float32)
    height, width = table.height[of].astype(np.float32), table.width[of].astype(np.float32)
    into = np.where(v < base, v, (v - base) % storey)
    cornice = (height - v < 0.45) | (np.abs(v - base) < 0.2)
    band = (into < 0.3) & (look < HOUSE_STYLES)
    quoin = np.minimum(u, width - u) < 0.45
    trimmed = cornice | band | (quoin & (look % 2 == 1)) | (outside < 0.13)
    albedo = np.where(trimmed[:, None], trim * tone[:, None], albedo)
    sign = shop & (above > tall) & (above < tall + 0.55)
    named = _SIGNS.astype(np.float32)[(salt * 37.0).astype(np.int64) % len(_SIGNS)]
    albedo = np.where(sign[:, None], named * tone[:, None], albedo)
    edge = np.minimum(outside, np.minimum(np.abs(v - base - 0.2), np.abs(height - v - 0.45)))
    edge = np.minimum(edge, np.minimum(np.abs(into - 0.3), np.abs(above - tall - 0.55)))
    upright = (outside <= edge) & (dx > dy)
    edge = np.minimum(edge, np.minimum(u, width - u))
    upright |= edge == np.minimum(u, width - u)
    out = np.where(cornice, np.float32(0.14), np.float32(0.0)) + np.float32(0.03) * trimmed
    return sheet(
        _places(table, of, u, v, out),
        table.frame[of],
        table.out.astype(np.float32)[of],
        side,
        np.clip(albedo, 0.01, 0.95).astype(np.float32),
        rng,
        edge,
        np.where(upright, np.float32(0.5 * np.pi), np.float32(0.0)),
    )


# Elements of a window as shares of its half sizes: middle and reach across and up.
_PANES: Final = [(x, y, 0.4, 0.3) for x in (-0.5, 0.5) for y in (-0.72, -0.24, 0.24, 0.72)]
_FRAME: Final = [
    (-1.0, 0.0, 0.0, 0.58),
    (1.0, 0.0, 0.0, 0.58),
    (0.0, -1.0, 0.62, 0.0),
    (0.0, 1.0, 0.58, 0.0),
    (0.0, 0.0, 0.0, 0.55),
    (0.0, 0.36, 0.55, 0.0),
]


def windows(table: PanelTable, rng: np.random.Generator) -> list[Elements]:
    """Return the panes and the frames of all openings."""
    rows = np.flatnonzero(table.kind == Kind.WALL)
    number, bay = _bays(table, rows)
    levels = table.floors[rows] + 1
    counts = number.astype(np.int64) * levels
    of = np.repeat(np.arange(len(rows)), counts)
    index = np.arange(int(counts.sum())) - np.repeat(np.cumsum(counts) - counts, counts)
    column, level = index % number.astype(np.int64)[of], index // number.astype(np.int64)[of]
    panel = rows[of]
    base, storey = table.base[panel], table.storey[panel]
    u = ((column + 0.5) * bay[of]).astype(np.float32)
    v = np.where(level == 0, 0.4 * base, base + (level - 0.5) * storey).astype(np.float32)
    across, above, half, tall, shop = _opening(table, panel, u, v)
    u, v = u - across, v - above
    m = len(panel)
    salt = rng.random(m, dtype=np.float32)
    parts = []
    for shapes, glass in ((_PANES, True), (_FRAME, False)):
        k = len(shapes)
        x, y, wide, high = (np.tile(np.array(s, np.float32), m) for s in zip(*shapes, strict=True))
        which = np.repeat(np.arange(m), k)
        at, h, t = panel[which], half[which], tall[which]
        normals = table.out.astype(np.float32)[at]
        if glass:
            # Curtains and lit rooms behind some of the panes; shops are brighter inside.
            inside = rng.random(m * k, dtype=np.float32)
            colour = np.array([0.035, 0.05, 0.06], np.float32) + inside[:, None] * np.array(
                [0.03, 0.03, 0.03], np.float32
            )
            drawn = (salt[which] < 0.3) & (y > 0.6 - 3.0 * salt[which])
            colour = np.where(drawn[:, None], np.float32(0.42), colour)
            lit = shop[which] & (y < 0.5)
            warm = np.array([0.40, 0.26, 0.12], np.float32) * (0.4 + inside[:, None])
            colour = np.where(lit[:, None], warm, colour)
            depth, least = -0.10, 0.0
        else:
            trim = _LOOKS.astype(np.float32)[table.style[at], 1]
            dark = salt[which] < 0.5
            colour = np.where(dark[:, None], np.float32(0.6), np.float32(0.85)) * trim
            depth, least = 0.02, 0.045
        jitter = np.exp(0.08 * normal_numbers(m * k, rng))
        sizes = np.stack([wide * h * jitter, high * t * jitter, 0.012 * jitter], axis=1)
        parts.append(
            Elements(
                _places(table, at, u[which] + x * h, v[which] + y * t, depth),
                table.frame[at],
                np.maximum(sizes, np.array([least, least, 0.004], np.float32)).astype(np.float32),
                normals,
                colour.astype(np.float32),
                (0.99 - 0.1 * rng.random(m * k, dtype=np.float32) ** 2).astype(np.float32),
                0.75 if glass else 0.0,
                0.12,
                0.5,
            )
        )
    return parts


_DETAIL: Final = {
    Kind.PLAIN: 0.8,
    Kind.FLAT_ROOF: 0.5,
    Kind.TILES: 1.0,
    Kind.GABLE: 1.0,
    Kind.CAR: 9.0,
    Kind.CAR_GLASS: 7.0,
    Kind.MARK: 8.0,
    Kind.WOOD: 6.0,
}


def panel_area(table: PanelTable) -> float:
    """Return the area of all panels but walls with windows, weighted by detail, m²."""
    return float(_weights(table).sum())


def _weights(table: PanelTable) -> F64:
    """Return the weighted area of each panel, 0 for walls with windows."""
    detail = np.array([_DETAIL.get(kind, 0.0) for kind in Kind])[table.kind]
    half = np.where(table.kind == Kind.GABLE, 0.5, 1.0)
    result: F64 = table.width * table.height * detail * half
    return result


def panels(table: PanelTable, n: int, rng: np.random.Generator) -> list[Elements]:
    """Return n elements of all panels but walls with windows."""
    weights = _weights(table)
    rows = np.flatnonzero(weights)
    counts = np.array(split_count(n, [float(w) for w in weights[rows]]), np.int64)
    of, u, v = _spread(table, rows, counts)
    width, height = table.width[of].astype(np.float32), table.height[of].astype(np.float32)
    kind, look = table.kind[of], table.style[of]
    # Points outside a gable's triangle are turned by half a turn into it.
    beside = (kind == Kind.GABLE) & (np.abs(u / width - 0.5) * 2.0 + v / height > 1.0)
    u = np.where(beside, (u + 0.5 * width) % width, u)
    v = np.where(beside, height - v, v)
    side = np.sqrt(weights.sum() / n / np.array([_DETAIL.get(k, 1.0) for k in Kind]))[kind]
    salt = table.salt[of].astype(np.float32)
    colours = _LOOKS.astype(np.float32)[look % len(_LOOKS)]
    tint = (0.82 + 0.36 * salt)[:, None]
    albedo = colours[:, 0] * tint
    roof = colours[:, 2] * tint
    tone = 1.0 + 0.10 * uneven(u, v, salt) + 0.06 * normal_numbers(n, rng)
    course = hashed(np.floor(u / 0.5) + 64.0 * np.floor(salt * 64.0), np.floor(v / 0.45))
    tiled = (kind == Kind.TILES)[:, None]
    albedo = np.where(tiled, roof * (0.72 + 0.5 * course)[:, None], albedo)
    albedo = np.where(
        (kind == Kind.FLAT_ROOF)[:, None],
        np.float32(0.16) + 0.3 * colours[:, 2] + np.float32(0.2) * salt[:, None],
        albedo,
    )
    albedo = np.where((kind == Kind.CAR)[:, None], _PAINTS.astype(np.float32)[look % 7], albedo)
    tone = np.where(kind == Kind.CAR, np.float32(1.0), tone)
    dark = (kind == Kind.CAR) & (v < 0.08) & (table.corner[of, 1] < 0.5)
    hub = np.abs(np.abs(u - 0.5 * width) - 1.3)
    dark |= (
        (kind == Kind.CAR) & (table.corner[of, 1] < 0.5) & (width > 4.0) & (hub < 0.33) & (v < 0.36)
    )
    albedo = np.where(dark[:, None], np.float32(0.02), albedo)
    albedo = np.where((kind == Kind.CAR_GLASS)[:, None], np.float32(0.03), albedo)
    albedo = np.where((kind == Kind.MARK)[:, None], np.float32(0.72), albedo)
    wood = np.array([0.30, 0.17, 0.08], np.float32)
    albedo = np.where((kind == Kind.WOOD)[:, None], wood, albedo)
    edge = np.minimum(np.minimum(u, width - u), np.minimum(v, height - v))
    upright = np.minimum(u, width - u) < np.minimum(v, height - v)
    edge = np.where(kind == Kind.GABLE, np.float32(np.inf), edge)
    angle = np.where(upright, np.float32(0.5 * np.pi), np.float32(0.0))
    made = sheet(
        _places(table, of, u, v),
        table.frame[of],
        table.out.astype(np.float32)[of],
        side.astype(np.float32),
        np.clip(albedo * tone[:, None], 0.01, 0.95).astype(np.float32),
        rng,
        edge,
        angle,
    )
    shiny = (kind == Kind.CAR) | (kind == Kind.CAR_GLASS)
    bright = made.take(np.flatnonzero(shiny))
    return [
        made.take(np.flatnonzero(~shiny)),
        Elements(
            bright.points,
            bright.frames,
            bright.sizes,
            bright.normals,
            bright.albedo,
            bright.opacities_unit,
            0.6,
            0.15,
        ),
    ]
