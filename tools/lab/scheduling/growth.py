"""Growth: larger splats in chunks of which a child is missing (docs/streaming.md, 10).

Only chunks that come after those of the last compensation layer grow; SPEC 8.5 enlarges the others.
"""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.segments.chunk_sets import descendant_splats

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

# Added to log scales each time that the number of splats doubles for which a held one stands. The
# full area of the missing splats would take ½ ln 2 = 0.35; it is less because they overlap.
_PER_DOUBLING: Final = 0.25
# The most that is added: a splat doubles its size. More hides what is near (docs/ablations.md).
_MOST: Final = 0.7


def missing_splats(is_held: NDArray[np.bool_], parents: I64, splats: I64) -> I64:
    """Return the number of missing splats of each row and its descendants together.

    Parameters
    ----------
    is_held : (r,) bool
        Whether a client has each row. A row that is not held has no descendant that is.
    parents : (r,) int64
        Row of the parent of each row, an earlier one; -1 for none.
    splats : (r,) int64
        Number of splats of each row that count at the pose (`chunk_ratios.visible_splat_counts`).

    Returns
    -------
    (r,) int64
        Sums, rounded down to powers of two so that they rarely change; 0 for a row that is held,
        even if descendants are missing.
    """
    sums = descendant_splats(np.ones(len(parents), np.bool_), parents, splats)
    _, exponents = np.frexp(sums.astype(np.float64))
    return np.where(is_held | (sums == 0), 0, 1 << np.maximum(exponents.astype(np.int64) - 1, 0))


def growth(means: F32, boxes: F64, missing: I64) -> F32:
    """Return the growth of each splat of a chunk, an addend of its three log scales.

    Each splat belongs to the first child whose box contains its mean, if any. It grows if splats
    are missing at this child.

    Parameters
    ----------
    means : (n, 3) float32
        Decoded means of the chunk, scene units.
    boxes : (k, 6) float64
        Boxes of the chunk's children in the order of the file: minimum, maximum, scene units.
    missing : (k,) int64
        Number of missing splats at each child (`missing_splats`).

    Returns
    -------
    (n,) float32

    Examples
    --------
    >>> import numpy as np
    >>> from cogsplat.tools.lab.scheduling.growth import growth
    >>> means = np.array([[0.5, 0, 0], [2.5, 0, 0]], np.float32)
    >>> boxes = np.array([[0, 0, 0, 1, 1, 1], [2, 0, 0, 3, 1, 1]], np.float64)
    >>> growth(means, boxes, np.array([0, 4])).tolist()
    [0.0, 0.5625]
    """
    child_of = np.full(len(means), -1)
    for child in range(len(boxes) - 1, -1, -1):
        low, high = boxes[child, :3], boxes[child, 3:]
        child_of[((means >= low) & (means <= high)).all(axis=1)] = child
    counts = np.bincount(child_of[child_of >= 0], minlength=len(boxes))
    mantissas, exponents = np.frexp((counts + missing) / np.maximum(counts, 1))
    # Nearly the logarithm to base 2, without one: 1 for 2, 2 for 4, straight lines in between.
    doublings = exponents + 2.0 * mantissas - 2.0
    added = np.where(missing > 0, np.minimum(_PER_DOUBLING * doublings, _MOST), 0.0)
    result: F32 = np.append(added, 0.0)[child_of].astype(np.float32)
    return result
