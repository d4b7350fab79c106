"""Coarseness of each chunk's head: the bits of its values that the refinement holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.streams import refinement_digits

from . import segment_order

F64 = NDArray[np.float64]

# Approximate size of a splat in a coarse head, bits.
_HEAD_BITS: Final = 24.0

# Offset to the bits of each value that equal λ moves to the refinement. Sensitivities hold for
# small errors, and a prefix gains less from coarse splats than their costs predict (measured on
# two trained scenes).
_REFINEMENT_BITS_OFFSET: Final = {
    "scales": 0.25,
    "opacities": -0.25,
    "means": -0.75,
    "sh0": -0.75,
}
_MAX_REFINEMENT_BITS: Final = 5.0

# Keeps the logarithm finite for a head that removes no error: far below a ratio worth one bit.
_MIN_RATIO: Final = 2.0**-20


@dataclass(frozen=True)
class HeadCoarseness:
    """Coarseness of a chunk's head relative to the refined values, by attribute.

    Parameters
    ----------
    scales : tuple of int
        Maximum radix of the refinement digits of each scale difference. At 1 the head holds the
        full values.
    means : int
        Number of low bits of each coordinate that the refinement holds.
    opacities, sh0 : tuple of int
        Maximum radix of the refinement digits of each component.
    """

    scales: tuple[int, ...]
    means: int
    opacities: tuple[int, ...]
    sh0: tuple[int, ...]


FINE: Final = HeadCoarseness((1, 1, 1), 0, (1,), (1, 1, 1))
"""Coarseness of a head that holds all values in full."""


def head_coarseness(
    contribution: F64, lagrangian: float, chunks: Sequence[slice], missing_all: float
) -> dict[int, HeadCoarseness]:
    """Choose the coarseness of each head: the bits of its values that are left to the refinement.

    Coarse heads add more splats per byte. At the chosen coarseness, one more bit of a value removes
    as much error as an average bit of the head does by adding its splats.

    Parameters
    ----------
    contribution : (N,) float64
        Contribution of each splat, in file order.
    lagrangian : float
        λ of the refined values.
    chunks : sequence of slice
        Rows of each chunk.
    missing_all : float
        Squared error of an empty picture: `segment_order.MISSING_ALL` or `MISSING_COMPENSATED`.

    Returns
    -------
    dict of int to HeadCoarseness
        Coarseness by the first row of each chunk.
    """
    sums = np.array([contribution[run].sum() for run in chunks])
    counts = np.array([run.stop - run.start for run in chunks])
    missing = segment_order.missing_shares(sums)
    per_bit = segment_order.head_distortion_drops(missing, missing_all) / (_HEAD_BITS * counts)
    per_bit /= segment_order.refinement_weight(missing[1:])
    # One more bit of a value whose error costs λ/12 removes 2·ln 2 times that error.
    ratio = 12 / (2 * np.log(2)) * per_bit / lagrangian
    bits = 0.5 * np.log2(np.maximum(ratio, _MIN_RATIO))
    return {run.start: _with_bits(float(b)) for run, b in zip(chunks, bits, strict=True)}


def _with_bits(bits: float) -> HeadCoarseness:
    """Return the coarseness of a head that leaves `bits` of each value to the refinement."""
    refined_bits = {
        name: min(max(bits + offset, 0.0), _MAX_REFINEMENT_BITS)
        for name, offset in _REFINEMENT_BITS_OFFSET.items()
    }
    radices = {
        name: min(round(2**held), refinement_digits.MAX_RADIX)
        for name, held in refined_bits.items()
    }
    return HeadCoarseness(
        scales=(radices["scales"],) * 3,
        means=round(refined_bits["means"]),
        opacities=(radices["opacities"],),
        sh0=(radices["sh0"],) * 3,
    )
