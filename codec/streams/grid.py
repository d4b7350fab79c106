"""Uniform scalar quantisation between a minimum and a maximum per component (SPEC 6.4)."""

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
"""Maximum number of levels: every lower code is exact in float32 (SPEC 6.4)."""

MAX_VALUE: Final = 2.0**100
"""Largest magnitude of minimum and maximum: sums of two decoded values stay finite (SPEC 6.4)."""

_ENTRY: Final = struct.Struct("<ffI")
ENTRY_BYTES: Final = _ENTRY.size
"""Bytes of one component's minimum, maximum and number of levels."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Uniform levels between a minimum and a maximum, per component.

    Parameters
    ----------
    minimum, maximum : (c,) float32
        Values of the first and the last level, in the space of the attribute.
    levels : (c,) uint32
        Number of levels, 1 to `MAX_LEVELS`; a component with 1 level is constant and has no plane.
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
        """Distance between levels, (c,) float32; 0 for one level (SPEC 6.4)."""
        intervals = np.maximum(self.levels, 2).astype(np.float32) - np.float32(1)
        step = (self.maximum - self.minimum) / intervals
        return np.where(self.levels > 1, step, np.float32(0))

    def quantise(self, values: F32) -> U32:
        """Return the nearest level of each value, clamped to the grid, (n, c) uint32."""
        step = self.step.astype(np.float64)
        safe = np.where(step > 0, step, 1.0)
        codes = np.rint((values.astype(np.float64) - self.minimum.astype(np.float64)) / safe)
        return np.clip(codes, 0, self.levels.astype(np.float64) - 1).astype(np.uint32)

    def dequantise(self, codes: U32) -> F32:
        """Return ``minimum + code * step`` in float32, (n, c)."""
        out: F32 = codes.astype(np.float32) * self.step + self.minimum
        return out

    def pack(self) -> bytes:
        """Return the entries of all components as bytes of a stream's parameters."""
        entries = zip(self.minimum, self.maximum, self.levels, strict=True)
        return b"".join(_ENTRY.pack(lo, hi, count) for lo, hi, count in entries)


def fit(values: F32, step: float | NDArray[np.float64]) -> Grid:
    """Fit a grid to the range of values with steps of at most `step`.

    Parameters
    ----------
    values : (n, c) float32
        Finite; n ≥ 1.
    step : float or (c,) float64
        Largest distance between levels, per component; positive. The step of the grid may exceed
        it by one part in 2^20.

    Returns
    -------
    Grid
        At most `MAX_LEVELS` levels: a step too small for the range is widened.

    Raises
    ------
    ValueError
        A step is not above 0.
    """
    if not (np.asarray(step) > 0).all():
        raise ValueError(f"step {step}, expected more than 0")
    minimum = values.min(axis=0)
    maximum = values.max(axis=0)
    span = maximum.astype(np.float64) - minimum.astype(np.float64)
    # Slack of one part in 2^20: the span rounded to float32 steps must reach the last value.
    intervals = np.ceil(span / np.asarray(step, np.float64) * (1 - 2.0**-20))
    levels = np.clip(intervals + 1, 1, MAX_LEVELS).astype(np.uint32)
    # A component whose span is below half a step becomes constant, at its middle.
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
    max_value: float = MAX_VALUE,
) -> Grid:
    """Read a grid from a stream's parameters.

    If a range and a number of levels are both invalid, the range is reported.

    Parameters
    ----------
    data : memoryview
        Parameters: minimum, maximum and number of levels of each component.
    components : int
        Number of components.
    where : str
        Name of the stream in messages.
    limit : int
        Maximum number of levels of a component.
    max_value : float
        Maximum magnitude of a range's ends.

    Raises
    ------
    FormatError
        ``grid-value``: a range is not finite, beyond ±`max_value`, or reversed;
        ``grid-levels``: a component has 0 or more than `limit` levels.
    """
    # Faster than arrays for a few entries.
    entries = list(_ENTRY.iter_unpack(data[: components * ENTRY_BYTES]))
    lows, highs, levels = zip(*entries, strict=True)
    if not all(-max_value <= lo <= hi <= max_value for lo, hi, _ in entries):
        raise FormatError(
            "grid-value",
            f"{where}: range {list(lows)} to {list(highs)}, "
            f"expected minimum first, both within ±{max_value:g}",
            clause="6.4" if max_value == MAX_VALUE else "6.6",
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
