"""Parts of a scene that are encoded one by one: planes that halve space, and cameras of a part.

A tree of planes is drawn through a sample of the centres, because those of a city do not fit into
memory. The leaves of the tree, the lower half before the upper one, are the parts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.farthest_first import farthest_first
from cogsplat.codec.geometry.frustum import NEAR, in_picture

from .nested_cells import WHOLE_SCENE, Region, dividing_plane, inner_box

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

FAR_CAMERAS: Final = 16
"""Most cameras of a part from outside its surroundings. With street cameras alone, a city of ten
million splats in eight parts showed 18 to 25 dB from far away, where its streets had 40 to 50
dB."""

# Least share of a part's centres in the picture of such a camera. Chosen, not measured.
_SEEN_SHARE: Final = 0.25

# Extension of a part's box at each side, as a share of its extent: cameras in the next street show
# the part as well. Chosen, not measured.
_MARGIN: Final = 0.25

# Centres of a part that decide whether a camera sees it. They are looked up for every camera.
_SEEN_CENTRES: Final = 1024


def halving_planes(sample: F64, shares: float, most: float) -> Region:
    """Halve space by planes until no part is expected to hold more than a number of splats.

    Each plane halves the sample across the longest side of its box, which leaves out 2 % of the
    centres at each end.

    Parameters
    ----------
    sample : (n, 3) float64
        Finite centres that are drawn evenly from the scene, scene units.
    shares : float
        Splats of the scene per centre of the sample.
    most : float
        Largest number of splats of a part. A part whose centres in the sample coincide may hold
        more.

    Examples
    --------
    >>> import numpy as np
    >>> from cogsplat.codec.partition.part_planes import divide, halving_planes
    >>> street = np.array([[0.0, 0, 0], [9, 0, 0], [1, 0, 0], [8, 0, 0]])
    >>> planes = halving_planes(street, shares=1.0, most=2)
    >>> planes.axis, planes.plane
    (0, 8.0)
    >>> [part.tolist() for part in divide(planes, street)]
    [[0, 2], [1, 3]]
    """
    if len(sample) < 2 or len(sample) * shares <= most:
        return WHOLE_SCENE
    plane = dividing_plane(sample, 1, -(-len(sample) // 2))
    if plane is None:
        return WHOLE_SCENE
    axis, place = plane
    is_high = sample[:, axis] >= place
    low, high = (halving_planes(sample[side], shares, most) for side in (~is_high, is_high))
    return Region(axis, place, (low, high))


def divide(planes: Region, centres: F64) -> list[I64]:
    """Return the rows of the centres in each part, ascending.

    A centre with a NaN belongs to the first part, whatever its other coordinates.

    Parameters
    ----------
    planes : Region
        Tree of planes, as of `halving_planes`.
    centres : (n, 3) float64
        Centres, scene units.
    """
    is_nan = np.isnan(centres).any(axis=1)
    if is_nan.any():
        # NaN fails every comparison below, so that it ends in the first part.
        centres = np.array(centres)
        centres[is_nan] = np.nan
    parts: list[I64] = []
    _divide(planes, np.arange(len(centres)), centres, parts)
    return parts


def _divide(planes: Region, places: I64, centres: F64, parts: list[I64]) -> None:
    """Append the rows of each part below a node, of the centres in rows `places`."""
    if planes.halves is None:
        parts.append(places)
        return
    is_high = centres[:, planes.axis].take(places) >= planes.plane
    _divide(planes.halves[0], places[~is_high], centres, parts)
    _divide(planes.halves[1], places[is_high], centres, parts)


def refined(planes: Region, finer: Mapping[int, Region]) -> Region:
    """Return a tree of planes with some parts cut further.

    Parameters
    ----------
    planes : Region
        Tree of planes.
    finer : mapping of int to Region
        Planes that cut a part, by its number.
    """
    numbers = iter(range(count_parts(planes)))

    def below(node: Region) -> Region:
        if node.halves is None:
            return finer.get(next(numbers), node)
        low, high = node.halves
        return replace(node, halves=(below(low), below(high)))

    return below(planes)


def count_parts(planes: Region) -> int:
    """Return the number of parts of a tree of planes."""
    return 1 if planes.halves is None else sum(map(count_parts, planes.halves))


def part_cameras(sample: F64, cameras: Sequence[Camera]) -> list[Camera]:
    """Return the cameras that show a part, in their order.

    These are the cameras inside the part's box, enlarged by a quarter of its extent at each side,
    and at most `FAR_CAMERAS` others with at least a quarter of the part in their picture, occluded
    or not: the nearest, then always the one farthest from those chosen.

    Parameters
    ----------
    sample : (n, 3) float64
        Centres that are drawn evenly from the part, scene units. Its box leaves out 2 % of them at
        each end.
    cameras : sequence of Camera
        Cameras of the scene, in the frame of the centres.
    """
    sample = sample[np.isfinite(sample).all(axis=1)]
    if not len(sample) or not cameras:
        return []
    low, high = inner_box(sample)
    margin = _MARGIN * (high - low)
    positions = np.array([camera.position for camera in cameras])
    outside = np.maximum(np.maximum(low - positions, positions - high), 0.0)
    is_chosen = (outside <= margin).all(axis=1)
    seen = sample[:: -(-len(sample) // _SEEN_CENTRES)]
    with np.errstate(all="ignore"):
        shares = np.array([in_picture(seen, camera, NEAR).mean() for camera in cameras])
    far = np.flatnonzero(~is_chosen & (shares >= _SEEN_SHARE))
    nearest = int(np.argmin(np.linalg.norm(outside[far], axis=1))) if len(far) else 0
    is_chosen[far[farthest_first(positions[far], FAR_CAMERAS, nearest)]] = True
    return [cameras[number] for number in np.flatnonzero(is_chosen).tolist()]
