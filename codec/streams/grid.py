"""Scalar quantisation on a chunk's own minimum, maximum and number of levels (SPEC 6.4)."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError

F32 = NDArray[np.float32]
U32 = NDArray[np.uint32]

MAX_LEVELS: Final = 1 << 24
"""Every code up to here is exact in float32 (SPEC 6.4)."""

MAX_VALUE: Final = 2.0**100
"""Largest magnitude of a grid's ends: sums of two decoded values stay finite (SPEC 6.4)."""

_ENTRY: Final = struct.Struct("<ffI")
ENTRY_BYTES: Final = _ENTRY.size


@dataclass(frozen=True, eq=False)
class Grid:
    """Uniform levels between a minimum and a maximum, per component.

    Parameters
    ----------
    minimum, maximum : (c,) float32
        Values of the first and the last level, in the space of the attribute.
    levels : (c,) uint32
        Number of levels, 1 to `MAX_LEVELS`; 1 means a constant that costs no plane.
    """

    minimum: F32
    maximum: F32
    levels: U32

    @property
    def components(self) -> int:
        """Number of components."""
        return len(self.levels)

    @property
    def step(self) -> F32:
        """Distance between levels, (c,) float32; 0 where there is one level (SPEC 6.4)."""
        intervals = np.maximum(self.levels, 2).astype(np.float32) - np.float32(1)
        step = (self.maximum - self.minimum) / intervals
        return np.where(self.levels > 1, step, np.float32(0))

    def quantise(self, values: F32) -> U32:
        """Return the nearest level of each value, (n, c) uint32; values outside are clamped."""
        step = self.step.astype(np.float64)
        safe = np.where(step > 0, step, 1.0)
        codes = np.rint((values.astype(np.float64) - self.minimum.astype(np.float64)) / safe)
        return np.clip(codes, 0, self.levels.astype(np.float64) - 1).astype(np.uint32)

    def dequantise(self, codes: U32) -> F32:
        """Return ``minimum + code * step`` in float32, (n, c)."""
        out: F32 = codes.astype(np.float32) * self.step + self.minimum
        return out

    def pack(self) -> bytes:
        """Return the grid's entries as they stand in a stream record."""
        entries = zip(self.minimum, self.maximum, self.levels, strict=True)
        return b"".join(_ENTRY.pack(lo, hi, count) for lo, hi, count in entries)


def fit(values: F32, step: float | NDArray[np.float64]) -> Grid:
    """Return the grid that spans `values` with steps no larger than `step`.

    Parameters
    ----------
    values : (n, c) float32
        Finite; n ≥ 1.
    step : float or (c,) float64
        Largest distance between levels, per component; positive. What comes out may be larger by
        one part in 2^20.

    Returns
    -------
    Grid
        At most `MAX_LEVELS` levels, so that a step too small for the range is widened.

    Raises
    ------
    ValueError
        A step that is not above 0.
    """
    if not (np.asarray(step) > 0).all():
        raise ValueError(f"step {step}, expected more than 0")
    minimum = values.min(axis=0)
    maximum = values.max(axis=0)
    span = maximum.astype(np.float64) - minimum.astype(np.float64)
    # The span rounded to float32 steps must still reach the last value: one part in 2^20 of slack.
    intervals = np.ceil(span / np.asarray(step, np.float64) * (1 - 2.0**-20))
    levels = np.clip(intervals + 1, 1, MAX_LEVELS).astype(np.uint32)
    # A span smaller than half a step becomes the constant in its middle.
    flat = span < np.asarray(step, np.float64) * 0.5
    middle = (minimum.astype(np.float64) + span / 2).astype(np.float32)
    levels = np.where(flat, np.uint32(1), levels)
    return Grid(
        np.where(flat, middle, minimum).astype(np.float32),
        np.where(flat, middle, maximum).astype(np.float32),
        levels.astype(np.uint32),
    )


def unpack(
    data: memoryview,
    components: int,
    where: str,
    limit: int = MAX_LEVELS,
    furthest: float = MAX_VALUE,
) -> Grid:
    """Read a grid's entries and check them: all ranges, then all levels.

    Raises
    ------
    FormatError
        ``grid-value``: not finite, beyond ±`furthest`, or minimum above maximum;
        ``grid-levels``: 0 or more than `limit` levels.
    """
    # Three numbers at a time cost less so than as arrays.
    entries = list(_ENTRY.iter_unpack(data[: components * ENTRY_BYTES]))
    lows, highs, levels = zip(*entries, strict=True)
    if not all(-furthest <= lo <= hi <= furthest for lo, hi, _ in entries):
        raise FormatError(
            "grid-value",
            f"{where}: range {list(lows)} to {list(highs)}, "
            f"expected minimum first, both within ±{furthest:g}",
            clause="6.4" if furthest == MAX_VALUE else "6.6",
        )
    if min(levels) < 1 or max(levels) > limit:
        raise FormatError(
            "grid-levels",
            f"{where}: {list(levels)} levels, expected 1 to {limit}",
            clause="6.4",
        )
    return Grid(
        np.array(lows, np.float32), np.array(highs, np.float32), np.array(levels, np.uint32)
    )
