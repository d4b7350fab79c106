"""Orders for a known first view: the splats that its camera sees move to the front."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def bring_forward(
    rows: NDArray[np.int64], view_rows: NDArray[np.int64], share: float, mix: float = 1.0
) -> NDArray[np.int64]:
    """Interleave a scene's order with the order of its first view.

    Parameters
    ----------
    rows : (N,) int64
        Order of all rows.
    view_rows : (M,) int64
        Order of the first view: distinct rows, not necessarily all.
    share : float
        Rows taken from `view_rows` at most, as a share of all rows, 0 to 1.
    mix : float
        Share of every prefix that is taken from `view_rows` while they last, 0 to 1.

    Returns
    -------
    (N,) int64
        Order of all rows. A prefix of n rows holds the first ``mix · n`` of `view_rows` and the
        first ``(1 - mix) · n`` of `rows`; a row in both is placed once and counts for
        both. After the last row taken from `view_rows` the remaining rows follow in the order of
        `rows`.
    """
    first = view_rows[: math.ceil(share * len(rows))]
    rank = np.empty(len(rows), np.int64)
    rank[rows] = np.arange(1, len(rows) + 1)
    with np.errstate(divide="ignore"):
        place = rank * np.divide(1.0, 1.0 - mix)
        early = np.arange(1, len(first) + 1) * np.divide(1.0, mix)
    place[first] = np.minimum(place[first], early)
    return np.lexsort((rank, place)).astype(np.int64)


def keep_share(
    rows: NDArray[np.int64], inside: NDArray[np.bool_], share: float
) -> NDArray[np.int64]:
    """Reorder rows so that at least a given share of every prefix lies inside a frustum.

    Parameters
    ----------
    rows : (N,) int64
        Order of all rows.
    inside : (N,) bool
        Mask of the scene's rows inside the frustum.
    share : float
        Minimum share inside, 0 to 1. Prefixes of `rows` with a larger share stay unchanged.

    Returns
    -------
    (N,) int64
        Order that keeps the relative order of rows inside, and of rows outside. A row outside moves
        back until the share holds or no row inside is left.
    """
    marks = inside[rows]
    within, without = rows[marks], rows[~marks]
    # At least k · share / (1 - share) rows inside come before the k-th row outside. If more come
    # before it in `rows`, that number stays.
    numbers = np.arange(1, len(without) + 1)
    natural = np.cumsum(marks)[~marks]
    with np.errstate(divide="ignore"):
        needed = np.ceil(numbers * np.divide(share, 1.0 - share) - 1e-9)
    before = np.minimum(np.maximum(natural, needed), len(within)).astype(np.int64)
    out = np.empty(len(rows), np.int64)
    places = before + np.arange(len(without))
    is_outside = np.zeros(len(rows), np.bool_)
    is_outside[places] = True
    out[places] = without
    out[~is_outside] = within
    return out


def default_share(inside: NDArray[np.bool_]) -> float:
    """Return the default of `keep_share`'s `share`: half of the scene's share outside stays.

    If 60 % of the rows lie outside the frustum, at most 30 % of every prefix do.

    Parameters
    ----------
    inside : (N,) bool
        Mask of the scene's rows inside the frustum.

    Returns
    -------
    float
        Share, 0.5 to 1.
    """
    return 1.0 - 0.5 * float(np.count_nonzero(~inside)) / max(len(inside), 1)
