"""Which splats may be dropped: those seen often enough whose bytes buy less than others' do."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.scoring.contribution import Scores
from cogsplat.codec.splats import Splats

from .costs import shown_energy

WORTH: Final = 6.0
"""Energy over λ below which a splat is not worth its bytes.

The loss is about the energy times the squared difference to what is behind it, 0.1 to 0.2; a bit
elsewhere gains 2·ln 2·λ/12 (uniform quantisation), and a faint splat takes 30 to 50. Of 2, 5, 10,
15 and 30, 5 was best for two trained objects and 15 for a room; at 5 it is 0.4, 13 and 2.5 % fewer
bytes at equal PSNR.
"""

# σ(o) = 1/255 at this logit: below it no pixel is ever touched (3DGS, forward pass).
_INVISIBLE_LOGIT = -np.log(254.0)


@dataclass(frozen=True)
class PruneConfig:
    """The bound under which splats are dropped.

    Parameters
    ----------
    peak : float
        A splat goes when its weight T·α stays below this in every pixel of every scoring view,
        jittered views included; 0.06 means never more than 6 % of any pixel.
    views : int
        And only when its footprint lay in at least so many of those views. What no view covers is
        unknown, not worthless: it stays.
    worth : float
        And only when its energy (`costs.shown_energy`) is below so many times λ: then the picture
        loses less than the same bytes spent on finer steps elsewhere would gain.
    """

    peak: float = 0.06
    views: int = 4
    worth: float = WORTH

    def __post_init__(self) -> None:
        if not 0 <= self.peak < 1:
            raise ValueError(f"peak {self.peak}, expected 0 to 1")
        if self.views < 1:
            raise ValueError(f"views {self.views}, expected at least 1")
        if not self.worth > 0:
            raise ValueError(f"worth {self.worth}, expected above 0")


def kept_rows(
    splats: Splats, scores: Scores, config: PruneConfig | None, lagrangian: float = np.inf
) -> NDArray[np.bool_]:
    """Mark the splats that stay.

    Parameters
    ----------
    splats : Splats
    scores : Scores
    config : PruneConfig or None
        None keeps all.
    lagrangian : float
        λ that the rest is stored with (`allocation.lagrangian`). Infinite drops whatever peak and
        views allow, 0 nothing but what can never be seen.

    Returns
    -------
    (N,) bool
    """
    if config is None:
        return np.ones(len(splats), np.bool_)
    idle = (scores.peak < config.peak) & (scores.covered >= config.views)
    idle &= shown_energy(scores) < config.worth * lagrangian
    invisible = splats.opacities < _INVISIBLE_LOGIT
    kept: NDArray[np.bool_] = ~(idle | invisible)
    return kept
