"""What the refinement of a chunk adds to one attribute, and how many of its bits may wait there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.rate import refinement_split
from cogsplat.codec.rate.refinement_split import Split
from cogsplat.codec.streams.records import Stream

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Refined:
    """The stream that a refinement holds of one attribute.

    Parameters
    ----------
    stream : Stream or None
        None where the head holds the attribute in full.
    distortion_drop : float
        Squared error of the pictures that the stream removes.
    """

    stream: Stream | None
    distortion_drop: float = 0.0


NOTHING: Final = Refined(None)
"""Of an attribute that the head holds in full."""


def squared_error_drop(parts: Split, values: F32) -> F64:
    """Return the squared error that the refinement of split values removes.

    Parameters
    ----------
    parts : Split
    values : (n, c) float32
        As they were before they were quantised.

    Returns
    -------
    (n, c) float64
        Negative where the coarse value happens to be nearer.
    """
    wide = values.astype(np.float64)
    return np.square(parts.coarse - wide) - np.square(parts.fine - wide)


Quantised = tuple[I64, Stream, Refined]
"""The order inside the chunk, (n,) int64, the head's stream, and what refines it."""


def affordable(quantise: Callable[[int], Quantised], most_bits: int) -> Quantised:
    """Return an attribute with as many bits in its refinement as pay for being there.

    Values whose number of bits follows from their row cost more in two parts than in one. And
    splats that share a cell of a coarse grid have no order there, which a finer grid need not spend
    bits on. So fewer bits may wait than the λ of the head asks for.

    Parameters
    ----------
    quantise : callable
        Quantises the attribute with so many bits of each value in the refinement.
    most_bits : int
        Bits that may wait at most.
    """
    whole = quantise(0)
    whole_bits = _entropy_bits(whole[1])
    for bits in range(most_bits, 0, -1):
        tried = quantise(bits)
        waiting = _entropy_bits(tried[2].stream)
        extra = _entropy_bits(tried[1]) + waiting - whole_bits
        if extra <= refinement_split.DEFERRED_BIT_PRICE * waiting:
            return tried
    return whole


def _entropy_bits(stream: Stream | None) -> float:
    """Return about how many bits the planes of a stream take, each coded on its own."""
    if stream is None:
        return 0.0
    return sum(
        refinement_split.entropy_bits(np.bincount(np.ravel(plane))) for plane in stream.planes
    )
