"""Pruning: drop splats that many views cover and that add less to the picture than they cost."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.finite_fields import require_finite
from cogsplat.codec.splats import Splats

from .costs import robust_energy

if TYPE_CHECKING:
    from cogsplat.codec.scoring.contribution import Scores

WORTH: Final = 6.0
"""Energy over λ below which a splat is not worth its bytes.

Dropping a splat costs about its energy times the squared difference to the background, 0.1 to 0.2.
Spent elsewhere, a bit removes an error of 2·ln 2·λ/12 (uniform quantisation); a faint splat takes
30 to 50 bits. Of 2, 5, 10, 15 and 30, 5 was best for two trained objects and 15 for a room. At 5
the three scenes take 0.4, 13 and 2.5 % fewer bytes at equal PSNR.
"""

PEAK: Final = 0.06
"""Usual value of `PruneConfig.peak`: a dropped splat makes up less than 6 % of any pixel."""

SPARSE_PEAK: Final = 0.02
"""Value of `PruneConfig.peak` where the given cameras show too little in common (`Scores.sparse`).

There, further views show splats that the scored views hide. At 0.02 a house of six rooms has 0.1 dB
more at equal bytes, and its worst held-out view 3.1 dB; a city, 0.3 and 1.3 dB. A captured room
would have up to 0.8 dB less, a terrace 0.6 (docs/ablations.md, "Scoring large scenes").
"""

# σ(o) = 1/255 at this logit: below it no pixel is ever touched (3DGS, forward pass).
_INVISIBLE_LOGIT = -np.log(254.0)


@dataclass(frozen=True)
class PruneConfig:
    """Conditions for dropping a splat, which must all hold.

    Parameters
    ----------
    peak : float or None
        Limit of the splat's largest weight T·α over all pixels of all scoring views, jittered
        views included. None for `PEAK`, or `SPARSE_PEAK` where `Scores.sparse` is set.
    views : int
        Minimum number of scoring views in which the footprint lies. A splat that fewer views cover
        is kept, because its contribution is unknown.
    worth : float
        Limit of the splat's energy (`costs.robust_energy`) divided by λ. Below it, finer steps of
        other splats gain more per byte than the splat does.
    """

    peak: float | None = None
    views: int = 4
    worth: float = WORTH

    def __post_init__(self) -> None:
        require_finite(self)
        if self.peak is not None and not 0 <= self.peak < 1:
            raise ValueError(f"peak {self.peak}, expected 0 to 1")
        if self.views < 1:
            raise ValueError(f"views {self.views}, expected at least 1")
        if not self.worth > 0:
            raise ValueError(f"worth {self.worth}, expected above 0")


def keep_mask(
    splats: Splats, scores: Scores, config: PruneConfig | None, lagrangian: float = np.inf
) -> NDArray[np.bool_]:
    """Return a mask of the splats that pruning keeps.

    Parameters
    ----------
    splats : Splats
        Splats of the scene.
    scores : Scores
        Scores of these splats.
    config : PruneConfig or None
        Conditions for dropping; None keeps all splats.
    lagrangian : float
        λ at which the kept splats are stored (`allocation.lagrangian`). Infinity ignores
        `config.worth`; 0 drops only splats that are too transparent to be drawn.

    Returns
    -------
    (N,) bool
    """
    if config is None:
        return np.ones(len(splats), np.bool_)
    usual = SPARSE_PEAK if scores.sparse else PEAK
    limit = usual if config.peak is None else config.peak
    idle = (scores.peak < limit) & (scores.covered >= config.views)
    idle &= robust_energy(scores) < config.worth * lagrangian
    invisible = splats.opacities < _INVISIBLE_LOGIT
    kept: NDArray[np.bool_] = ~(idle | invisible)
    return kept
