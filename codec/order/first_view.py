"""Orders that serve one known pose first: what an order becomes for who starts there."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def lead(
    rows: NDArray[np.int64], ahead: NDArray[np.int64], share: float, mix: float = 1.0
) -> NDArray[np.int64]:
    """Return an order with the first of another before it, or mixed into its beginning.

    Parameters
    ----------
    rows : (N,) int64
        The order of all rows.
    ahead : (M,) int64
        The order by one view: some of the rows, none twice.
    share : float
        Of all rows, how many of `ahead` come early at most, 0 to 1.
    mix : float
        Of any beginning, how much is of those, as long as they last, 0 to 1.

    Returns
    -------
    (N,) int64
        The first `mix` of any beginning are of `ahead`, the rest of `rows`, where a row that is
        among both counts for both; when `share` is reached, the others as they stand in `rows`.
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
    """Return an order of which every prefix lies inside to at least a share, as long as that lasts.

    Parameters
    ----------
    rows : (N,) int64
        The order of all rows.
    inside : (N,) bool
        By row.
    share : float
        0 to 1. Where the order has more inside of its own accord, it stays as it is.

    Returns
    -------
    (N,) int64
        Those inside and those outside each as they stand in `rows`; who is outside waits until the
        share allows it, or nobody is left inside.
    """
    marks = inside[rows]
    within, without = rows[marks], rows[~marks]
    # Before the outsider of number k come at least k·share/(1 - share) insiders, or those that
    # stand before it in the order.
    numbers = np.arange(1, len(without) + 1)
    natural = np.cumsum(marks)[~marks]
    with np.errstate(divide="ignore"):
        needed = np.ceil(numbers * np.divide(share, 1.0 - share) - 1e-9)
    before = np.minimum(np.maximum(natural, needed), len(within)).astype(np.int64)
    out = np.empty(len(rows), np.int64)
    places = before + np.arange(len(without))
    taken = np.zeros(len(rows), np.bool_)
    taken[places] = True
    out[places] = without
    out[~taken] = within
    return out


def halved_outside(inside: NDArray[np.bool_]) -> float:
    """Return the share for `keep_share` that halves what lies outside of the average prefix.

    Parameters
    ----------
    inside : (N,) bool
    """
    return 1.0 - 0.5 * float(np.count_nonzero(~inside)) / max(len(inside), 1)
