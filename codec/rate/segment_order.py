"""The order of a file's segments: what shows most for its bytes comes first (SPEC 5.1, 10)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from heapq import heappop, heappush
from typing import Final

import numpy as np
from numpy.typing import NDArray

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

# Squared error of pictures that miss splats of all the contribution there is; with a share R of it
# missing it is about this times R². Three trained scenes lie between 0.02 and 0.2.
MISSING_ALL: Final = 0.15
"""Squared error of pictures of nothing."""

# Compensated pictures are measured to miss a tenth of that; a third of a tenth served them best,
# for what is fitted to refined splats does not fit coarse ones as well.
MISSING_COMPENSATED: Final = 0.005
"""The same of pictures that make up for what is missing."""

# What removing an error gains while splats are missing, relative to the whole scene: less stands
# before what is there. Of refinements, the first plus the second times the share that is missing;
# measured on a trained scene.
_REFINED: Final = (2.0, 8.0)
_GLOSSED: Final = 5.0

# Chunks that one that gains little may wait to be taken with.
_LOOK_AHEAD: Final = 16


@dataclass(frozen=True)
class Part:
    """A segment, or several that stand together, that may be placed.

    Parameters
    ----------
    size : int
        Bytes.
    gain : float
        Squared error of the pictures that it removes.
    """

    size: int
    gain: float

    @property
    def worth(self) -> float:
        """Gain per byte."""
        return max(self.gain, 0.0) / max(self.size, 1)


@dataclass(frozen=True)
class ChunkParts:
    """The segments of a chunk.

    Parameters
    ----------
    head : int
        Bytes.
    refinement, tail : Part or None
    """

    head: int
    refinement: Part | None
    tail: Part | None


@dataclass(frozen=True)
class Place:
    """A segment in its place.

    Parameters
    ----------
    what : str
        ``head``, ``refinement``, ``tail`` or ``books``: all that tails share.
    chunk : int
        -1 for books.
    """

    what: str
    chunk: int


def tail_gain(coefficients: F32, energy: F64, basis_spread: F64) -> float:
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
        total += float(energy @ ((values @ spread) * values).sum(axis=1))
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


def head_gains(missing: F64, missing_all: float = MISSING_ALL) -> F64:
    """Return what each chunk's head removes of a picture's error, (c,) float64."""
    gains: F64 = -missing_all * np.diff(np.square(missing))
    return gains


def refined_gain(missing: F64) -> F64:
    """Return how much more a refinement gains while a share of the contribution is missing."""
    first, more = _REFINED
    return first + more * missing


def order(chunks: Sequence[ChunkParts], missing: F64, books: int) -> list[Place]:
    """Return all segments, each time what removes most error for its bytes.

    Heads stay in the order of their chunks, refinements and tails behind their heads, and the
    books before the first tail.

    Parameters
    ----------
    chunks : sequence of ChunkParts
    missing : (c + 1,) float64
        `unsent_shares`.
    books : int
        Bytes of what tails share; 0 where there is none.
    """
    out: list[Place] = []
    gains = head_gains(missing)
    heads = _runs([c.head for c in chunks], gains)
    # Largest worth first, then the earliest chunk.
    refinements: list[tuple[float, int]] = []
    tails: list[tuple[float, int]] = []
    opened = not books
    book_worth = -1.0
    head = 0
    while head < len(chunks) or refinements or tails or not opened:
        amplified = float(refined_gain(missing[head]))
        worths = {
            "head": heads[head] if head < len(chunks) else -1.0,
            "refinement": -refinements[0][0] * amplified if refinements else -1.0,
            "books": book_worth if not opened else -1.0,
            "tail": -tails[0][0] * _GLOSSED if tails and opened else -1.0,
        }
        what = max(worths, key=lambda name: worths[name])
        if what == "head" and head < len(chunks):
            out.append(Place("head", head))
            chunk = chunks[head]
            if chunk.refinement is not None:
                heappush(refinements, (-chunk.refinement.worth, head))
            if chunk.tail is not None:
                heappush(tails, (-chunk.tail.worth, head))
            if not opened:
                book_worth = _opened(books, [chunks[n].tail for _, n in tails])
            head += 1
        elif not opened and (what == "books" or worths[what] < 0):
            out.append(Place("books", -1))
            opened = True
        else:
            out.append(Place(what, heappop(refinements if what == "refinement" else tails)[1]))
    return out


def _runs(parts: Sequence[int], gains: F64) -> list[float]:
    """Return for each head the most gain per byte of a run of heads that starts with it."""
    out = []
    for first in range(len(parts)):
        run = slice(first, first + _LOOK_AHEAD)
        sums = np.cumsum(gains[run]) / np.maximum(np.cumsum(parts[run]), 1)
        out.append(float(sums.max()))
    return out


def _opened(books: int, tails: Sequence[Part | None]) -> float:
    """Return the most gain per byte of the books together with tails that are waiting for them."""
    size, gain, best = books, 0.0, -1.0
    for part in sorted((t for t in tails if t is not None), key=lambda t: -t.worth):
        size, gain = size + part.size, gain + part.gain * _GLOSSED
        best = max(best, gain / max(size, 1))
    return best
