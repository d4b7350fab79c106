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

from .chunk_plan import plan_chunks

ATTRIBUTE: Final = "object"
"""Name of the extra attribute with labels: one integer per splat, 0 for splats of no object."""

_MAX_LABEL: Final = (1 << 32) - 1

# Attributes or labels at most that an error message lists.
_MAX_LISTED: Final = 16

Budgets = Sequence[tuple[int | None, float]]
"""Pairs of label and share of the object's splats; label None stands for all other objects."""


@dataclass(frozen=True, eq=False)
class ChunkedOrder:
    """Order of a scene cut into chunks, with an object label per chunk.

    Parameters
    ----------
    rows : (n,) int64
        Rows of the scene, first to last.
    slices : sequence of slice
        Consecutive ranges of `rows`, one per chunk.
    objects : (chunks,) uint32
        Label of each chunk's object; 0 if chunks are not cut by object.
    """

    rows: NDArray[np.int64]
    slices: Sequence[slice]
    objects: NDArray[np.uint32]


def labels_of(splats: Splats) -> NDArray[np.uint32]:
    """Return the object labels of a scene, from its attribute ``object``.

    Returns
    -------
    (N,) uint32

    Raises
    ------
    DataError
        ``no-objects``: the attribute is missing. ``bad-objects``: the attribute is not one integer
        from 0 to 2³² - 1 per splat.
    """
    if ATTRIBUTE not in splats.extras:
        names = ", ".join(map(repr, sorted(splats.extras)[:_MAX_LISTED])) or "no extra attributes"
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
    # Text formats and some programs store labels as floats; whole numbers are accepted.
    if len(labels) and not (
        np.isfinite(labels).all()
        and (labels == np.floor(labels)).all()
        and labels.min() >= 0
        and labels.max() <= _MAX_LABEL
    ):
        raise DataError(
            "bad-objects",
            f"{ATTRIBUTE!r} from {labels.min()} to {labels.max()}, "
            f"expected whole numbers from 0 to {_MAX_LABEL}",
        )
    return labels.astype(np.uint32)


def with_labels(splats: Splats, labels: NDArray[np.integer]) -> Splats:
    """Return splats with object labels as their attribute ``object``, in the smallest fitting type.

    Parameters
    ----------
    splats : Splats
        Splats to label.
    labels : (N,) integer
        Labels from 0 to 2³² - 1.

    Returns
    -------
    Splats
        Splats that share all other arrays with `splats`.

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


def rank_objects(
    labels: NDArray[np.uint32], contribution: NDArray[np.float64]
) -> tuple[NDArray[np.uint32], NDArray[np.float64]]:
    """Return the objects by descending contribution, with the contribution of each.

    Parameters
    ----------
    labels : (N,) uint32
        Object label of each splat.
    contribution : (N,) float64
        Contribution of each splat.

    Returns
    -------
    objects : (n,) uint32
        Distinct labels; ties by label.
    total : (n,) float64
        Sum of the contributions of each object's splats.
    """
    objects, member = np.unique(labels, return_inverse=True)
    total: NDArray[np.float64] = np.bincount(member, contribution, len(objects)).astype(np.float64)
    rank = np.argsort(-total, kind="stable")
    return objects[rank], total[rank]


def require_objects(splats: Splats, budgets: Budgets = ()) -> None:
    """Check a scene's object labels and budgets, so that errors come before the scoring.

    Parameters
    ----------
    splats : Splats
        Scene with the attribute ``object``.
    budgets : sequence of (int, float)
        Budgets for `chunk_by_object`.

    Raises
    ------
    DataError
        ``no-objects`` or ``bad-objects`` (see `labels_of`); ``object-missing`` (see
        `chunk_by_object`).
    """
    _require_budgeted(labels_of(splats), budgets)


def _require_budgeted(labels: NDArray[np.uint32], budgets: Budgets) -> None:
    """Raise ``object-missing`` if a budget names an object that the scene lacks."""
    known = sorted(set(np.unique(labels).tolist()))
    absent = sorted(label for label, _ in budgets if label is not None and label not in known)
    if absent:
        raise DataError(
            "object-missing",
            f"a budget for object {absent[0]}, expected one of {known[:_MAX_LISTED]}",
        )


def chunk_by_object(
    rows: NDArray[np.int64],
    labels: NDArray[np.uint32],
    contribution: NDArray[np.float64],
    largest: int,
    budgets: Budgets = (),
) -> ChunkedOrder:
    """Cut an order into chunks of one object each.

    Parameters
    ----------
    rows : (n,) int64
        Order of the splats, all objects mixed. Splats of one object keep their order.
    labels : (N,) uint32
        Object label of each row of the scene.
    contribution : (N,) float64
        Contribution of each row of the scene, which ranks the objects.
    largest : int
        Splats of a chunk at most.
    budgets : sequence of (int, float)
        Label of an object, and the share of its splats that comes first. Label None stands for all
        other objects.

    Returns
    -------
    ChunkedOrder
        Chunks of the splats within budgets come first, object by object in the order of
        `rank_objects`. The other chunks follow by the mean position of their splats in `rows`, as
        they would without budgets.

    Raises
    ------
    DataError
        ``object-missing``: a budget names an object that the scene lacks.
    """
    _require_budgeted(labels, budgets)
    shares = dict(budgets)
    others = shares.pop(None, 0.0)
    places = np.arange(len(rows))
    of_rows = labels[rows]
    first: list[NDArray[np.int64]] = []
    rest: list[tuple[float, int, NDArray[np.int64]]] = []
    for rank, label in enumerate(rank_objects(of_rows, contribution[rows])[0].tolist()):
        own = places[of_rows == label]
        count = math.ceil(shares.get(label, others) * len(own))
        first += [own[run] for run in plan_chunks(count, largest)]
        own = own[count:]
        runs = [own[run] for run in plan_chunks(len(own), largest)]
        rest += [(float(run.mean()), rank, run) for run in runs]
    rest.sort(key=lambda entry: entry[:2])
    chunks = first + [run for _, _, run in rest]
    stops = np.cumsum([len(run) for run in chunks]).tolist()
    slices = [slice(stop - len(run), stop) for run, stop in zip(chunks, stops, strict=True)]
    order = np.concatenate(chunks) if chunks else places
    chunk_labels = np.array([of_rows[run[0]] for run in chunks], np.uint32)
    return ChunkedOrder(rows[order], slices, chunk_labels)
