"""Search for the nominal quality at which an encoded scene has a target PSNR or file size."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from cogsplat.codec.errors import DataError
from cogsplat.codec.progress import Progress, silent

from .config import MAX_QUALITY_DB, MIN_QUALITY_DB
from .encoded import EncodedScene

MAX_TRIALS: Final = 8
"""Encodes that a search takes at most."""

MAX_ROUNDS: Final = 3
"""Searches for a size at most, where what is added after a search makes the file too large."""

PSNR_TOLERANCE_DB: Final = 0.05
"""How far from a PSNR a search may stop: half of what a mean over 32 views is certain to."""

NOMINAL_TOLERANCE_DB: Final = 1.0
"""How far a nominal quality may be from the PSNR in planned test views before it is corrected."""

NOMINAL_TRIALS: Final = 4
"""Qualities that are tried for a nominal one at most: it, and others where it is far off."""

SIZE_TOLERANCE: Final = 0.005
"""How far below a size a search may stop, as a share of it."""

# A PSNR missed by more than this at an end of what can be set is out of reach, dB.
_NEAR_DB: Final = 0.1

# Before a search knows better: what a nominal quality is above the PSNR, bytes of a splat at one,
# PSNR per nominal dB, and log2 of the bytes per nominal dB, of trained scenes between 33 and 47 dB.
# With 0.8 dB per nominal dB, searches on the curve of a cleaned object take 3.1 trials on average,
# with 0.85 they take 3.4.
_NOMINAL_DB: Final = 0.0
_START_DB: Final = 35.5
_START_BYTES: Final = 6.0
PSNR_PER_DB: Final = 0.8
LOG2_BYTES_PER_DB: Final = 0.085

# No step beyond what was tried is longer, dB: the curves flatten at their ends.
_LONGEST_DB: Final = 15.0
# Trials nearer to each other than this differ by nothing, dB.
_SHORTEST_DB: Final = 1e-3
# A trial between two others keeps this share of their distance from both.
_MARGIN: Final = 0.03


EncodeAt = Callable[[float], EncodedScene]
"""Encodes a scene at a nominal quality, dB."""


@dataclass(frozen=True, eq=False)
class Hit:
    """The encode that came nearest to a target.

    Parameters
    ----------
    encoded : EncodedScene
    quality_db : float
        The nominal quality it was encoded at.
    value : float
        What was measured of it: PSNR in dB, or bytes.
    trials : int
        Encodes that the search took.
    """

    encoded: EncodedScene
    quality_db: float
    value: float
    trials: int


def to_psnr(
    encode_at: EncodeAt,
    psnr_db: float,
    psnr_of: Callable[[EncodedScene], float],
    *,
    progress: Progress = silent,
) -> Hit:
    """Search for the nominal quality at which a scene has a PSNR.

    Parameters
    ----------
    encode_at : callable
    psnr_db : float
        The target, dB.
    psnr_of : callable
        Measures an encoded scene, dB.
    progress : Progress
        Called with ``search`` and the trials done, of `MAX_TRIALS`.

    Raises
    ------
    DataError
        ``target-out-of-reach``: beyond what the finest or the coarsest setting gives.
    """
    goal = _psnr_goal(psnr_db, PSNR_TOLERANCE_DB)
    best, trials = _search(encode_at, goal, psnr_of, progress)
    if abs(best.value - psnr_db) > _NEAR_DB and any(
        trial.quality_db in (MIN_QUALITY_DB, MAX_QUALITY_DB) for trial in trials
    ):
        raise _out_of_reach(f"PSNR of {psnr_db:g} dB", f"{best.value:.2f} dB")
    return best


def to_nominal(
    encode_at: EncodeAt,
    quality_db: float,
    psnr_of: Callable[[EncodedScene], float],
    *,
    progress: Progress = silent,
) -> Hit:
    """Encode at a nominal quality, and again where the PSNR that is measured is far from it.

    λ follows from the nominal quality by the energies of the views that were scored, and by what
    trained scenes in their own cameras lose. Around other scenes the views that were planned stand
    nearer than visitors do, or further away, and their splats lose more or less: the PSNR is up to
    12 dB above the nominal one. So it is measured; what is left then is `NOMINAL_TOLERANCE_DB` or
    a little more.

    Parameters
    ----------
    encode_at : callable
    quality_db : float
        Nominal PSNR, dB.
    psnr_of : callable
        Measures an encoded scene, dB.
    progress : Progress
        As in `to_psnr`.

    Returns
    -------
    Hit
        The nearest of at most `NOMINAL_TRIALS`. Only one scene at a time is kept.
    """
    goal = _psnr_goal(quality_db, NOMINAL_TOLERANCE_DB)
    best, _ = _search(encode_at, goal, psnr_of, progress, NOMINAL_TRIALS, keep=False)
    return replace(best, quality_db=quality_db)


def to_size(
    encode_at: EncodeAt,
    splats: int,
    size_bytes: int,
    size_of: Callable[[EncodedScene], int],
    *,
    progress: Progress = silent,
) -> Hit:
    """Search for the finest nominal quality at which a scene takes no more than a size.

    Parameters
    ----------
    encode_at : callable
    splats : int
        That may be stored: the search begins at what so many usually take.
    size_bytes : int
        The target, never exceeded; at least 1.
    size_of : callable
        Bytes of the whole file that an encoded scene would make.
    progress : Progress
        As in `to_psnr`.

    Raises
    ------
    DataError
        ``target-out-of-reach``: larger even at the coarsest setting.
    """

    def fits(trial: _Trial) -> bool:
        return bool(round(2.0**trial.value) <= size_bytes)

    def is_better(trial: _Trial, best: _Trial) -> bool:
        if fits(trial) and fits(best):
            return trial.quality_db > best.quality_db
        return trial.value < best.value

    # Sizes are searched for as base-2 logarithms, which rise nearly evenly with the quality.
    goal = _Goal(
        # A little below the size, so that a guess that is off by a little is not too large.
        value=float(np.log2(size_bytes * (1 - SIZE_TOLERANCE / 2))),
        rise=LOG2_BYTES_PER_DB,
        start_db=_START_DB
        + float(np.log2(size_bytes / max(splats, 1) / _START_BYTES)) / LOG2_BYTES_PER_DB,
        is_enough=lambda value: bool(1 - SIZE_TOLERANCE <= np.exp2(value) / size_bytes <= 1.0),
        is_better=is_better,
    )
    best, trials = _search(encode_at, goal, lambda scene: float(np.log2(size_of(scene))), progress)
    if not fits(_Trial(best.quality_db, best.value)):
        least = min(round(2.0**trial.value) for trial in trials)
        raise _out_of_reach(f"size of {size_bytes:,} bytes", f"{least:,} bytes")
    return replace(best, value=float(round(2.0**best.value)))


def to_finished_size(
    encode_at: EncodeAt,
    splats: int,
    size_bytes: int,
    foreseen_size: Callable[[EncodedScene], int],
    finish: Callable[[EncodedScene], EncodedScene],
    size_of: Callable[[EncodedScene], int],
    *,
    progress: Progress = silent,
) -> Hit:
    """Search as `to_size` does and finish the result, which may change its size a little.

    What is added to a scene after the search takes a known number of bytes, but the order of
    segments follows from it, and with that order index pages end elsewhere. Where a finished scene
    is too large, the search begins again at a size that is lower by what was added. There are at
    most `MAX_ROUNDS` searches; after the last, segments keep the order that the search measured.

    Parameters
    ----------
    encode_at, splats, size_bytes
        As in `to_size`.
    foreseen_size : callable
        Bytes of the whole file that an encoded scene will make once it is finished.
    finish : callable
        Adds compensation and predicted quality to an encoded scene.
    size_of : callable
        Bytes of the whole file that a finished scene makes.
    progress : Progress
        As in `to_psnr`.

    Raises
    ------
    DataError
        ``target-out-of-reach``, as in `to_size`.
    """
    aim, trials = size_bytes, 0
    for _ in range(MAX_ROUNDS):
        hit = to_size(encode_at, splats, aim, foreseen_size, progress=progress)
        trials += hit.trials
        finished = finish(hit.encoded)
        size = size_of(finished)
        if size <= size_bytes:
            break
        aim = size_bytes - (size - round(hit.value))
        if aim < 1:
            raise _out_of_reach(f"size of {size_bytes:,} bytes", f"{size:,} bytes")
    else:
        finished = replace(finished, prefix_mse=None)
    return Hit(finished, hit.quality_db, float(size_of(finished)), trials)


@dataclass(frozen=True)
class _Trial:
    """A nominal quality and what was measured at it."""

    quality_db: float
    value: float


@dataclass(frozen=True, eq=False)
class _Goal:
    """The value that a search aims at.

    Parameters
    ----------
    value : float
    rise : float
        How much the value usually rises per nominal dB.
    start_db : float
        The nominal quality to try first.
    is_enough : callable
        Tells whether a value is near enough to stop.
    is_better : callable
        Tells whether a trial beats another.
    """

    value: float
    rise: float
    start_db: float
    is_enough: Callable[[float], bool]
    is_better: Callable[[_Trial, _Trial], bool]


def _psnr_goal(psnr_db: float, tolerance_db: float) -> _Goal:
    """Return the goal of a search for a PSNR, which begins at the same nominal quality."""

    def miss(value: float) -> float:
        return abs(value - psnr_db)

    return _Goal(
        value=psnr_db,
        rise=PSNR_PER_DB,
        start_db=psnr_db + _NOMINAL_DB,
        is_enough=lambda value: miss(value) <= tolerance_db,
        is_better=lambda trial, best: miss(trial.value) < miss(best.value),
    )


def _out_of_reach(wanted: str, found: str) -> DataError:
    return DataError(
        "target-out-of-reach",
        f"a {wanted} for this scene: the nearest it comes is {found}, expected a target in reach",
    )


def _search(
    encode_at: EncodeAt,
    goal: _Goal,
    measure: Callable[[EncodedScene], float],
    progress: Progress,
    most_trials: int = MAX_TRIALS,
    *,
    keep: bool = True,
) -> tuple[Hit, list[_Trial]]:
    """Try qualities until one is near enough or the next would be no other; return the best.

    The best scene is kept while others are tried: a large one takes as much memory as its source.
    Without `keep` it is encoded once more where another was tried after it.
    """
    trials: list[_Trial] = []
    best: _Trial | None = None
    kept: EncodedScene | None = None
    quality = _within(goal.start_db)
    progress("search", 0, most_trials)
    while len(trials) < most_trials:
        if not keep:
            kept = None
        encoded = encode_at(quality)
        trial = _Trial(quality, measure(encoded))
        trials.append(trial)
        if best is None or goal.is_better(trial, best):
            best, kept = trial, encoded
        del encoded
        progress("search", len(trials), most_trials)
        if goal.is_enough(trial.value):
            break
        quality = _next(trials, goal.value, goal.rise)
        if any(abs(quality - other.quality_db) < _SHORTEST_DB for other in trials):
            break
    if best is None:
        raise AssertionError("a search without a trial")
    count = len(trials)
    if kept is None:
        kept, count = encode_at(best.quality_db), count + 1
    progress("search", most_trials, most_trials)
    return Hit(kept, best.quality_db, best.value, count), trials


def _next(trials: list[_Trial], goal: float, rise: float) -> float:
    """Return the quality to try: between neighbours on both sides of the goal, else further out.

    A finer setting may give a little less, where a codebook takes another number of rows. So the
    two trials are neighbours by quality, the nearest such pair: values of others say nothing of
    what lies between the two.
    """
    by_quality = sorted(trials, key=lambda trial: trial.quality_db)
    pairs = [
        (lower, upper)
        for lower, upper in pairwise(by_quality)
        if (lower.value < goal) != (upper.value < goal)
    ]
    if pairs:
        lower, upper = min(pairs, key=lambda pair: pair[1].quality_db - pair[0].quality_db)
        share = (goal - lower.value) / (upper.value - lower.value)
        share = min(max(share, _MARGIN), 1 - _MARGIN)
        return lower.quality_db + share * (upper.quality_db - lower.quality_db)
    last = trials[-1]
    if len(trials) > 1:
        run = last.quality_db - trials[-2].quality_db
        # Curves that flatten must not send the search off: at least a quarter of the usual rise.
        rise = max((last.value - trials[-2].value) / run, rise / 4)
    step = min(max((goal - last.value) / rise, -_LONGEST_DB), _LONGEST_DB)
    return _within(last.quality_db + step)


def _within(quality_db: float) -> float:
    return min(max(quality_db, MIN_QUALITY_DB), MAX_QUALITY_DB)
