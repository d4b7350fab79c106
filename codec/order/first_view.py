"""Orders for a known first view: what its camera sees moves to the front of another order."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def lead(
    rows: NDArray[np.int64], ahead: NDArray[np.int64], share: float, mix: float = 1.0
) -> NDArray[np.int64]:
    """Return an order with the first rows of another one mixed into its beginning.

    Parameters
    ----------
    rows : (N,) int64
        The order of all rows.
    ahead : (M,) int64
        The order of the first view: some of the rows, none twice.
    share : float
        Most rows that are taken from `ahead`, as a share of all rows, 0 to 1.
    mix : float
        Share of every prefix that is taken from `ahead`, until these rows are used up, 0 to 1.

    Returns
    -------
    (N,) int64
        Every prefix of n rows holds the first ``mix · n`` rows of `ahead`, up to `share`, and the
        first ``(1 - mix) · n`` of `rows`; a row that is among both counts for both. The other rows
        follow as they stand in `rows`.
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
    """Return an order of whose prefixes at least a share lies inside, such as inside a frustum.

    Parameters
    ----------
    rows : (N,) int64
        The order of all rows.
    inside : (N,) bool
        Of the scene's rows.
    share : float
        0 to 1. Where the order itself has a larger share inside, it stays as it is.

    Returns
    -------
    (N,) int64
        The rows inside and the rows outside each as they stand in `rows`. A row outside waits until
        the share is kept with it, or no row inside is left.
    """
    marks = inside[rows]
    within, without = rows[marks], rows[~marks]
    # Before the k-th row outside come at least k · share / (1 - share) rows inside, or as many as
    # stand before it in the order, if those are more.
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
        Of the scene's rows.

    Returns
    -------
    float
        0.5 to 1.
    """
    return 1.0 - 0.5 * float(np.count_nonzero(~inside)) / max(len(inside), 1)
