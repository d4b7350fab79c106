"""Build the view table of an encoded scene: each chunk's share of the panoramas of viewpoints."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.executor import Executor
from cogsplat.codec.farthest_first import farthest_first
from cogsplat.codec.geometry.unit_ball import into_unit_ball
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.scoring.panorama_shares import panorama_shares
from cogsplat.codec.segments.view_shares import MAX_CODES, ViewTable, encode_shares
from cogsplat.codec.workspace import IN_MEMORY, Workspace

from .encoded import EncodedScene

_LARGEST_SHARE: Final = 1 / 200
"""Largest size of a view table, as a share of the bytes of all heads, refinements and tails."""

# Least viewpoints that there must be room and cameras for; fewer do not cover where visitors are.
_LEAST_VIEWPOINTS: Final = 4

# Bytes of a viewpoint's position, three float32, and of the map with the names of its columns.
_VIEW_BYTES: Final = 12
_MAP_BYTES: Final = 32

# Centres from which the middle and the extent of a scene follow, about.
_SAMPLED_MEANS: Final = 10_000

MOST_VIEWPOINTS: Final = 32
"""Viewpoints of a table at most: of a city of a million splats, 42 take 14 % of the time of an
encode and give pictures no better than 32 do."""


def count_viewpoints(encoded: EncodedScene, cameras: int) -> int:
    """Return the largest number of viewpoints of a scene's view table; 0 for no table.

    Parameters
    ----------
    encoded : EncodedScene
        Scene with its chunks.
    cameras : int
        Number of cameras whose positions viewpoints are chosen from.

    Notes
    -----
    The table fits into `_LARGEST_SHARE` even if its codes do not compress; a search for a size
    reserves that much.
    """
    size = sum(
        sum(len(part or b"") for part in (p.head, p.refinement, p.tail))
        for p in (chunk.payloads for chunk in encoded.chunks)
    )
    each = len(encoded.chunks) + _VIEW_BYTES
    fit = int((size * _LARGEST_SHARE - _MAP_BYTES) / each)
    most = min(fit, MOST_VIEWPOINTS, cameras, MAX_CODES // max(len(encoded.chunks), 1))
    return most if most >= _LEAST_VIEWPOINTS else 0


def add_view_table(
    encoded: EncodedScene,
    cameras: Sequence[Camera],
    *,
    workspace: Workspace = IN_MEMORY,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> EncodedScene:
    """Return a scene with a view table: each chunk's share of the panoramas of some viewpoints.

    Parameters
    ----------
    encoded : EncodedScene
        Scene with its chunks.
    cameras : sequence of Camera
        Cameras in the frame of the means. Viewpoints are some of their positions, all different:
        the first camera's, then always the one farthest from the nearest chosen one, in the unit
        ball of `into_unit_ball`.
    workspace : Workspace
        Allocator of long arrays.
    executor : Executor, optional
        Runs the work of single pictures; None for threads of this process.
    progress : Progress
        Called with the stage ``view table``.

    Returns
    -------
    EncodedScene
        Scene with a table; unchanged where it has too few bytes or cameras.
    """
    most = count_viewpoints(encoded, len(cameras))
    if not most:
        return encoded
    positions = np.stack([camera.position for camera in cameras]).astype(np.float32)
    means = encoded.decoded.means[:: -(-len(encoded.decoded) // _SAMPLED_MEANS)]
    positions = _spread(positions, means, most)
    counts = np.array([chunk.splats for chunk in encoded.chunks], np.int64)
    shares = panorama_shares(
        encoded.decoded,
        np.repeat(np.arange(len(counts), dtype=np.int32), counts),
        len(counts),
        positions,
        workspace=workspace,
        executor=executor,
        progress=progress,
    )
    return replace(encoded, view_table=ViewTable(positions, encode_shares(shares)))


def reserve_view_table(encoded: EncodedScene, cameras: int) -> EncodedScene:
    """Return a scene with a placeholder view table of the largest size, for a size search.

    Parameters
    ----------
    encoded : EncodedScene
        Scene with its chunks.
    cameras : int
        Number of cameras for the table.
    """
    views = count_viewpoints(encoded, cameras)
    if not views:
        return encoded
    # Random codes, which do not compress.
    codes = np.random.default_rng(0).integers(0, 256, (views, len(encoded.chunks)), np.uint8)
    return replace(encoded, view_table=ViewTable(np.zeros((views, 3), np.float32), codes))


def _spread(
    positions: NDArray[np.float32], means: NDArray[np.floating], count: int
) -> NDArray[np.float32]:
    """Return at most `count` different positions, spread over all, (v, 3) float32.

    Each is followed by the nearest of those left, so that neighbours see alike and compress well.
    """
    different = positions[np.sort(np.unique(positions, axis=0, return_index=True)[1])]
    points = into_unit_ball(different.astype(np.float64), means)
    left = farthest_first(points, count)
    path = [left.pop(0)]
    while left:
        away = np.linalg.norm(points[left] - points[path[-1]], axis=1)
        path.append(left.pop(int(away.argmin())))
    return different[path]
