"""How much coarser the head of each chunk is quantised than what its refinement makes of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.streams import refinement_digits

from . import segment_order

F64 = NDArray[np.float64]

# Bits that a splat takes in a coarse head, about.
_HEAD_BITS: Final = 24.0

# Bits of each value that the refinement holds, less than what equal λ asks for: sensitivities hold
# for small errors, and a prefix gains less from coarse splats than their costs say (measured on two
# trained scenes).
_LATER: Final = {"scales": 0.25, "opacities": -0.25, "means": -0.75, "sh0": -0.75}
_MOST_LATER: Final = 5.0

# Keeps the logarithm finite where a head gains nothing: far below a ratio that asks for one bit.
_LEAST_RATIO: Final = 2.0**-20


@dataclass(frozen=True)
class HeadCoarseness:
    """How much coarser the values of a head are than the refined ones.

    Parameters
    ----------
    scales : tuple of int
        Largest radix of the refinement digits of each scale difference; 1 keeps the head fine.
    means : int
        Bits of each value that the refinement holds.
    opacities, sh0 : tuple of int
        Largest radices, as of `scales`.
    """

    scales: tuple[int, ...]
    means: int
    opacities: tuple[int, ...]
    sh0: tuple[int, ...]


FINE: Final = HeadCoarseness((1, 1, 1), 0, (1,), (1, 1, 1))
"""Of a head that holds all values in full."""


def head_coarseness(
    contribution: F64, lagrangian: float, chunks: Sequence[slice], missing_all: float
) -> dict[int, HeadCoarseness]:
    """Return how coarse each head is: one more bit of it gains as much as one of the next head.

    Parameters
    ----------
    contribution : (N,) float64
        In the order of the chunks.
    lagrangian : float
        λ of the refined values.
    chunks : sequence of slice
    missing_all : float
        Squared error of pictures of nothing, as `segment_order.head_drops` takes it.

    Returns
    -------
    dict of int to HeadCoarseness
        By the first row of each chunk.
    """
    sums = np.array([contribution[run].sum() for run in chunks])
    counts = np.array([run.stop - run.start for run in chunks])
    missing = segment_order.unsent_shares(sums)
    per_bit = segment_order.head_drops(missing, missing_all) / (_HEAD_BITS * counts)
    per_bit /= segment_order.refinement_weight(missing[1:])
    # A bit more of a value whose error costs λ/12 gains 2·ln 2 times that.
    ratio = 12 / (2 * np.log(2)) * per_bit / lagrangian
    bits = 0.5 * np.log2(np.maximum(ratio, _LEAST_RATIO))
    return {run.start: _with_bits(float(b)) for run, b in zip(chunks, bits, strict=True)}


def _with_bits(bits: float) -> HeadCoarseness:
    """Return the coarseness of a head of which so many bits of every value may wait."""
    later = {name: min(max(bits + own, 0.0), _MOST_LATER) for name, own in _LATER.items()}
    radices = {
        name: min(round(2**wait), refinement_digits.MAX_RADIX) for name, wait in later.items()
    }
    return HeadCoarseness(
        scales=(radices["scales"],) * 3,
        means=round(later["means"]),
        opacities=(radices["opacities"],),
        sh0=(radices["sh0"],) * 3,
    )
