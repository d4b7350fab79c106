"""Which splats may be dropped: only those that were seen often enough and never mattered."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .score import Scores
from .splats import Splats

# σ(o) = 1/255 at this logit: below it no pixel is ever touched (3DGS, forward pass).
_INVISIBLE_LOGIT = -np.log(254.0)


@dataclass(frozen=True)
class PruneConfig:
    """The bound under which splats are dropped.

    Parameters
    ----------
    peak : float
        A splat goes when its weight T·α stays below this in every pixel of every scoring view,
        jittered views included; 0.02 means never more than 2 % of any pixel.
    views : int
        And only when its footprint lay in at least so many of those views. What no view covers is
        unknown, not worthless: it stays.
    """

    peak: float = 0.02
    views: int = 4

    def __post_init__(self) -> None:
        if not 0 <= self.peak < 1:
            raise ValueError(f"peak {self.peak}, expected 0 to 1")
        if self.views < 1:
            raise ValueError(f"views {self.views}, expected at least 1")


def kept_rows(splats: Splats, scores: Scores, config: PruneConfig | None) -> NDArray[np.bool_]:
    """Mark the splats that stay.

    Parameters
    ----------
    splats : Splats
    scores : Scores
    config : PruneConfig or None
        None keeps all.

    Returns
    -------
    (N,) bool
    """
    if config is None:
        return np.ones(len(splats), np.bool_)
    idle = (scores.peak < config.peak) & (scores.covered >= config.views)
    invisible = splats.opacities < _INVISIBLE_LOGIT
    kept: NDArray[np.bool_] = ~(idle | invisible)
    return kept
