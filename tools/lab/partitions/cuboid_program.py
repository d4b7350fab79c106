"""Cheapest partition of a grid into boxes, by an integer program with pruned candidates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from .box_costs import Box, BoxCosts, box_sums
from .guillotine import cut_costs

F64 = NDArray[np.float64]

# Tolerance for the rounding of the solver, relative to the cost.
_TOLERANCE: Final = 1e-9


@dataclass(frozen=True)
class Solution:
    """Partition of a grid into boxes, with its cost and a lower bound.

    Parameters
    ----------
    boxes : list of Box
        Disjoint boxes that cover the grid, sorted.
    cost : float
        Cost of the partition (`BoxCosts.total`).
    bound : float
        Lower bound of the cost of any partition.
    candidates : int
        Number of boxes that are cheaper whole than cut.
    kept : int
        Number of candidates given to the integer program.
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
        Time limit of the integer program. When it is reached, the best partition so far is
        returned, with a `bound` below its cost.

    Returns
    -------
    Solution
        Among partitions of equal cost, the choice depends on the solver's version. If the time
        limit is reached, the result depends on the speed of the machine.

    Notes
    -----
    SGSS gives all boxes to the solver. Here most are pruned first, which keeps the optimum. A box
    is dropped if guillotine cuts of it cost no more. The linear relaxation gives a lower bound; if
    the guillotine partition reaches it, that is the result. Otherwise boxes whose reduced cost
    exceeds the gap cannot be in a better partition and are dropped.
    """
    cuts = cut_costs(costs)
    boxes = cuts.partition()
    known = costs.total(boxes)
    slack = _TOLERANCE * max(known, 1.0)
    candidates = costs.cost < cuts.cut - slack
    prices, bound = _dual_prices(costs, candidates)
    kept = np.flatnonzero(candidates & (_reduced_costs(costs, prices) <= known - bound + slack))
    solution = Solution(sorted(boxes), known, bound, int(candidates.sum()), len(kept))
    if known - bound <= slack or not len(kept):
        return solution
    chosen, lower = _solve_program(costs, kept, seconds)
    if chosen is None or costs.total(chosen) >= known - slack:
        lower = min(lower, known)
        return Solution(solution.boxes, known, max(bound, lower), solution.candidates, len(kept))
    cost = costs.total(chosen)
    bound = max(bound, min(lower, cost))
    return Solution(sorted(chosen), cost, bound, solution.candidates, len(kept))


def _reduced_costs(costs: BoxCosts, prices: F64) -> F64:
    """Return the reduced cost of each box: its cost minus the dual prices of its cuboids."""
    return costs.cost - box_sums(prices, costs.spans)


def _dual_prices(costs: BoxCosts, candidates: NDArray[np.bool_]) -> tuple[F64, float]:
    """Solve the linear relaxation; return the dual price of each cuboid and the lower bound."""
    from scipy.optimize import linprog

    shape = tuple(span.length for span in costs.spans)
    columns = np.flatnonzero(candidates)
    found = linprog(
        costs.cost.ravel()[columns],
        A_eq=_incidence(costs, columns),
        b_eq=np.ones(int(np.prod(shape))),
        method="highs",
    )
    prices = np.asarray(found.eqlin.marginals, np.float64).reshape(shape)
    # If all reduced costs are at least 0, the sum of the prices is a lower bound. The most negative
    # one, due to rounding of the solver, is subtracted from every price.
    worst = min(float(_reduced_costs(costs, prices).ravel()[columns].min()), 0.0)
    return prices + worst, float(prices.sum()) + worst * prices.size


def _incidence(costs: BoxCosts, columns: NDArray[np.int64]) -> object:
    """Return the sparse matrix of cuboids (rows) covered by boxes (columns)."""
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


def _solve_program(
    costs: BoxCosts, kept: NDArray[np.int64], seconds: float
) -> tuple[list[Box] | None, float]:
    """Solve the integer program; return the boxes, None if none were found, and the bound."""
    from scipy.optimize import Bounds, LinearConstraint, milp

    found = milp(
        costs.cost.ravel()[kept],
        integrality=np.ones(len(kept)),
        bounds=Bounds(0.0, 1.0),
        constraints=LinearConstraint(_incidence(costs, kept), 1.0, 1.0),
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
