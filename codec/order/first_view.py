"""Orders for a known first view: the splats that its camera sees move to the front."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def bring_forward(
    rows: NDArray[np.int64], ahead: NDArray[np.int64], share: float, mix: float = 1.0
) -> NDArray[np.int64]:
    """Return an order with the first rows of a view's order mixed into its beginning.

    Parameters
    ----------
    rows : (N,) int64
        Order of all rows.
    ahead : (M,) int64
        Order of the first view: distinct rows, not necessarily all.
    share : float
        Limit of the rows taken from `ahead`, as a share of all rows, 0 to 1.
    mix : float
        Share of every prefix taken from `ahead` until that limit, 0 to 1.

    Returns
    -------
    (N,) int64
        Order in which every prefix of n rows holds the first ``mix · n`` rows of `ahead`, up to the
        limit, and the first ``(1 - mix) · n`` of `rows`; a row in both counts for both. The
        remaining rows keep the order of `rows`.
    """
    first = ahead[: math.ceil(share * len(rows))]
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
    """Return an order in which every prefix has at least a share of its rows inside a frustum.

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
    """Return the default share of `keep_share`, which halves the rows outside in a mean prefix.

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
