"""Decode a scene between two levels of detail, by interpolating opacities (SPEC 8.11)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.splats import Splats

from .reader import CogsFile

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]

# Largest magnitude of a logit before its opacity is exactly 0 or 1 in float64.
_MAX_LOGIT = 700.0


def decode_between(
    file: CogsFile,
    level: float,
    *,
    sh_degree: int | None = None,
    refine: bool = True,
    extras: bool = True,
    threads: int = 0,
    progress: Progress = silent,
) -> Splats:
    """Decode a scene at a level of detail, or between two levels.

    Parameters
    ----------
    file : CogsFile
        Open file with levels.
    level : float
        Level, 0 the coarsest; 1.25 is a quarter of the way from level 1 to level 2.
    sh_degree, refine, extras, threads, progress
        As in `CogsFile.decode`.

    Returns
    -------
    Splats
        Splats of the chunks that either level draws.

    Raises
    ------
    CogsplatError
        The errors of `CogsFile.decode`.
    ValueError
        `level` is out of range.
    """
    levels = file.root.levels
    if not 0 <= level <= len(levels) - 1:
        raise ValueError(f"level {level}, {_expected(len(levels))}")
    below, above = math.floor(level), math.ceil(level)
    if below == above:
        return file.decode(
            level=below, sh_degree=sh_degree, refine=refine, extras=extras, threads=threads,
            progress=progress,
        )  # fmt: skip
    drawn = [set(file.drawn_chunks(levels[k].chunks)) for k in (below, above)]
    chunks = sorted(drawn[0] | drawn[1])
    upper = file.decode(
        chunks, level=above, sh_degree=sh_degree, refine=refine, extras=extras, threads=threads,
        progress=progress,
    )  # fmt: skip
    lower = file.decode(
        chunks, level=below, sh_degree=0, refine=refine, extras=False, threads=threads
    )
    counts = file.chunks.splats[chunks]
    inside = [np.repeat([chunk in own for chunk in chunks], counts) for own in drawn]
    logits = interpolate_logits(
        np.where(inside[0], lower.opacities, -np.inf).astype(np.float32),
        np.where(inside[1], upper.opacities, -np.inf).astype(np.float32),
        level - below,
    )
    return replace(upper, opacities=logits)


def _expected(levels: int) -> str:
    """Describe the valid level numbers of a file with `levels` levels, for a message."""
    return f"expected 0 to {levels - 1}" if levels else "expected none: the file has no levels"


def interpolate_logits(lower: F32, upper: F32, part: float) -> F32:
    """Interpolate linearly between two opacities given as logits.

    Parameters
    ----------
    lower, upper : (n,) float32
        Opacity logits of the two levels; -inf for a splat that the level does not draw.
    part : float
        Interpolation weight: 0 gives `lower`, 1 gives `upper`.

    Returns
    -------
    (n,) float32
        Logits of the interpolated opacities.

    Examples
    --------
    >>> import numpy as np
    >>> half = interpolate_logits(np.float32([0, 0]), np.float32([0, -np.inf]), 0.5)
    >>> (1 / (1 + np.exp(-half))).tolist()
    [0.5, 0.25]
    """
    opacity = (1 - part) * _opacity(lower) + part * _opacity(upper)
    with np.errstate(divide="ignore"):
        return (np.log(opacity) - np.log1p(-opacity)).astype(np.float32)


def _opacity(logits: F32) -> F64:
    """Return opacities, 0 to 1, of logits."""
    exact = np.clip(logits.astype(np.float64), -_MAX_LOGIT, _MAX_LOGIT)
    opacity: F64 = np.where(np.isneginf(logits), 0.0, 1 / (1 + np.exp(-exact)))
    return opacity
