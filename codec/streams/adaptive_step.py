"""How finely a row's values are stored, told by the scales that were decoded before (SPEC 6.10)."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]

_COEFFICIENTS: Final = struct.Struct("<6f")
RESOLUTION_BYTES: Final = _COEFFICIENTS.size

MAX_HALVINGS: Final = 15
"""Most halvings of a step (SPEC 6.10)."""

# Where the two features of each difference of scales stop growing: steep for nearly round
# splats, then flatter (measured on trained scenes).
_LONG_MID_KNEE: Final = (np.float32(1.5), np.float32(5))
_MID_THIN_KNEE: Final = (np.float32(0.5), np.float32(3))
KNEES: Final = np.array([*_LONG_MID_KNEE, *_MID_THIN_KNEE], np.float32)
"""The four, float32."""

# Corrections of a fit: clamped rows make each a little short.
_CORRECTIONS: Final = 6

MAX_COEFFICIENT: Final = 1e6
"""Largest magnitude of a coefficient: the sum stays finite for any decoded scales."""


@dataclass(frozen=True)
class Resolution:
    """A splat's number of halvings as a function of its scales.

    ``floor(c0 + c1·s + c2·min(p, 1.5) + c3·min(p, 5) + c4·min(q, 0.5) + c5·min(q, 3))``, clamped
    to 0 to `MAX_HALVINGS`, with s the third log scale, p the third minus the first, q the first
    minus the second.

    Parameters
    ----------
    coefficients : tuple of float
        Six, float32.
    """

    coefficients: tuple[float, ...]

    def halvings(self, scales: F32) -> U8:
        """Return (n,) halvings for (n, 3) float32 decoded log scales (SPEC 6.10)."""
        c = np.array(self.coefficients, np.float32)
        total = np.full(len(scales), c[0], np.float32)
        for coefficient, feature in zip(c[1:], _features(scales), strict=True):
            total = total + coefficient * feature
        return np.clip(np.floor(total), 0, MAX_HALVINGS).astype(np.uint8)

    def pack(self) -> bytes:
        """Return the coefficients as they stand in a stream's parameters."""
        return _COEFFICIENTS.pack(*self.coefficients)


def unpack(data: memoryview, where: str) -> Resolution:
    """Read a resolution.

    Raises
    ------
    FormatError
        ``resolution-value``: a coefficient that is not finite or above `MAX_COEFFICIENT`.
    """
    coefficients = _COEFFICIENTS.unpack(data)
    if not all(abs(c) <= MAX_COEFFICIENT for c in coefficients):
        raise FormatError(
            "resolution-value",
            f"{where}: coefficients {coefficients}, expected magnitudes to {MAX_COEFFICIENT:g}",
            clause="6.10",
        )
    return Resolution(coefficients)


def fit(scales: F32, sensitivity: F64, slope: float, base_step: float) -> Resolution:
    """Return the resolution at which errors cost what a slope allows.

    Parameters
    ----------
    scales : (n, 3) float32
        Log, as the decoder will have them: middle, thin, long.
    sensitivity : (n,) float64
        Squared error of the picture per squared error of each row's value; positive.
    slope : float
        What ``sensitivity · step²`` should be.
    base_step : float
        Step at no halvings.
    """
    features = np.stack([np.ones(len(scales)), *(f.astype(np.float64) for f in _features(scales))])
    wanted = np.log2(base_step) + 0.5 * np.log2(sensitivity / slope)
    normal = features @ features.T
    # A little damping: a chunk of equal shapes leaves features without an answer.
    normal += np.eye(len(normal)) * (1e-6 * np.trace(normal) + 1e-12)
    solution = np.linalg.solve(normal, features @ wanted)
    # floor() loses half a halving on average.
    solution[0] += 0.5
    return _levelled(solution, scales, sensitivity, slope, base_step)


def shifted(
    resolution: Resolution,
    halvings: int,
    scales: F32,
    sensitivity: F64,
    slope: float,
    base_step: float,
) -> float:
    """Return the first coefficient with which errors cost what another slope allows.

    Parameters
    ----------
    resolution : Resolution
        Whose other coefficients stay.
    halvings : int
        About how many more there will be.
    scales, sensitivity, slope, base_step
        As `fit` takes them.
    """
    start = np.array(resolution.coefficients)
    start[0] += halvings
    return _levelled(start, scales, sensitivity, slope, base_step).coefficients[0]


def _levelled(
    solution: F64, scales: F32, sensitivity: F64, slope: float, base_step: float
) -> Resolution:
    """Return the resolution whose first coefficient gives the slope.

    What counts is the mean of the squares, not of their logarithms: correct by what the halvings
    really give.
    """
    resolution = _rounded(solution)
    for _ in range(_CORRECTIONS):
        step = np.ldexp(base_step, -resolution.halvings(scales).astype(np.int32))
        ratio = float((sensitivity * np.square(step)).mean()) / slope
        solution[0] += 0.5 * np.log2(ratio)
        resolution = _rounded(solution)
    return resolution


def _rounded(coefficients: F64) -> Resolution:
    limited = np.clip(coefficients, -1e5, 1e5).astype(np.float32)
    return Resolution(tuple(float(c) for c in limited))


def _features(scales: F32) -> list[F32]:
    long = scales[:, 2]
    p = long - scales[:, 0]
    q = scales[:, 0] - scales[:, 1]
    return [
        long,
        np.minimum(p, _LONG_MID_KNEE[0]),
        np.minimum(p, _LONG_MID_KNEE[1]),
        np.minimum(q, _MID_THIN_KNEE[0]),
        np.minimum(q, _MID_THIN_KNEE[1]),
    ]
