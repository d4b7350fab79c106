"""Targets: the nominal quality at which a scene comes out as small, or as good, as is asked for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

import numpy as np

from cogsplat.codec.errors import DataError
from cogsplat.codec.progress import Progress, silent

from .config import MAX_QUALITY_DB, MIN_QUALITY_DB
from .encoded import EncodedScene
from .encoder import Prepared

MAX_TRIALS: Final = 8
"""Encodes that a search takes at most."""

PSNR_TOLERANCE_DB: Final = 0.02
"""How far from a PSNR a search may stop."""

SIZE_TOLERANCE: Final = 0.005
"""How far below a size a search may stop, as a share of it."""

# A PSNR missed by more than this at an end of what can be set is out of reach, dB.
_NEAR_DB: Final = 0.1

# Before a search knows better: what a nominal quality is above the PSNR, bytes of a splat at one,
# PSNR per nominal dB, and log2 of the bytes per nominal dB, of trained scenes between 33 and 47 dB.
_NOMINAL_DB: Final = 0.0
_START_DB: Final = 35.5
_START_BYTES: Final = 6.0
_PSNR_PER_DB: Final = 0.85
_LOG2_BYTES_PER_DB: Final = 0.085

# No step beyond what was tried is longer, dB: the curves flatten at their ends.
_LONGEST_DB: Final = 15.0
# Trials nearer to each other than this differ by nothing, dB.
_SHORTEST_DB: Final = 1e-3
# A trial between two others keeps this share of their distance from both.
_MARGIN: Final = 0.03


@dataclass(frozen=True)
class Target:
    """What an encode aims at: one of two.

    Parameters
    ----------
    psnr_db : float or None
        Mean PSNR against the source's own pictures, dB, in views that the encoder has.
    size_bytes : int or None
        Bytes of the whole file, never exceeded.
    """

    psnr_db: float | None = None
    size_bytes: int | None = None

    def __post_init__(self) -> None:
        if (self.psnr_db is None) == (self.size_bytes is None):
            raise ValueError(f"{self}, expected either a PSNR or a size")
        if self.psnr_db is not None and not 5 <= self.psnr_db <= 90:
            raise ValueError(f"a PSNR of {self.psnr_db} dB, expected 5 to 90")
        if self.size_bytes is not None and self.size_bytes < 1:
            raise ValueError(f"a size of {self.size_bytes}, expected at least 1 byte")


TARGET_VIEWS: Final = 32
"""Views that a PSNR is measured in, at most."""


@dataclass(frozen=True, eq=False)
class Hit:
    """What a search found.

    Parameters
    ----------
    encoded : EncodedScene
    quality_db : float
        The nominal quality it was encoded at.
    value : float
        PSNR in dB, or bytes.
    trials : int
        Encodes it took.
    """

    encoded: EncodedScene
    quality_db: float
    value: float
    trials: int


def to_psnr(
    prepared: Prepared,
    psnr_db: float,
    psnr_of: Callable[[EncodedScene], float],
    *,
    progress: Progress = silent,
) -> Hit:
    """Encode a scene so that it comes as near to a PSNR as a few trials bring it.

    Parameters
    ----------
    prepared : Prepared
    psnr_db : float
        dB.
    psnr_of : callable
        Measures a trial, dB.
    progress : Progress
        Called with ``search`` and the trials done, of `MAX_TRIALS`.

    Raises
    ------
    DataError
        ``target-out-of-reach``: beyond what the finest or the coarsest setting gives.
    """

    def enough(value: float) -> bool:
        return abs(value - psnr_db) <= PSNR_TOLERANCE_DB

    found = _search(
        prepared, psnr_db + _NOMINAL_DB, psnr_db, psnr_of, _PSNR_PER_DB, enough, progress
    )
    best = min(found, key=lambda hit: abs(hit.value - psnr_db))
    if abs(best.value - psnr_db) > _NEAR_DB and any(_at_an_end(hit) for hit in found):
        raise _out_of_reach(f"PSNR of {psnr_db:g} dB", f"{best.value:.2f} dB")
    return _counted(best, found)


def to_size(
    prepared: Prepared,
    size_bytes: int,
    size_of: Callable[[EncodedScene], int],
    *,
    progress: Progress = silent,
) -> Hit:
    """Encode a scene as finely as a size allows.

    Parameters
    ----------
    prepared : Prepared
    size_bytes : int
        Never exceeded; at least 1.
    size_of : callable
        Bytes of the whole file that a trial would make.
    progress : Progress
        As `to_psnr`.

    Raises
    ------
    DataError
        ``target-out-of-reach``: larger even at the coarsest setting.
    """

    def enough(value: float) -> bool:
        return bool(1 - SIZE_TOLERANCE <= np.exp2(value) / size_bytes <= 1.0)

    # A little below the size, so that a guess that is off by a little is not too large.
    goal = float(np.log2(size_bytes * (1 - SIZE_TOLERANCE / 2)))
    each = size_bytes / max(len(prepared.rows), 1)
    found = _search(
        prepared,
        _START_DB + float(np.log2(each / _START_BYTES)) / _LOG2_BYTES_PER_DB,
        goal,
        lambda encoded: float(np.log2(size_of(encoded))),
        _LOG2_BYTES_PER_DB,
        enough,
        progress,
    )
    fitting = [hit for hit in found if round(2.0**hit.value) <= size_bytes]
    if not fitting:
        least = min(round(2.0**hit.value) for hit in found)
        raise _out_of_reach(f"size of {size_bytes:,} bytes", f"{least:,} bytes")
    best = max(fitting, key=lambda hit: hit.quality_db)
    return _counted(best, found)


def _counted(best: Hit, found: list[Hit]) -> Hit:
    return Hit(best.encoded, best.quality_db, best.value, len(found))


def _at_an_end(hit: Hit) -> bool:
    return hit.quality_db in (MIN_QUALITY_DB, MAX_QUALITY_DB)


def _out_of_reach(wanted: str, found: str) -> DataError:
    return DataError(
        "target-out-of-reach",
        f"a {wanted} for this scene: the nearest it comes is {found}, expected a target in reach",
    )


def _search(
    prepared: Prepared,
    start_db: float,
    goal: float,
    measure: Callable[[EncodedScene], float],
    rise: float,
    enough: Callable[[float], bool],
    progress: Progress,
) -> list[Hit]:
    """Try qualities until one is good enough or the next would be no other; return all trials."""
    found: list[Hit] = []
    quality = _within(start_db)
    progress("search", 0, MAX_TRIALS)
    while len(found) < MAX_TRIALS:
        encoded = prepared.encode(quality)
        hit = Hit(encoded, quality, measure(encoded), len(found) + 1)
        found.append(hit)
        progress("search", len(found), MAX_TRIALS)
        if enough(hit.value):
            break
        quality = _next(found, goal, rise)
        if any(abs(quality - other.quality_db) < _SHORTEST_DB for other in found):
            break
    progress("search", MAX_TRIALS, MAX_TRIALS)
    return found


def _next(found: list[Hit], goal: float, rise: float) -> float:
    """Return the quality to try: between the nearest values on both sides, else further out."""
    below = max((h for h in found if h.value < goal), key=lambda h: h.value, default=None)
    above = min((h for h in found if h.value >= goal), key=lambda h: h.value, default=None)
    if below and above:
        share = (goal - below.value) / (above.value - below.value)
        share = min(max(share, _MARGIN), 1 - _MARGIN)
        return below.quality_db + share * (above.quality_db - below.quality_db)
    last = found[-1]
    if len(found) > 1:
        run = last.quality_db - found[-2].quality_db
        # Curves that flatten must not send the search off: at least a quarter of the usual rise.
        rise = max((last.value - found[-2].value) / run, rise / 4)
    step = min(max((goal - last.value) / rise, -_LONGEST_DB), _LONGEST_DB)
    return _within(last.quality_db + step)


def _within(quality_db: float) -> float:
    return min(max(quality_db, MIN_QUALITY_DB), MAX_QUALITY_DB)
