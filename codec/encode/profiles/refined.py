"""Split an attribute of a chunk between head and refinement."""

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
    """Stream of one attribute in a refinement.

    Parameters
    ----------
    stream : Stream or None
        Stream of the remaining bits; None if the head holds the attribute in full.
    distortion_drop : float
        Squared picture error that the stream removes.
    """

    stream: Stream | None
    distortion_drop: float = 0.0


NO_REFINEMENT: Final = Refined(None)
"""Refinement of an attribute that the head holds in full."""


def squared_error_drop(parts: Split, values: F32) -> F64:
    """Return the squared error that a refinement removes from each value.

    Parameters
    ----------
    parts : Split
        Coarse and fine values.
    values : (n, c) float32
        Values before quantisation.

    Returns
    -------
    (n, c) float64
        Removed error; negative where the coarse value happens to be nearer.
    """
    wide = values.astype(np.float64)
    return np.square(parts.coarse - wide) - np.square(parts.fine - wide)


Quantised = tuple[I64, Stream, Refined]
"""Order within the chunk, (n,) int64, stream of the head, and refinement."""


def choose_refinement_bits(quantise: Callable[[int], Quantised], most_bits: int) -> Quantised:
    """Choose how many bits of an attribute to defer to the refinement.

    A split costs extra bits: values with a bit count per row cost more in two parts, and splats in
    one coarse cell lose their Morton order. So fewer bits may be deferred than the head's λ allows.

    Parameters
    ----------
    quantise : callable
        Quantises the attribute with a given number of deferred bits per value.
    most_bits : int
        Deferred bits at most.
    """
    whole = quantise(0)
    whole_bits = entropy_bits(whole[1])
    for bits in range(most_bits, 0, -1):
        tried = quantise(bits)
        waiting = entropy_bits(tried[2].stream)
        extra = entropy_bits(tried[1]) + waiting - whole_bits
        if extra <= refinement_split.DEFERRED_BIT_PRICE * waiting:
            return tried
    return whole


def entropy_bits(stream: Stream | None) -> float:
    """Estimate the bits of a stream: the entropy of each plane.

    Parameters
    ----------
    stream : Stream or None
        Stream to write; None takes no bits.
    """
    if stream is None:
        return 0.0
    return sum(
        refinement_split.entropy_bits(np.bincount(np.ravel(plane))) for plane in stream.planes
    )
