"""Elements that cover the surfaces of a synthetic city, and the patterns of its materials."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .city_light import Elements
from .materials import COVER

F32 = NDArray[np.float32]


def normal_numbers(n: int, rng: np.random.Generator) -> F32:
    """Return n normal numbers."""
    return rng.standard_normal(n, dtype=np.float32)


def uneven(u: F32, v: F32, salt: F32 | float = 0.0) -> F32:
    """Return a smooth uneven pattern about 0, of amplitude 1, with patches of about a metre."""
    result: F32 = (
        np.sin(1.9 * u + 0.7 * v + 9.0 * salt)
        + np.sin(0.8 * u - 2.3 * v + 17.0 * salt)
        + np.sin(5.1 * u + 3.7 * v + 5.0 * salt) * np.float32(0.6)
    ) * np.float32(0.38)
    return result


def hashed(a: F32, b: F32) -> F32:
    """Return a random number in [0, 1) for each pair of whole numbers."""
    key = a.astype(np.int32).astype(np.uint32) * np.uint32(73856093)
    key ^= b.astype(np.int32).astype(np.uint32) * np.uint32(19349663)
    key ^= key >> np.uint32(15)
    key *= np.uint32(0x2C1B3C6D)
    key ^= key >> np.uint32(13)
    return (key >> np.uint32(8)).astype(np.float32) * np.float32(2.0**-24)


def _turned(frames: F32, angle: F32) -> F32:
    """Return frames turned about their own z by angles, radians."""
    c, s = np.cos(0.5 * angle), np.sin(0.5 * angle)
    w, x, y, z = frames.T
    return np.stack([w * c - z * s, x * c + y * s, y * c - x * s, z * c + w * s], axis=1)


def sheet(
    points: F32,
    frames: F32,
    normals: F32,
    side: F32 | float,
    albedo: F32,
    rng: np.random.Generator,
    distance: F32 | None = None,
    angle: F32 | None = None,
    gloss: float = 0.0,
) -> Elements:
    """Return flat elements that cover a surface, with the spread of sizes of trained scenes.

    Parameters
    ----------
    points, frames, normals, albedo
        See `Elements`.
    side : float or (n,) float32
        Distance of neighbours, metres.
    rng : numpy.random.Generator
        Source of sizes and opacities.
    distance, angle : (n,) float32, optional
        Distance to the nearest edge, which elements do not cross, and its direction in the frame.
    gloss : float
        See `Elements`.
    """
    n = len(points)
    full = np.float32(COVER) * np.broadcast_to(np.asarray(side, np.float32), (n,))
    turn = np.float32(2.0 * np.pi) * rng.random(n, dtype=np.float32)
    width, vary = full, np.ones(n, np.float32)
    if distance is not None and angle is not None:
        width = np.clip(np.float32(0.5) * distance + np.float32(0.004), 0.35 * full, full)
        held = width < 0.95 * full
        turn = np.where(held, angle, turn)
        vary = np.where(held, np.float32(0.4), np.float32(1.0))
    size = np.exp(np.float32(0.2) * vary * normal_numbers(n, rng))
    aspect = np.exp(np.float32(0.2) * vary * normal_numbers(n, rng))
    flat = np.float32(0.1) * width * np.exp(np.float32(0.6) * normal_numbers(n, rng))
    tail = rng.random(n, dtype=np.float32)
    faint = rng.random(n, dtype=np.float32) < 0.1
    opacities = np.where(faint, 0.03 + 0.5 * tail * tail, 0.995 - 0.16 * tail * tail)
    return Elements(
        points,
        _turned(frames, turn),
        np.stack([full * size * aspect, width * size / aspect, flat], axis=1),
        normals,
        albedo,
        opacities.astype(np.float32),
        gloss,
    )
