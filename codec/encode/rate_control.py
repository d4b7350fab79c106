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
"""Encodes per search at most."""

MAX_ROUNDS: Final = 3
"""Searches for a size at most, if the finished file turns out too large."""

PSNR_TOLERANCE_DB: Final = 0.05
"""Tolerance of a target PSNR, dB: half the uncertainty of a mean over 32 views."""

NOMINAL_TOLERANCE_DB: Final = 1.0
"""Tolerance of a nominal quality against the PSNR in planned test views, dB."""

NOMINAL_TRIALS: Final = 4
"""Encodes at most for a nominal quality: the first, and corrections if it is far off."""

SIZE_TOLERANCE: Final = 0.005
"""Share of a target size by which a file may stay below it."""

# Distance from a target PSNR, dB, beyond which the finest or coarsest setting is out of reach.
_NEAR_DB: Final = 0.1

# Exponent e of the splat count that fits a file size, at one setting: splats ~ size ** e. It is
# above 1, because splats of small contribution take fewer bytes. Of a captured room, the half of
# the splats with the largest contribution takes 56 % of the bytes.
_SPLATS_PER_SIZE: Final = 4 / 3

# First guesses of a search, from trained scenes between 33 and 47 dB: nominal quality minus PSNR,
# bytes per splat at a nominal quality, PSNR per nominal dB, and log2 bytes per nominal dB. Searches
# on a cleaned object take 3.1 trials on average with 0.8 dB per nominal dB, and 3.4 with 0.85.
_NOMINAL_DB: Final = 0.0
_START_DB: Final = 35.5
_START_BYTES: Final = 6.0
PSNR_PER_DB: Final = 0.8
LOG2_BYTES_PER_DB: Final = 0.085

# Longest step beyond the tried qualities, dB: the curves flatten at their ends.
_LONGEST_DB: Final = 15.0
# Distance of two trials, dB, below which their results are equal.
_SHORTEST_DB: Final = 1e-3
# Least distance of a trial from its neighbours, as a share of the distance between these.
_MARGIN: Final = 0.03


EncodeAt = Callable[[float], EncodedScene]
"""Encodes a scene at a nominal quality, dB."""


@dataclass(frozen=True, eq=False)
class SearchResult:
    """Result of a search: the encode nearest to the target.

    Parameters
    ----------
    encoded : EncodedScene
        Encoded scene.
    quality_db : float
        Nominal quality of the encode, dB.
    value : float
        Measured PSNR in dB, or size in bytes.
    trials : int
        Number of encodes in the search.
    """

    encoded: EncodedScene
    quality_db: float
    value: float
    trials: int


def search_psnr(
    encode_at: EncodeAt,
    psnr_db: float,
    psnr_of: Callable[[EncodedScene], float],
    *,
    progress: Progress = silent,
) -> SearchResult:
    """Search for the nominal quality at which a scene has a PSNR.

    Parameters
    ----------
    encode_at : callable
        Encodes the scene at a nominal quality, dB.
    psnr_db : float
        Target PSNR, dB.
    psnr_of : callable
        Measures the PSNR of an encoded scene, dB.
    progress : Progress
        Called with ``search``, finished trials and `MAX_TRIALS`.

    Raises
    ------
    DataError
        ``target-out-of-reach``: even the finest or coarsest setting misses the PSNR.
    """
    goal = _psnr_goal(psnr_db, PSNR_TOLERANCE_DB)
    best, trials = _search(encode_at, goal, psnr_of, progress)
    if abs(best.value - psnr_db) > _NEAR_DB and any(
        trial.quality_db in (MIN_QUALITY_DB, MAX_QUALITY_DB) for trial in trials
    ):
        setting = "finest" if best.value < psnr_db else "coarsest"
        raise DataError(
            "target-out-of-reach",
            f"a PSNR of {psnr_db:g} dB: the {setting} setting shows {best.value:.2f} dB, expected "
            + (
                "that or less; the profile near-lossless stores more"
                if best.value < psnr_db
                else "that or more; fewer splats make a smaller file of lower PSNR"
            ),
        )
    return best


def search_nominal(
    encode_at: EncodeAt,
    quality_db: float,
    psnr_of: Callable[[EncodedScene], float],
    *,
    progress: Progress = silent,
) -> SearchResult:
    """Encode at a nominal quality; correct it if the measured PSNR is far off.

    The relation of nominal quality and PSNR was calibrated on trained scenes in their own cameras.
    In planned views, at other distances, the PSNR is up to 12 dB above the nominal quality. The
    correction brings it within about `NOMINAL_TOLERANCE_DB`.

    Parameters
    ----------
    encode_at : callable
        Encodes the scene at a nominal quality, dB.
    quality_db : float
        Nominal PSNR, dB.
    psnr_of : callable
        Measures the PSNR of an encoded scene, dB.
    progress : Progress
        Called with ``search``, finished trials and `NOMINAL_TRIALS`.

    Returns
    -------
    SearchResult
        Nearest of at most `NOMINAL_TRIALS` encodes. Only one encoded scene is in memory at a time.
    """
    goal = _psnr_goal(quality_db, NOMINAL_TOLERANCE_DB)
    best, _ = _search(encode_at, goal, psnr_of, progress, NOMINAL_TRIALS, keep=False)
    return replace(best, quality_db=quality_db)


def search_size(
    encode_at: EncodeAt,
    splats: int,
    size_bytes: int,
    size_of: Callable[[EncodedScene], int],
    *,
    progress: Progress = silent,
) -> SearchResult:
    """Search for the finest nominal quality at which a scene fits a file size.

    Parameters
    ----------
    encode_at : callable
        Encodes the scene at a nominal quality, dB.
    splats : int
        Number of splats, which sets the first guess.
    size_bytes : int
        Target size in bytes, never exceeded; at least 1.
    size_of : callable
        Returns the file size of an encoded scene, bytes.
    progress : Progress
        Called with ``search``, finished trials and `MAX_TRIALS`.

    Raises
    ------
    DataError
        ``target-out-of-reach``: the scene is too large even at the coarsest setting.
    """

    def fits(trial: _Trial) -> bool:
        """Tell whether a trial fits the target size."""
        return bool(round(2.0**trial.value) <= size_bytes)

    def is_better(trial: _Trial, best: _Trial) -> bool:
        """Tell whether a trial is better: the finer one that fits, else the smaller one."""
        if fits(trial) and fits(best):
            return trial.quality_db > best.quality_db
        return trial.value < best.value

    # The search uses the base-2 logarithm of the size, which is nearly linear in the quality.
    goal = _Goal(
        # Aim a little below the target, so that a small error still fits.
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
        raise _size_out_of_reach(size_bytes, least, splats)
    return replace(best, value=float(round(2.0**best.value)))


def search_finished_size(
    encode_at: EncodeAt,
    splats: int,
    size_bytes: int,
    final_size: Callable[[EncodedScene], int],
    finish: Callable[[EncodedScene], EncodedScene],
    size_of: Callable[[EncodedScene], int],
    *,
    progress: Progress = silent,
) -> SearchResult:
    """Search for a file size that includes compensation and predictions, and finish the scene.

    The sizes of these additions are known before the search, but the additions change the order of
    segments. This order decides where pages end, and so the size of the index. If the
    finished file is too large, the search is repeated with a target that is lower by the excess,
    `MAX_ROUNDS` times at most. If it is still too large, its segments keep the order of the search,
    for which the size is known.

    Parameters
    ----------
    encode_at : callable
        Encodes the scene at a nominal quality, dB.
    splats : int
        Number of splats, which sets the first guess.
    size_bytes : int
        Target size in bytes, never exceeded; at least 1.
    final_size : callable
        Returns the size of the finished file before anything is fitted, bytes.
    finish : callable
        Adds compensation and predicted quality to an encoded scene.
    size_of : callable
        Returns the file size of a finished scene, bytes.
    progress : Progress
        Called with ``search``.

    Raises
    ------
    DataError
        ``target-out-of-reach``: the scene is too large even at the coarsest setting.
    """
    aim, trials = size_bytes, 0
    for _ in range(MAX_ROUNDS):
        hit = search_size(encode_at, splats, aim, final_size, progress=progress)
        trials += hit.trials
        finished = finish(hit.encoded)
        size = size_of(finished)
        if size <= size_bytes:
            break
        aim = size_bytes - (size - round(hit.value))
        if aim < 1:
            raise _size_out_of_reach(size_bytes, size, splats)
    else:
        finished = replace(finished, prefix_mse=None)
    return SearchResult(finished, hit.quality_db, float(size_of(finished)), trials)


@dataclass(frozen=True)
class _Trial:
    """Trial encode of a search: nominal quality, dB, and measured value; see `_Goal`."""

    quality_db: float
    value: float


@dataclass(frozen=True, eq=False)
class _Goal:
    """Goal of a search: the target value, and when to stop.

    Parameters
    ----------
    value : float
        Target value: PSNR, dB, or base-2 logarithm of the file size in bytes.
    rise : float
        Typical rise of the value per dB of nominal quality.
    start_db : float
        Nominal quality of the first trial, dB.
    is_enough : callable
        Tells whether a value is near enough to stop.
    is_better : callable
        Tells whether a trial is better than another.
    """

    value: float
    rise: float
    start_db: float
    is_enough: Callable[[float], bool]
    is_better: Callable[[_Trial, _Trial], bool]


def _psnr_goal(psnr_db: float, tolerance_db: float) -> _Goal:
    """Return the goal of a search for a PSNR."""

    def miss(value: float) -> float:
        """Return the distance from the target, dB."""
        return abs(value - psnr_db)

    return _Goal(
        value=psnr_db,
        rise=PSNR_PER_DB,
        start_db=psnr_db + _NOMINAL_DB,
        is_enough=lambda value: miss(value) <= tolerance_db,
        is_better=lambda trial, best: miss(trial.value) < miss(best.value),
    )


def _size_out_of_reach(size_bytes: int, least_bytes: int, splats: int) -> DataError:
    """Return the error of a size that no setting meets; it states how many splats would fit."""
    fitting = max(1, int(splats * (size_bytes / least_bytes) ** _SPLATS_PER_SIZE))
    return DataError(
        "target-out-of-reach",
        f"a size of {size_bytes:,} bytes for {splats:,} splats: the coarsest setting takes "
        f"{least_bytes:,} bytes, expected that or more; about {fitting:,} splats would fit at this "
        "setting, and fewer at a higher quality",
    )


def _search(
    encode_at: EncodeAt,
    goal: _Goal,
    measure: Callable[[EncodedScene], float],
    progress: Progress,
    most_trials: int = MAX_TRIALS,
    *,
    keep: bool = True,
) -> tuple[SearchResult, list[_Trial]]:
    """Try nominal qualities until a value is near enough; return the best encode and all trials.

    With `keep` the best scene stays in memory during further trials, about the memory of its
    source. Without, it is encoded again after the search, unless it was the last trial.
    """
    trials: list[_Trial] = []
    best: _Trial | None = None
    kept: EncodedScene | None = None
    quality = _clamp_quality(goal.start_db)
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
    return SearchResult(kept, best.quality_db, best.value, count), trials


def _next(trials: list[_Trial], goal: float, rise: float) -> float:
    """Return the next quality: between trials on both sides of the goal, else beyond the last.

    Values are not monotonic: a codebook may change its number of rows. Of all neighbours by quality
    with the goal between them, the closest pair is used. Where the last two trials were on the same
    side of the goal, as on a bent curve, interpolation alone is slow: the next quality is halfway
    from there to the middle of the pair.
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
        if len(trials) > 2 and (trials[-1].value < goal) == (trials[-2].value < goal):
            share = 0.5 * (share + 0.5)
        share = min(max(share, _MARGIN), 1 - _MARGIN)
        return lower.quality_db + share * (upper.quality_db - lower.quality_db)
    last = trials[-1]
    if len(trials) > 1:
        run = last.quality_db - trials[-2].quality_db
        # A flat curve must not give a huge step: assume at least a quarter of the typical rise.
        rise = max((last.value - trials[-2].value) / run, rise / 4)
    step = min(max((goal - last.value) / rise, -_LONGEST_DB), _LONGEST_DB)
    return _clamp_quality(last.quality_db + step)


def _clamp_quality(quality_db: float) -> float:
    """Clamp a nominal quality to the range of the profiles, dB."""
    return min(max(quality_db, MIN_QUALITY_DB), MAX_QUALITY_DB)
