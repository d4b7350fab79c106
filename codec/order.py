"""Orders: which splats come first."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from .score import Scores
from .splats import Splats

ORDERS: Final = ("contribution", "source")


def order_rows(name: str, splats: Splats, scores: Scores) -> NDArray[np.int64]:
    """Return the permutation of an order: rows of the scene, first to last.

    Parameters
    ----------
    name : str
        ``contribution``: descending contribution, ties in file order (PRoGS, section 3.1);
        ``source``: as in the file.
    splats : Splats
    scores : Scores

    Returns
    -------
    (N,) int64

    Raises
    ------
    ValueError
        An unknown name.
    """
    if name == "source":
        return np.arange(len(splats), dtype=np.int64)
    if name == "contribution":
        return np.argsort(-scores.contribution, kind="stable").astype(np.int64)
    raise ValueError(f"order {name!r}, expected one of {ORDERS}")
