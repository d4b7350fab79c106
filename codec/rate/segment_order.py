"""The order of a file's segments: those that remove most error per byte first (SPEC 5.1, 10)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, auto
from heapq import heappop, heappush
from typing import Final

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

# While a share R of the contribution is missing, the squared error of the pictures is about this
# times R². Three trained scenes lie between 0.02 and 0.2.
MISSING_ALL: Final = 0.15
"""Squared error of pictures of nothing."""

# Compensated pictures are measured to have a tenth of that error; a third of a tenth served them
# best, for what is fitted to refined splats does not fit coarse ones as well.
MISSING_COMPENSATED: Final = 0.005
"""The same of pictures that are compensated for what is missing."""

# How much more an error counts while splats are missing than in the whole scene, for fewer splats
# stand in front of those that are there. Of refinements, the first plus the second times the share
# that is missing; of tails, one factor. Measured on a trained scene.
_REFINEMENT_WEIGHT: Final = (2.0, 8.0)
_TAIL_WEIGHT: Final = 5.0

# Heads must keep their order, so one that removes little error is taken with up to so many behind.
_LOOK_AHEAD: Final = 16


class Placed(Enum):
    """The kinds of segments that `order` places."""

    HEAD = auto()
    REFINEMENT = auto()
    TAIL = auto()
    CODEBOOKS = auto()
    """The colour codebooks, which all tails need."""


@dataclass(frozen=True)
class Part:
    """A segment that may be placed.

    Parameters
    ----------
    size_bytes : int
    distortion_drop : float
        Squared error of the pictures that it removes.
    """

    size_bytes: int
    distortion_drop: float

    @property
    def drop_per_byte(self) -> float:
        """Squared error that a byte of it removes; 0 where it removes none."""
        return max(self.distortion_drop, 0.0) / max(self.size_bytes, 1)


@dataclass(frozen=True)
class ChunkParts:
    """The segments of a chunk.

    Parameters
    ----------
    head_bytes : int
        Bytes of the head; the squared error that it removes follows from the contribution.
    refinement, tail : Part or None
    """

    head_bytes: int
    refinement: Part | None
    tail: Part | None


@dataclass(frozen=True)
class Place:
    """A segment in its place.

    Parameters
    ----------
    what : Placed
    chunk : int
        -1 for the codebooks.
    """

    what: Placed
    chunk: int


def tail_drop(coefficients: F32, energy: F64, basis_spread: F64) -> float:
    """Return the squared error of pictures without the SH coefficients above DC.

    Parameters
    ----------
    coefficients : (n, K-1, 3) float32
    energy : (n,) float64
        Squared error of the pictures per squared error of each splat's colour.
    basis_spread : (15, 15) float64
        `Scores.basis_spread`; zeros where nothing was scored.
    """
    count = coefficients.shape[1]
    spread = basis_spread[:count, :count]
    if not spread.any():
        spread = np.eye(count) / (4 * np.pi)
    total = 0.0
    for channel in range(3):
        values = coefficients[:, :, channel].astype(np.float64)
        # The sum over splats of energy · vᵀ spread v, without a product for each splat.
        total += float(np.sum(spread * ((values.T * energy) @ values)))
    return total


def unsent_shares(contribution: F64) -> F64:
    """Return the share of the contribution that is missing before each chunk and after the last.

    Parameters
    ----------
    contribution : (c,) float64
        Of each chunk; where nothing was scored, all count the same.
    """
    if not contribution.sum() > 0:
        contribution = np.ones(len(contribution))
    total = max(float(contribution.sum()), 1e-300)
    shares: F64 = np.maximum(1 - np.concatenate([[0.0], np.cumsum(contribution)]) / total, 0)
    return shares


def measured_shares(prefix_mse: F64) -> F64:
    """Return the shares that would be missing, had pictures the errors that were measured.

    Parameters
    ----------
    prefix_mse : (c + 1,) float64
        Squared error of the pictures before each chunk and after the last.

    Returns
    -------
    (c + 1,) float64
        From 1 at most, never rising.
    """
    excess = np.maximum(prefix_mse - prefix_mse[-1], 0.0)
    shares: F64 = np.sqrt(np.minimum.accumulate(excess) / MISSING_ALL)
    return np.minimum(shares, 1.0)


def head_drops(missing: F64, missing_all: float = MISSING_ALL) -> F64:
    """Return the squared error of the pictures that each chunk's head removes.

    Parameters
    ----------
    missing : (c + 1,) float64
        `unsent_shares`.
    missing_all : float
        Squared error of pictures of nothing.

    Returns
    -------
    (c,) float64
    """
    drops: F64 = -missing_all * np.diff(np.square(missing))
    return drops


def refinement_weight(missing: F64) -> F64:
    """Return how much more a refinement's error counts while shares of contribution are missing."""
    first, more = _REFINEMENT_WEIGHT
    return first + more * missing


def order(chunks: Sequence[ChunkParts], missing: F64, codebook_bytes: int) -> list[Place]:
    """Return all segments, at each place the one that removes most error per byte.

    Heads stay in the order of their chunks, refinements and tails stand behind their heads, and the
    codebooks before the first tail.

    Parameters
    ----------
    chunks : sequence of ChunkParts
    missing : (c + 1,) float64
        `unsent_shares`.
    codebook_bytes : int
        Bytes of the codebooks that tails need; 0 where there are none.
    """
    out: list[Place] = []
    heads = _head_drops_per_byte([c.head_bytes for c in chunks], head_drops(missing))
    # Heaps of (minus the drop per byte, chunk): the largest first, then the earliest chunk.
    refinements: list[tuple[float, int]] = []
    tails: list[tuple[float, int]] = []
    has_codebooks = not codebook_bytes
    codebooks = -1.0
    head = 0
    while head < len(chunks) or refinements or tails or not has_codebooks:
        weight = float(refinement_weight(missing[head]))
        drops_per_byte = {
            Placed.HEAD: heads[head] if head < len(chunks) else -1.0,
            Placed.REFINEMENT: -refinements[0][0] * weight if refinements else -1.0,
            Placed.CODEBOOKS: codebooks if not has_codebooks else -1.0,
            Placed.TAIL: -tails[0][0] * _TAIL_WEIGHT if tails and has_codebooks else -1.0,
        }
        what = max(drops_per_byte, key=lambda name: drops_per_byte[name])
        if what is Placed.HEAD and head < len(chunks):
            out.append(Place(Placed.HEAD, head))
            chunk = chunks[head]
            if chunk.refinement is not None:
                heappush(refinements, (-chunk.refinement.drop_per_byte, head))
            if chunk.tail is not None:
                heappush(tails, (-chunk.tail.drop_per_byte, head))
            if not has_codebooks:
                waiting = [chunks[n].tail for _, n in tails]
                codebooks = _codebooks_drop_per_byte(codebook_bytes, waiting)
            head += 1
        elif not has_codebooks and (what is Placed.CODEBOOKS or drops_per_byte[what] < 0):
            out.append(Place(Placed.CODEBOOKS, -1))
            has_codebooks = True
        else:
            heap = refinements if what is Placed.REFINEMENT else tails
            out.append(Place(what, heappop(heap)[1]))
    return out


def _head_drops_per_byte(sizes: Sequence[int], drops: F64) -> list[float]:
    """Return for each head the most that a byte removes of any run of heads that begins with it."""
    out = []
    for first in range(len(sizes)):
        run = slice(first, first + _LOOK_AHEAD)
        per_byte = np.cumsum(drops[run]) / np.maximum(np.cumsum(sizes[run]), 1)
        out.append(float(per_byte.max()))
    return out


def _codebooks_drop_per_byte(codebook_bytes: int, tails: Sequence[Part | None]) -> float:
    """Return the most that a byte of the codebooks removes, together with tails behind them."""
    size, drop, best = codebook_bytes, 0.0, -1.0
    for part in sorted((t for t in tails if t is not None), key=lambda t: -t.drop_per_byte):
        size, drop = size + part.size_bytes, drop + part.distortion_drop * _TAIL_WEIGHT
        best = max(best, drop / max(size, 1))
    return best
