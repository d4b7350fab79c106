"""Parts of a scene that are encoded one by one: regions of space, and cameras of a part.

The tree of regions follows from a sample of the centres, because those of a city do not fit into
memory. Its leaves are the parts, the lower half before the upper one and the surroundings last.
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
from cogsplat.codec.geometry.unit_ball import into_unit_ball

from .nested_cells import WHOLE_SCENE, Region, box_of_most, dividing_plane, inner_box

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

FAR_CAMERAS: Final = 16
"""Largest number of cameras that a part gets from outside its enlarged box. When parts only had
cameras of their own streets, a city of ten million splats in eight parts had a PSNR of 18 to 25 dB
from far away, and of 40 to 50 dB in its streets."""

# Least share of a part's centres in the picture of such a camera. Chosen, not measured.
_SEEN_SHARE: Final = 0.25

# Extension of a part's box at each side, as a share of its longest side: cameras in the next street
# and over the roofs show the part as well. Chosen, not measured.
_MARGIN: Final = 0.25

# Least centres of a sample that are worth a part of surroundings. Chosen, not measured.
_LEAST_AROUND: Final = 16

# Centres of a part that decide whether a camera sees it. They are looked up for every camera.
_SEEN_CENTRES: Final = 1024


def part_regions(sample: F64, shares: float, most: float) -> Region:
    """Cut space into parts: planes halve the scene, and surroundings get parts of their own.

    A part that also held surroundings (`box_of_most`), such as the sky, would have a box of
    kilometres, which does not tell where a visitor needs it.

    Parameters
    ----------
    sample, shares, most
        As of `halving_planes`.

    Examples
    --------
    >>> import numpy as np
    >>> from cogsplat.codec.partition.scene_parts import divide, part_regions
    >>> line = np.arange(1000.0)[:, None] * [0.01, 0, 0]
    >>> sky = np.full((16, 3), [0.0, -50.0, 0.0])
    >>> scene = np.concatenate([sky, line])
    >>> [len(part) for part in divide(part_regions(scene, 1.0, 600), scene)]
    [500, 500, 16]
    """
    if len(sample) < 2 or len(sample) * shares <= most:
        return WHOLE_SCENE
    box = box_of_most(sample)
    is_around = Region(box=box).in_second_half(sample, np.arange(len(sample)))
    if np.count_nonzero(is_around) < _LEAST_AROUND:
        return halving_planes(sample, shares, most)
    inside, around = (halving_planes(sample[of], shares, most) for of in (~is_around, is_around))
    return Region(halves=(inside, around), box=box)


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
    >>> from cogsplat.codec.partition.scene_parts import divide, halving_planes
    >>> street = np.array([[0.0, 0, 0], [9, 0, 0], [1, 0, 0], [8, 0, 0]])
    >>> regions = halving_planes(street, shares=1.0, most=2)
    >>> regions.axis, regions.plane
    (0, 8.0)
    >>> [part.tolist() for part in divide(regions, street)]
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


def divide(regions: Region, centres: F64) -> list[I64]:
    """Return the rows of the centres in each part, ascending.

    A centre with a NaN belongs to the first part, whatever its other coordinates.

    Parameters
    ----------
    regions : Region
        Tree of regions, as of `part_regions`.
    centres : (n, 3) float64
        Centres, scene units.
    """
    is_nan = np.isnan(centres).any(axis=1)
    if is_nan.any():
        # NaN fails every comparison below, so that it ends in the first part.
        centres = np.array(centres)
        centres[is_nan] = np.nan
    parts: list[I64] = []
    _divide(regions, np.arange(len(centres)), centres, parts)
    return parts


def _divide(regions: Region, places: I64, centres: F64, parts: list[I64]) -> None:
    """Append the rows of each part below a node, of the centres in rows `places`."""
    if regions.halves is None:
        parts.append(places)
        return
    is_high = regions.in_second_half(centres, places)
    _divide(regions.halves[0], places[~is_high], centres, parts)
    _divide(regions.halves[1], places[is_high], centres, parts)


def refined(regions: Region, finer: Mapping[int, Region]) -> Region:
    """Return a tree of regions with some parts cut further.

    Parameters
    ----------
    regions : Region
        Tree of regions.
    finer : mapping of int to Region
        Planes that cut a part, by its number.
    """
    numbers = iter(range(count_parts(regions)))

    def below(node: Region) -> Region:
        if node.halves is None:
            return finer.get(next(numbers), node)
        low, high = node.halves
        return replace(node, halves=(below(low), below(high)))

    return below(regions)


def count_parts(regions: Region) -> int:
    """Return the number of parts of a tree of regions."""
    return 1 if regions.halves is None else sum(map(count_parts, regions.halves))


def part_cameras(sample: F64, cameras: Sequence[Camera]) -> list[Camera]:
    """Choose the cameras with which a part is encoded.

    A camera shows as much of a part as it has of the sample in its picture, occluded or not. Inside
    the enlarged box of the part, all cameras are taken that show any of it. Outside, of the cameras
    that show at least a quarter of it, at most `FAR_CAMERAS` are taken: first the one nearest to
    the box, then each time the one farthest from those taken, with positions mapped by
    `into_unit_ball`.

    Parameters
    ----------
    sample : (n, 3) float64
        Random sample of the part's centres, scene units. The box of the part leaves out 2 % of them
        at each end of an axis, and is enlarged at each side by a quarter of its longest side.
    cameras : sequence of Camera
        Cameras of the scene, in the frame of the centres.

    Returns
    -------
    list of Camera
        Some of the cameras, in the order in which they were given; none for an empty sample.
    """
    sample = sample[np.isfinite(sample).all(axis=1)]
    if not len(sample) or not cameras:
        return []
    low, high = inner_box(sample)
    margin = _MARGIN * float((high - low).max())
    positions = np.array([camera.position for camera in cameras])
    outside = np.maximum(np.maximum(low - positions, positions - high), 0.0)
    is_near = (outside <= margin).all(axis=1)
    seen = sample[:: -(-len(sample) // _SEEN_CENTRES)]
    with np.errstate(all="ignore"):
        shares = np.array([in_picture(seen, camera, NEAR).mean() for camera in cameras])
    is_chosen = is_near & (shares > 0.0)
    far = np.flatnonzero(~is_near & (shares >= _SEEN_SHARE))
    nearest = int(np.argmin(np.linalg.norm(outside[far], axis=1))) if len(far) else 0
    mapped = into_unit_ball(positions[far], sample)
    is_chosen[far[farthest_first(mapped, FAR_CAMERAS, nearest)]] = True
    return [cameras[number] for number in np.flatnonzero(is_chosen).tolist()]
