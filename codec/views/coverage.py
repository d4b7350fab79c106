"""Coverage: the share of a scene's visible splats that views show, and views that raise it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

# A splat is visible if its weight in some view exceeds this.
_VISIBLE: Final = 0.1
# A splat is covered if its weight in a chosen view is at least this share of its largest weight in
# any view: then its energy there is at least a sixteenth of its largest energy.
_COVERED_SHARE: Final = 0.25
# Views are added until at least this share of the visible splats is covered.
_MIN_COVERAGE: Final = 0.99


@dataclass(frozen=True, eq=False)
class SeenSplats:
    """Splats seen in one view, with their weights.

    Parameters
    ----------
    index : (n,) int32
        Rows of the splats that are seen.
    weights : (n,) float64
        Peak weight of each splat in a pixel, 0 to 1, times the weight of the view.
    """

    index: NDArray[np.int32]
    weights: F64


def choose_covering(
    counts: F64, chosen: Sequence[SeenSplats], candidates: Sequence[SeenSplats], max_views: int
) -> tuple[list[int], float]:
    """Choose candidates greedily until 99 % of the visible splats are covered.

    Each step adds the candidate that covers most of the uncovered splats.

    Parameters
    ----------
    counts : (M,) float64
        Number of the scene's splats that each row stands for.
    chosen : sequence of SeenSplats
        Views chosen before.
    candidates : sequence of SeenSplats
        Views to choose from.
    max_views : int
        Number of added views at most.

    Returns
    -------
    added : list of int
        Rows of `candidates`.
    coverage : float
        Covered share of the visible splats, 0 to 1; 1 if none is visible.
    """
    best, shown = np.zeros(len(counts)), np.zeros(len(counts))
    for view in chosen:
        shown[view.index] = np.maximum(shown[view.index], view.weights)
    np.copyto(best, shown)
    for view in candidates:
        best[view.index] = np.maximum(best[view.index], view.weights)
    visible = best > _VISIBLE
    enough = _COVERED_SHARE * best
    uncovered = np.where(visible & (shown < enough), counts, 0.0)
    covers = [view.index[view.weights >= enough[view.index]] for view in candidates]
    total = float(counts[visible].sum())
    added: list[int] = []
    while uncovered.sum() > (1.0 - _MIN_COVERAGE) * total and len(added) < max_views:
        gains = [float(uncovered[rows].sum()) for rows in covers]
        row = int(np.argmax(gains))
        if not gains[row] > 0.0:
            break
        added.append(row)
        uncovered[covers[row]] = 0.0
    return added, 1.0 - float(uncovered.sum()) / total if total > 0.0 else 1.0
