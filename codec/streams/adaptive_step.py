"""Adaptive quantiser steps: extra bits of each splat, derived from its scales (SPEC 6.10)."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import FormatError

from .stream_inputs import Inputs

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
U8 = NDArray[np.uint8]

_COEFFICIENTS: Final = struct.Struct("<6f")
MODEL_BYTES: Final = _COEFFICIENTS.size
"""Bytes of a step model in a stream's parameters."""

MAX_EXTRA_BITS: Final = 15
"""Maximum number of extra bits of a row; the step is then 2^-15 of the base step (SPEC 6.10)."""

# Each difference of log scales enters the model clamped at two knees. On trained scenes the extra
# bits rise steeply with the difference for nearly round splats, then slower.
_LONG_MID_KNEE: Final = (np.float32(1.5), np.float32(5))
_MID_THIN_KNEE: Final = (np.float32(0.5), np.float32(3))
KNEES: Final = np.array([*_LONG_MID_KNEE, *_MID_THIN_KNEE], np.float32)
"""Upper limits of the differences p (twice) and q (twice) in `StepModel`, float32."""

# Iterations of the correction in `_calibrated`: clamped rows make each one fall a little short.
_CORRECTIONS: Final = 6

MAX_COEFFICIENT: Final = 1e6
"""Largest magnitude of a coefficient: the sum stays finite for any decoded scales."""


@dataclass(frozen=True)
class StepModel:
    """Model of the extra bits of each splat, given its log scales (SPEC 6.10).

    A splat with h extra bits is quantised with the base step / 2^h. h is ``floor(c0 + c1·s +
    c2·min(p, 1.5) + c3·min(p, 5) + c4·min(q, 0.5) + c5·min(q, 3))``, clamped to 0 to
    `MAX_EXTRA_BITS`. s is the largest log scale, p the largest minus the middle, q the middle minus
    the smallest.

    Parameters
    ----------
    coefficients : tuple of float
        Six float32 values, c0 to c5.
    """

    coefficients: tuple[float, ...]

    @classmethod
    def constant(cls, bits: int) -> StepModel:
        """Return the model that gives every row the same number of extra bits."""
        return cls((float(bits), 0.0, 0.0, 0.0, 0.0, 0.0))

    def extra_bits(self, scales: F32) -> U8:
        """Return the extra bits of each splat (SPEC 6.10).

        Parameters
        ----------
        scales : (n, 3) float32
            Decoded log scales of the head: middle, thin, long.

        Returns
        -------
        (n,) uint8
            Number of bits; each one halves the quantiser step.
        """
        c = np.array(self.coefficients, np.float32)
        if not c[1:].any():
            # All other coefficients are 0: every row has the same number.
            return np.full(len(scales), np.clip(np.floor(c[0]), 0, MAX_EXTRA_BITS), np.uint8)
        total = np.full(len(scales), c[0], np.float32)
        for coefficient, feature in zip(c[1:], _features(scales), strict=True):
            total = total + coefficient * feature
        return np.clip(np.floor(total), 0, MAX_EXTRA_BITS).astype(np.uint8)

    def pack(self) -> bytes:
        """Return the coefficients as bytes of a stream's parameters."""
        return _COEFFICIENTS.pack(*self.coefficients)


def unpack(data: memoryview, where: str) -> StepModel:
    """Parse the step model in the parameters of a stream.

    Raises
    ------
    FormatError
        ``step-model``: a coefficient is not finite, or its magnitude is above `MAX_COEFFICIENT`.
    """
    coefficients = _COEFFICIENTS.unpack(data)
    if not all(abs(c) <= MAX_COEFFICIENT for c in coefficients):
        raise FormatError(
            "step-model",
            f"{where}: coefficients {coefficients}, expected magnitudes to {MAX_COEFFICIENT:g}",
            clause="6.10",
        )
    return StepModel(coefficients)


def require_scales(inputs: Inputs) -> F32:
    """Return the log scales of a stream's inputs, (rows, 3) float32.

    Raises
    ------
    ValueError
        The inputs have no scales.
    """
    if inputs.scales is None:
        raise ValueError("no scales for a stream with an adaptive step")
    return inputs.scales


def fit(scales: F32, sensitivity: F64, lagrangian: float, base_step: float) -> StepModel:
    """Fit a step model so that each row adds about the same error λ to the rendered image.

    Parameters
    ----------
    scales : (n, 3) float32
        Decoded log scales: middle, thin, long.
    sensitivity : (n,) float64
        Squared error of the rendered image per squared error of a row's value; positive.
    lagrangian : float
        λ: target of ``sensitivity · step²``.
    base_step : float
        Quantiser step of rows without extra bits.
    """
    features = np.stack([np.ones(len(scales)), *(f.astype(np.float64) for f in _features(scales))])
    wanted = np.log2(base_step) + 0.5 * np.log2(sensitivity / lagrangian)
    normal = features @ features.T
    # Damping keeps the system regular if all shapes of a chunk are equal.
    normal += np.eye(len(normal)) * (1e-6 * np.trace(normal) + 1e-12)
    solution = np.linalg.solve(normal, features @ wanted)
    # floor() removes half a bit on average.
    solution[0] += 0.5
    return _calibrated(solution, scales, sensitivity, lagrangian, base_step)


def _calibrated(
    solution: F64, scales: F32, sensitivity: F64, lagrangian: float, base_step: float
) -> StepModel:
    """Correct coefficient c0 so that the mean of ``sensitivity · step²`` equals λ.

    The least-squares fit is one of log2(step), whose errors bias the mean of step².

    Parameters
    ----------
    solution : (6,) float64
        Fitted coefficients; c0 is changed in place.
    scales, sensitivity, lagrangian, base_step
        See `fit`.
    """
    model = _rounded(solution)
    for _ in range(_CORRECTIONS):
        step = np.ldexp(base_step, -model.extra_bits(scales).astype(np.int32))
        ratio = float((sensitivity * np.square(step)).mean()) / lagrangian
        solution[0] += 0.5 * np.log2(ratio)
        model = _rounded(solution)
    return model


def _rounded(coefficients: F64) -> StepModel:
    """Return the step model of coefficients, clamped to ±1e5 and rounded to float32."""
    limited = np.clip(coefficients, -1e5, 1e5).astype(np.float32)
    return StepModel(tuple(float(c) for c in limited))


def _features(scales: F32) -> list[F32]:
    """Return the five terms that a step model weights by c1 to c5, (n,) each (SPEC 6.10)."""
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
