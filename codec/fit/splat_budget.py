"""Splat budget: how many splats to keep for a target size or a target PSNR."""

from __future__ import annotations

from typing import Final

# Bytes per stored splat where splat count and precision are balanced and this share of the splats
# is kept, by SH degree. Measured at degree 3: 129 kB showed a captured scene of 80,796 splats
# better with 11,715 splats than with 14,543. Lower degrees follow from the cost of SH coefficients.
_BYTES_PER_SPLAT: Final = (6.5, 8.0, 9.5, 11.0)
_KEPT_SHARE: Final = 0.145
# Exponent of bytes per splat over file size: a larger budget also stores each splat finer. In
# 307 kB the same scene was better with 23,300 splats than with 27,727 or 20,000.
_PRECISION_EXPONENT: Final = 0.2
# PSNR that storing the trained splats costs, dB: training must exceed the target by this.
_STORING_LOSS_DB: Final = 2.0
# PSNR that training after the last round gains, with falling learning rates, dB.
_RECOVERY_GAIN_DB: Final = 1.8
# Within this distance of the end, dB, a round removes half as many splats.
_SMALL_ROUND_DB: Final = 3.0
# PSNR lost when the number of splats is halved and they are trained again, dB. A captured scene had
# 39.7 dB with 25 % of its splats and 37.8 dB with 18 %.
_LOSS_PER_HALVING_DB: Final = 4.0
# Accepted range of PSNR after training, less the storing loss, relative to the target, dB. Outside
# it, another number of splats takes fewer bytes. Measured in four scenes at 34 to 40 dB: more
# splats save 10 % at most, or cost 5 %, where it is -1.2 to -0.7. At -1.3, -1.8 and -1.9 the target
# is missed nearly before storing: splats take up to 28 bytes each, and more splats save 17 to
# 47 %.
_TOO_MANY_DB: Final = 0.6
_TOO_FEW_DB: Final = -1.2


def count_for_size(size_bytes: int, sh_degree: int, source_count: int) -> int:
    """Return the number of splats that shows a scene best in a file of a given size.

    Parameters
    ----------
    size_bytes : int
        Target size of the file.
    sh_degree : int
        SH degree of the scene, 0 to 3.
    source_count : int
        Number of splats of the source, the upper limit.
    """
    count = size_bytes / _BYTES_PER_SPLAT[sh_degree]
    count *= min((_KEPT_SHARE * source_count / count) ** _PRECISION_EXPONENT, 1.0) if count else 1.0
    return max(1, min(source_count, int(count)))


def next_count(count: int, final_count: int, round_keep: float) -> int | None:
    """Return the number of splats after the next pruning round; None if no round is left.

    Parameters
    ----------
    count : int
        Current number of splats.
    final_count : int
        Number of splats after the last round.
    round_keep : float
        Share of the splats that one round keeps.
    """
    return max(final_count, int(round_keep * count)) if final_count < count else None


def next_count_for_psnr(
    count: int, measured_db: float, target_db: float, round_keep: float
) -> int | None:
    """Return the number of splats after the next round; None if the PSNR allows no more rounds.

    Parameters
    ----------
    count : int
        Current number of splats.
    measured_db : float
        PSNR after the last round.
    target_db : float
        Target PSNR of the stored scene.
    round_keep : float
        Share of the splats that one round keeps.
    """
    surplus_db = measured_db + _RECOVERY_GAIN_DB - _STORING_LOSS_DB - target_db
    if surplus_db <= 0 or count == 1:
        return None
    return int((round_keep if surplus_db > _SMALL_ROUND_DB else (1 + round_keep) / 2) * count)


def corrected_count(count: int, measured_db: float, target_db: float, max_count: int) -> int | None:
    """Return a better number of splats for a target PSNR; None to keep the current number.

    The measured PSNR, less a typical storage loss (`_STORING_LOSS_DB`), is compared to the target.

    Parameters
    ----------
    count : int
        Current number of splats.
    measured_db : float
        PSNR of the trained splats before storing.
    target_db : float
        Target PSNR of the stored scene.
    max_count : int
        Upper limit of the result: the largest count of the current scene and its checkpoints.
    """
    surplus_db = measured_db - _STORING_LOSS_DB - target_db
    if _TOO_FEW_DB <= surplus_db <= _TOO_MANY_DB:
        return None
    better = max(1, min(max_count, round(count * 2.0 ** (-surplus_db / _LOSS_PER_HALVING_DB))))
    return better if better != count else None
