"""Coverage: how much of what is visible in a scene some views show, and views for the rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

F64 = NDArray[np.float64]

# A splat is visible where its weight in some view exceeds this.
_VISIBLE: Final = 0.1
# A splat is covered where its weight in a chosen view is at least this share of its largest weight
# in any: then its energy there is at least a sixteenth of what it can be.
_COVERED_SHARE: Final = 0.25
# Views are added until at least this share of the visible splats is covered.
_LEAST_COVERAGE: Final = 0.99


@dataclass(frozen=True, eq=False)
class SeenSplats:
    """What one view shows.

    Parameters
    ----------
    index : (n,) int32
        Rows of the splats that are seen.
    weights : (n,) float64
        Peak weight of each in a pixel of the view, 0 to 1; less for a view that counts less.
    """

    index: NDArray[np.int32]
    weights: F64


def additions(
    counts: F64, chosen: Sequence[SeenSplats], candidates: Sequence[SeenSplats], most: int
) -> tuple[list[int], float]:
    """Choose candidates until what any of them shows is covered.

    Each time the candidate is taken that covers most splats which are not covered yet.

    Parameters
    ----------
    counts : (M,) float64
        Splats that each row stands for.
    chosen : sequence of SeenSplats
        Views that are there already.
    candidates : sequence of SeenSplats
        All others that were drawn.
    most : int
        Views that may be added.

    Returns
    -------
    added : list of int
        Rows of `candidates`.
    coverage : float
        Share of the visible splats that are covered then, 0 to 1; 1 where none is visible.
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
    while uncovered.sum() > (1.0 - _LEAST_COVERAGE) * total and len(added) < most:
        gains = [float(uncovered[rows].sum()) for rows in covers]
        row = int(np.argmax(gains))
        if not gains[row] > 0.0:
            break
        added.append(row)
        uncovered[covers[row]] = 0.0
    return added, 1.0 - float(uncovered.sum()) / total if total > 0.0 else 1.0
