"""Objects of a scene: one label per splat, and chunks of one object each (PRoGS, section 3.4)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import DataError
from cogsplat.codec.splats import Splats

from . import chunks as chunking

ATTRIBUTE: Final = "object"
"""Name of the extra attribute with labels: one integer per splat, 0 for splats of no object."""

_MOST_LABEL: Final = (1 << 32) - 1

# Of attributes and of labels that a message lists.
_MOST_NAMED: Final = 16

Budgets = Sequence[tuple[int | None, float]]
"""Label, or None for all objects that are not named, and a share of that object's splats."""


@dataclass(frozen=True, eq=False)
class Arrangement:
    """An order cut into chunks of one object each.

    Parameters
    ----------
    rows : (n,) int64
        Rows of the scene, first to last.
    slices : sequence of slice
        The chunks, consecutive runs of `rows`.
    objects : (chunks,) uint32
        Label of the object that each chunk holds.
    """

    rows: NDArray[np.int64]
    slices: Sequence[slice]
    objects: NDArray[np.uint32]


def labels_of(splats: Splats) -> NDArray[np.uint32]:
    """Return the labels of a scene, from its attribute ``object``.

    Returns
    -------
    (N,) uint32

    Raises
    ------
    DataError
        ``no-objects``: the scene has no such attribute. ``bad-objects``: the attribute is not one
        integer from 0 to 2³² - 1 per splat.
    """
    if ATTRIBUTE not in splats.extras:
        names = ", ".join(map(repr, sorted(splats.extras)[:_MOST_NAMED])) or "no extra attributes"
        raise DataError(
            "no-objects",
            f"the scene has {names}, expected labels of objects as the attribute {ATTRIBUTE!r}",
        )
    labels = splats.extras[ATTRIBUTE]
    labels = labels[:, 0] if labels.ndim == 2 and labels.shape[1] == 1 else labels
    if labels.ndim != 1:
        raise DataError(
            "bad-objects", f"{ATTRIBUTE!r} of shape {labels.shape}, expected one label per splat"
        )
    # Text formats and some programs store labels as floats; whole numbers are taken.
    if len(labels) and not (
        np.isfinite(labels).all()
        and (labels == np.floor(labels)).all()
        and labels.min() >= 0
        and labels.max() <= _MOST_LABEL
    ):
        raise DataError(
            "bad-objects",
            f"{ATTRIBUTE!r} from {labels.min()} to {labels.max()}, "
            f"expected whole numbers from 0 to {_MOST_LABEL}",
        )
    return labels.astype(np.uint32)


def with_labels(splats: Splats, labels: NDArray[np.integer]) -> Splats:
    """Return a scene with labels as its attribute ``object``, in the smallest type that holds them.

    Parameters
    ----------
    splats : Splats
    labels : (N,) integer
        0 to 2³² - 1.

    Returns
    -------
    Splats
        Shares its other arrays with `splats`.

    Examples
    --------
    >>> import numpy as np
    >>> from cogsplat.codec.order.objects import labels_of, with_labels
    >>> from cogsplat.codec.splats import empty
    >>> labels_of(with_labels(empty(0, 3), np.array([0, 2, 2]))).tolist()
    [0, 2, 2]
    """
    most = int(labels.max()) if len(labels) else 0
    narrow = labels.astype(np.min_scalar_type(most))
    return replace(splats, extras={**splats.extras, ATTRIBUTE: narrow})


def ranked(
    labels: NDArray[np.uint32], contribution: NDArray[np.float64]
) -> tuple[NDArray[np.uint32], NDArray[np.float64]]:
    """Return the labels of the objects by descending contribution, and these contributions.

    Parameters
    ----------
    labels : (N,) uint32
    contribution : (N,) float64
        Of the splats.

    Returns
    -------
    objects : (n,) uint32
        Each label once, ties by label.
    total : (n,) float64
        Sum of the contributions of each object's splats.
    """
    objects, member = np.unique(labels, return_inverse=True)
    total: NDArray[np.float64] = np.bincount(member, contribution, len(objects)).astype(np.float64)
    rank = np.argsort(-total, kind="stable")
    return objects[rank], total[rank]


def require(splats: Splats, budgets: Budgets = ()) -> None:
    """Refuse a scene that `arrange` would refuse, before its splats are scored.

    Parameters
    ----------
    splats : Splats
    budgets : sequence of (int, float)
        As `arrange` takes them.

    Raises
    ------
    DataError
        ``no-objects``, ``bad-objects`` as `labels_of`; ``object-missing`` as `arrange`.
    """
    _require_budgeted(labels_of(splats), budgets)


def _require_budgeted(labels: NDArray[np.uint32], budgets: Budgets) -> None:
    known = sorted(set(np.unique(labels).tolist()))
    absent = sorted(label for label, _ in budgets if label is not None and label not in known)
    if absent:
        raise DataError(
            "object-missing",
            f"a budget for object {absent[0]}, expected one of {known[:_MOST_NAMED]}",
        )


def arrange(
    rows: NDArray[np.int64],
    labels: NDArray[np.uint32],
    contribution: NDArray[np.float64],
    largest: int,
    budgets: Budgets = (),
) -> Arrangement:
    """Cut an order into chunks of one object each.

    Parameters
    ----------
    rows : (n,) int64
        The order over all objects; it is kept inside each object.
    labels : (N,) uint32
        Of the scene.
    contribution : (N,) float64
        Of the scene; ranks the objects.
    largest : int
        Most splats in a chunk.
    budgets : sequence of (int, float)
        Label, and the share of that object's splats that comes before all splats beyond budgets;
        None stands for all objects that are not named.

    Returns
    -------
    Arrangement
        First the splats within budgets, object by object in the order of `ranked`. Then the other
        chunks by the mean place of their splats in `rows`, so that the rest of the scene sharpens
        as without budgets.

    Raises
    ------
    DataError
        ``object-missing``: a budget for an object that the scene does not have.
    """
    _require_budgeted(labels, budgets)
    shares = dict(budgets)
    others = shares.pop(None, 0.0)
    places = np.arange(len(rows))
    of_rows = labels[rows]
    first: list[NDArray[np.int64]] = []
    rest: list[tuple[float, int, NDArray[np.int64]]] = []
    for rank, label in enumerate(ranked(of_rows, contribution[rows])[0].tolist()):
        own = places[of_rows == label]
        count = math.ceil(shares.get(label, others) * len(own))
        first += [own[run] for run in chunking.plan_chunks(count, largest)]
        own = own[count:]
        runs = [own[run] for run in chunking.plan_chunks(len(own), largest)]
        rest += [(float(run.mean()), rank, run) for run in runs]
    rest.sort(key=lambda entry: entry[:2])
    chunks = first + [run for _, _, run in rest]
    stops = np.cumsum([len(run) for run in chunks]).tolist()
    slices = [slice(stop - len(run), stop) for run, stop in zip(chunks, stops, strict=True)]
    order = np.concatenate(chunks) if chunks else places
    held = np.array([of_rows[run[0]] for run in chunks], np.uint32)
    return Arrangement(rows[order], slices, held)
