"""Order of a file's segments by the error that they remove per byte (SPEC 5.1, 10)."""

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
"""Squared error of an empty picture."""

# Compensated pictures were measured to have a tenth of that error. A third of a tenth gave the best
# orders: compensation is fitted to refined splats and suits coarse splats less.
MISSING_COMPENSATED: Final = 0.005
"""Squared error of an empty picture in the model of compensated prefixes."""

# Weight of an error in a prefix relative to the whole scene: in a prefix fewer splats lie in front.
# For refinements the first number plus the second times the missing share; for tails one factor.
# Measured on a trained scene.
_REFINEMENT_WEIGHT: Final = (2.0, 8.0)
_TAIL_WEIGHT: Final = 5.0

# Heads keep the order of the chunks. A head that removes little error is rated together with up to
# this many heads after it.
_LOOK_AHEAD: Final = 16


class OrderedKind(Enum):
    """Kind of a segment in the order: head, refinement, tail or colour codebooks."""

    HEAD = auto()
    REFINEMENT = auto()
    TAIL = auto()
    CODEBOOKS = auto()
    """The colour codebooks, which all tails need."""


@dataclass(frozen=True)
class SegmentGain:
    """Size of a segment, and the drop of squared error when it is added to a prefix.

    Parameters
    ----------
    size_bytes : int
        Size of the segment, bytes.
    distortion_drop : float
        Drop of the pictures' squared error.
    """

    size_bytes: int
    distortion_drop: float

    @property
    def drop_per_byte(self) -> float:
        """Drop of squared error per byte; 0 if the error would rise."""
        return max(self.distortion_drop, 0.0) / max(self.size_bytes, 1)


@dataclass(frozen=True)
class ChunkSegments:
    """Sizes of a chunk's head, refinement and tail, with the gains of the latter two.

    Parameters
    ----------
    head_bytes : int
        Size of the head, bytes. Its drop of squared error is computed by `head_distortion_drops`.
    refinement, tail : SegmentGain or None
        Size and gain; None if the chunk has no such segment.
    """

    head_bytes: int
    refinement: SegmentGain | None
    tail: SegmentGain | None


@dataclass(frozen=True)
class OrderedSegment:
    """One entry of the segment order.

    Parameters
    ----------
    kind : OrderedKind
        Kind of the segment.
    chunk : int
        Number of the chunk; -1 for the codebooks.
    """

    kind: OrderedKind
    chunk: int


def tail_distortion_drop(coefficients: F32, energy: F64, basis_spread: F64) -> float:
    """Return the drop of squared error by a chunk's tail: the error without SH above DC.

    Parameters
    ----------
    coefficients : (n, K-1, 3) float32
        shN of the chunk.
    energy : (n,) float64
        Squared error of the pictures per squared error of each splat's colour.
    basis_spread : (K-1, K-1) float64
        `Scores.basis_spread`; zeros if no view was scored.
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


def missing_shares(contribution: F64) -> F64:
    """Return the missing share of the contribution before each chunk and after the last.

    Parameters
    ----------
    contribution : (c,) float64
        Contribution of each chunk; if all are zero, all chunks count equally.

    Returns
    -------
    (c + 1,) float64
        Non-increasing shares from 1 to 0.
    """
    if not contribution.sum() > 0:
        contribution = np.ones(len(contribution))
    total = max(float(contribution.sum()), 1e-300)
    shares: F64 = np.maximum(1 - np.concatenate([[0.0], np.cumsum(contribution)]) / total, 0)
    return shares


def missing_shares_from_mse(prefix_mse: F64) -> F64:
    """Return missing shares derived from the measured errors of prefixes.

    A share is √(excess error / `MISSING_ALL`), where the excess is relative to the whole file.

    Parameters
    ----------
    prefix_mse : (c + 1,) float64
        Squared error of the pictures before each chunk and after the last.

    Returns
    -------
    (c + 1,) float64
        Shares of at most 1, never rising.
    """
    excess = np.maximum(prefix_mse - prefix_mse[-1], 0.0)
    shares: F64 = np.sqrt(np.minimum.accumulate(excess) / MISSING_ALL)
    return np.minimum(shares, 1.0)


def head_distortion_drops(missing: F64, missing_all: float = MISSING_ALL) -> F64:
    """Return the drop of the pictures' squared error by each chunk's head.

    While a share R of the contribution is missing, the squared error is `missing_all` times R².

    Parameters
    ----------
    missing : (c + 1,) float64
        Missing share of the contribution before each chunk and after the last
        (`missing_shares`).
    missing_all : float
        Squared error of an empty picture.

    Returns
    -------
    (c,) float64
    """
    drops: F64 = -missing_all * np.diff(np.square(missing))
    return drops


def refinement_weight(missing: F64) -> F64:
    """Return the weight of a refinement's error in a prefix, by its missing shares (any shape)."""
    base, slope = _REFINEMENT_WEIGHT
    return base + slope * missing


def order_segments(
    chunks: Sequence[ChunkSegments], missing: F64, codebook_bytes: int
) -> list[OrderedSegment]:
    """Order all segments greedily by the error that they remove per byte.

    Heads keep the order of their chunks. Refinements and tails come after their heads, the
    codebooks before the first tail.

    Parameters
    ----------
    chunks : sequence of ChunkSegments
        Segments of each chunk, in the order of the chunks.
    missing : (c + 1,) float64
        Missing share of the contribution before each chunk and after the last
        (`missing_shares`).
    codebook_bytes : int
        Size of the codebooks that tails need, bytes; 0 if there are none.
    """
    out: list[OrderedSegment] = []
    heads = _head_drops_per_byte([c.head_bytes for c in chunks], head_distortion_drops(missing))
    # Heaps of (minus the drop per byte, chunk): the largest first, then the earliest chunk.
    refinements: list[tuple[float, int]] = []
    tails: list[tuple[float, int]] = []
    has_codebooks = not codebook_bytes
    codebooks = -1.0
    head = 0
    while head < len(chunks) or refinements or tails or not has_codebooks:
        weight = float(refinement_weight(missing[head]))
        drops_per_byte = {
            OrderedKind.HEAD: heads[head] if head < len(chunks) else -1.0,
            OrderedKind.REFINEMENT: -refinements[0][0] * weight if refinements else -1.0,
            OrderedKind.CODEBOOKS: codebooks if not has_codebooks else -1.0,
            OrderedKind.TAIL: -tails[0][0] * _TAIL_WEIGHT if tails and has_codebooks else -1.0,
        }
        kind = max(drops_per_byte, key=lambda candidate: drops_per_byte[candidate])
        if kind is OrderedKind.HEAD and head < len(chunks):
            out.append(OrderedSegment(OrderedKind.HEAD, head))
            chunk = chunks[head]
            if chunk.refinement is not None:
                heappush(refinements, (-chunk.refinement.drop_per_byte, head))
            if chunk.tail is not None:
                heappush(tails, (-chunk.tail.drop_per_byte, head))
            if not has_codebooks:
                available = [chunks[n].tail for _, n in tails]
                codebooks = _codebooks_drop_per_byte(codebook_bytes, available)
            head += 1
        elif not has_codebooks and (kind is OrderedKind.CODEBOOKS or drops_per_byte[kind] < 0):
            out.append(OrderedSegment(OrderedKind.CODEBOOKS, -1))
            has_codebooks = True
        else:
            heap = refinements if kind is OrderedKind.REFINEMENT else tails
            out.append(OrderedSegment(kind, heappop(heap)[1]))
    return out


def _head_drops_per_byte(sizes: Sequence[int], drops: F64) -> list[float]:
    """Return a priority of each head: the largest error drop per byte of a run that it starts.

    A run is the head alone or together with heads after it, up to `_LOOK_AHEAD` in all.
    """
    out = []
    for first in range(len(sizes)):
        run = slice(first, first + _LOOK_AHEAD)
        per_byte = np.cumsum(drops[run]) / np.maximum(np.cumsum(sizes[run]), 1)
        out.append(float(per_byte.max()))
    return out


def _codebooks_drop_per_byte(codebook_bytes: int, tails: Sequence[SegmentGain | None]) -> float:
    """Return the priority of the codebooks: their error drop per byte together with tails.

    The best tails by error drop per byte are added while they raise the result.
    """
    size, drop, best = codebook_bytes, 0.0, -1.0
    for tail in sorted((t for t in tails if t is not None), key=lambda t: -t.drop_per_byte):
        size, drop = size + tail.size_bytes, drop + tail.distortion_drop * _TAIL_WEIGHT
        best = max(best, drop / max(size, 1))
    return best
