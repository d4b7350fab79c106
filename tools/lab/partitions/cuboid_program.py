"""The cheapest partition of all: an integer program over boxes, with most of them ruled out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from .box_costs import Box, BoxCosts, box_sums
from .guillotine import cut_costs

F64 = NDArray[np.float64]

# What a reduced cost may miss 0 by, as the solver rounds.
_ROUNDING: Final = 1e-9


@dataclass(frozen=True)
class Solution:
    """A partition of the grid into boxes.

    Parameters
    ----------
    boxes : list of Box
        Each basic cuboid lies in one of them; sorted.
    cost : float
    bound : float
        No partition costs less.
    candidates : int
        Boxes that no cheaper way to cut them rules out.
    kept : int
        Those of them that the integer program chose from.
    """

    boxes: list[Box]
    cost: float
    bound: float
    candidates: int
    kept: int


def cheapest_partition(costs: BoxCosts, seconds: float = 60.0) -> Solution:
    """Find the cheapest partition of a grid into boxes (SGSS, Zhu et al., MMSys 2025).

    Parameters
    ----------
    costs : BoxCosts
    seconds : float
        Most time for the integer program. When it runs out, the best partition so far is returned
        with a `bound` below its cost.

    Returns
    -------
    Solution
        The boxes depend on the solver's version where several partitions cost the same, and on the
        machine's speed where the time runs out.

    Notes
    -----
    SGSS gives all boxes to the solver. Here most are ruled out first, which changes no optimum.
    A box that straight cuts make cheaper, or no dearer, is not needed. The linear program without
    integrality bounds every partition from below; where straight cuts reach the bound, they are the
    answer. Else a box whose reduced cost is larger than the gap is in no better partition.
    """
    cuts = cut_costs(costs)
    boxes = cuts.partition()
    known = costs.total(boxes)
    slack = _ROUNDING * max(known, 1.0)
    candidates = costs.cost < cuts.cut - slack
    prices, bound = _prices(costs, candidates)
    kept = np.flatnonzero(candidates & (_reduced(costs, prices) <= known - bound + slack))
    solution = Solution(sorted(boxes), known, bound, int(candidates.sum()), len(kept))
    if known - bound <= slack or not len(kept):
        return solution
    chosen, lower = _program(costs, kept, seconds)
    if chosen is None or costs.total(chosen) >= known - slack:
        lower = min(lower, known)
        return Solution(solution.boxes, known, max(bound, lower), solution.candidates, len(kept))
    cost = costs.total(chosen)
    bound = max(bound, min(lower, cost))
    return Solution(sorted(chosen), cost, bound, solution.candidates, len(kept))


def _reduced(costs: BoxCosts, prices: F64) -> F64:
    """Return what each box costs above the prices of its cuboids."""
    return costs.cost - box_sums(prices, costs.spans)


def _prices(costs: BoxCosts, candidates: NDArray[np.bool_]) -> tuple[F64, float]:
    """Return a price of each cuboid and a bound: no partition into candidates costs less."""
    from scipy.optimize import linprog

    shape = tuple(span.length for span in costs.spans)
    columns = np.flatnonzero(candidates)
    found = linprog(
        costs.cost.ravel()[columns],
        A_eq=_members(costs, columns),
        b_eq=np.ones(int(np.prod(shape))),
        method="highs",
    )
    prices = np.asarray(found.eqlin.marginals, np.float64).reshape(shape)
    # With all reduced costs at least 0, the sum of prices is below every partition. Lowering the
    # price of each cuboid by the worst of them makes up for what the solver rounds.
    worst = min(float(_reduced(costs, prices).ravel()[columns].min()), 0.0)
    return prices + worst, float(prices.sum()) + worst * prices.size


def _members(costs: BoxCosts, columns: NDArray[np.int64]) -> object:
    """Return which cuboids (rows) each box (column) covers, as a sparse matrix."""
    from scipy.sparse import csc_array

    spans = costs.spans
    place = np.unravel_index(columns, costs.cost.shape)
    ends = [(span.ends()[0][at], span.ends()[1][at]) for span, at in zip(spans, place, strict=True)]
    rows, starts = [], [0]
    shape = tuple(span.length for span in spans)
    number = np.arange(int(np.prod(shape))).reshape(shape)
    for column in range(len(columns)):
        part = tuple(slice(int(low[column]), int(high[column])) for low, high in ends)
        inside = number[part].ravel()
        rows.append(inside)
        starts.append(starts[-1] + len(inside))
    return csc_array(
        (np.ones(starts[-1]), np.concatenate(rows), np.array(starts)),
        shape=(number.size, len(columns)),
    )


def _program(
    costs: BoxCosts, kept: NDArray[np.int64], seconds: float
) -> tuple[list[Box] | None, float]:
    """Return the cheapest partition into kept boxes that was found, and the solver's bound."""
    from scipy.optimize import Bounds, LinearConstraint, milp

    found = milp(
        costs.cost.ravel()[kept],
        integrality=np.ones(len(kept)),
        bounds=Bounds(0.0, 1.0),
        constraints=LinearConstraint(_members(costs, kept), 1.0, 1.0),
        options={"time_limit": seconds, "mip_rel_gap": 0.0},
    )
    lower = -np.inf if found.mip_dual_bound is None else float(found.mip_dual_bound)
    if found.x is None:
        return None, lower
    chosen = kept[np.flatnonzero(found.x > 0.5)]
    place = np.unravel_index(chosen, costs.cost.shape)
    starts, ends = zip(
        *(
            (span.ends()[0][at].tolist(), span.ends()[1][at].tolist())
            for span, at in zip(costs.spans, place, strict=True)
        ),
        strict=True,
    )
    boxes: list[Box] = [
        (starts[0][n], starts[1][n], starts[2][n], ends[0][n], ends[1][n], ends[2][n])
        for n in range(len(chosen))
    ]
    return boxes, lower
