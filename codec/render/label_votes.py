"""Label votes: blending weights of each splat, summed by the mask label of the pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.splats import Splats

from .blending import (
    LANES,
    PIXELS,
    bits,
    blend_pixel,
    find_open_rows,
    footprint_in_tile,
    open_pixels,
    rows_in_tile,
    tile_area,
)
from .jit import kernel
from .projection import project
from .tiles import TILE, tile_lists

_ZERO = np.float32(0.0)


@kernel
def _vote(
    lists_first: int,
    lists_last: int,
    starts: NDArray[np.int64],
    members: NDArray[np.int32],
    ellipse: NDArray[np.float32],
    rows: NDArray[np.int32],
    labels: NDArray[np.int32],
    votes: NDArray[np.float64],
) -> None:
    """Add the weight of every splat in every pixel to the splat's votes for the pixel's label.

    Parameters
    ----------
    lists_first, lists_last, starts, members
        Attributes of `TileLists`.
    ellipse, rows
        Arrays of `Footprints`.
    labels : (H, W) int32
        Label of each pixel.
    votes : (M, labels) float64
        Summed weights by footprint and label, changed in place.
    """
    height, width = labels.shape
    live = np.empty(PIXELS, np.float32)
    open_rows = np.empty(TILE, np.uint32)
    weights = np.empty(TILE, np.float32)
    for tile in range(lists_first, lists_last):
        top, left, num_rows, num_columns = tile_area(tile, width, height)
        open_pixels(live, num_rows, num_columns)
        left_open = find_open_rows(live, open_rows)
        for pair in range(starts[tile - lists_first], starts[tile - lists_first + 1]):
            if left_open == 0:
                break
            i = members[pair]
            narrow, shear, flat, opacity, centre_x, centre_y = footprint_in_tile(
                ellipse[i], top, left
            )
            first_row, last_row = rows_in_tile(rows[i], top, num_rows)
            for y in range(first_row, last_row):
                if open_rows[y] == 0:
                    continue
                dy = np.float32(y) - centre_y
                row_x = centre_x + shear * dy
                row_exponent = -flat * dy * dy
                base = np.uintp(y * TILE)
                open_row = np.uint32(0)
                for lane in range(LANES):
                    at = base + lane
                    u = narrow * (np.float32(lane) - row_x)
                    _, _, weight, _, after = blend_pixel(live[at], opacity, row_exponent - u * u)
                    live[at] = after
                    weights[lane] = weight
                    open_row = np.uint32(open_row | bits(after))
                open_rows[y] = open_row
                left_open -= int(open_row == 0)
                for x in range(num_columns):
                    if weights[x] > _ZERO:
                        votes[i, labels[top + y, left + x]] += weights[x]


def label_votes(
    splats: Splats, camera: Camera, labels: NDArray[np.int32], count: int
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Sum the blending weights of each splat by the label of the pixels.

    Parameters
    ----------
    splats : Splats
        Scene, drawn with the kernel and anti-aliasing of ``splats.info``.
    camera : Camera
        Camera in the frame of the means.
    labels : (H, W) int32
        Mask of the camera's image, with labels from 0 to ``count - 1``.
    count : int
        Number of labels.

    Returns
    -------
    index : (M,) int32
        Rows of the scene whose footprint reaches the image, nearest first.
    votes : (M, count) float64
        Sum of T·alpha over the pixels of each label, px.
    """
    footprints = project(splats, camera)
    votes = np.zeros((len(footprints), count), np.float64)
    for lists in tile_lists(footprints, camera.width, camera.height):
        _vote(
            lists.first,
            lists.last,
            lists.starts,
            lists.members,
            footprints.ellipse,
            footprints.rows,
            labels,
            votes,
        )
    return footprints.index, votes
