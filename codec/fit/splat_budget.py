"""Shares: how many splats a scene needs for a size or for a quality."""

from __future__ import annotations

from typing import Final

# What a stored splat takes where splats and bytes are in balance and this share of the splats is
# kept, by SH degree: a captured scene of degree 3, 80,796 splats, in 129 kB was shown better by
# 11,715 splats than by 14,543. The others are in proportion to what SH coefficients take.
_BYTES_PER_SPLAT: Final = (6.5, 8.0, 9.5, 11.0)
_SHARE: Final = 0.145
# Where more may be kept, each is stored finer: in 307 kB the same scene was shown better by 23,300
# splats than by 27,727 and by 20,000. Bytes of a splat grow with those of the file to this power.
_FINER: Final = 0.2
# By how much pictures of trained splats are to be better than the target: what is lost when they
# are stored in so many bytes.
_STORING_LOSS_DB: Final = 2.0
# What training after the last round brings, with the learning rates falling.
_RECOVERY_DB: Final = 1.8
# Nearer to the end of the rounds than this, dB, they leave out half as many.
_NEAR_DB: Final = 1.5
# What half of the splats cost after training: a captured scene had 39.7 dB with 25 % of its splats
# and 37.8 with 18 %.
_DB_PER_HALVING: Final = 4.0
# Splats that are so much better after training than the target asks for, dB, are too many. Those
# that are so much worse are too few: they miss the target even before they are stored. In between,
# training through the quantisers brings something back, and fewer splats stored finer are better
# than more stored coarser.
_TOO_MANY_DB: Final = 0.6
_TOO_FEW_DB: Final = -2.5


def count_for_size(size_bytes: int, sh_degree: int, most: int) -> int:
    """Return how many splats show a scene best in a file of a size, at most `most`."""
    count = size_bytes / _BYTES_PER_SPLAT[sh_degree]
    count *= min((_SHARE * most / count) ** _FINER, 1.0) if count else 1.0
    return max(1, min(most, int(count)))


def count_after_round(count: int, least: int, round_keep: float) -> int | None:
    """Return how many splats the next round keeps on the way to `least`; None where that is met."""
    return max(least, int(round_keep * count)) if least < count else None


def count_after_round_for_psnr(
    count: int, measured_db: float, target_db: float, round_keep: float
) -> int | None:
    """Return how many splats the next round keeps; None where the target allows no more rounds.

    Parameters
    ----------
    count : int
        Splats that are left.
    measured_db : float
        PSNR after the last round.
    target_db : float
        That the stored scene is to have.
    round_keep : float
        Share that a round keeps.
    """
    beyond = measured_db + _RECOVERY_DB - _STORING_LOSS_DB - target_db
    if beyond <= 0 or count == 1:
        return None
    return int((round_keep if beyond > _NEAR_DB else (1 + round_keep) / 2) * count)


def corrected_count(count: int, measured_db: float, target_db: float, most: int) -> int | None:
    """Return how many splats a target asks for once some are trained; None where these may stay.

    Parameters
    ----------
    count : int
        Splats that were trained.
    measured_db : float
        PSNR of them after training.
    target_db : float
        That the stored scene is to have.
    most : int
        Splats that there are.
    """
    beyond = measured_db - _STORING_LOSS_DB - target_db
    if _TOO_FEW_DB <= beyond <= _TOO_MANY_DB:
        return None
    asked = max(1, min(most, round(count * 2.0 ** (-beyond / _DB_PER_HALVING))))
    return asked if asked != count else None
