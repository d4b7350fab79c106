"""Build the view table of an encoded scene: viewpoints, and the contribution of each chunk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from cogsplat.codec.cameras import Camera
from cogsplat.codec.executor import Executor
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.scoring.chunk_contributions import chunk_contributions
from cogsplat.codec.segments.view_shares import (
    MAX_CODES,
    MAX_VIEWS,
    ViewTable,
    encode_shares,
    quantise_directions,
)
from cogsplat.codec.views.view_clusters import view_clusters
from cogsplat.codec.views.view_sets import sample_evenly
from cogsplat.codec.workspace import IN_MEMORY, Workspace

from .encoded import EncodedScene

_LARGEST_SHARE: Final = 1 / 200
"""Largest size of a view table, as a share of the chunks' bytes."""

# Least viewpoints of a table; fewer do not cover the places of visitors.
_LEAST_VIEWS: Final = 4

# Bytes of a viewpoint: a position of three float32 and a direction of three bytes. Bytes of the map
# with the names of its columns.
_VIEW_BYTES: Final = 15
_MAP_BYTES: Final = 48

# Centres from which the middle and the extent of a scene follow, about.
_SAMPLED_MEANS: Final = 10_000

MOST_CAMERAS: Final = 4 * MAX_VIEWS
"""Cameras rendered for a view table at most."""


def count_viewpoints(encoded: EncodedScene, cameras: int) -> int:
    """Return the number of viewpoints of a scene's view table; 0 for no table.

    Parameters
    ----------
    encoded : EncodedScene
        Scene with its chunks.
    cameras : int
        Number of cameras to choose viewpoints from.

    Notes
    -----
    The table fits into `_LARGEST_SHARE` of the scene's bytes even if its codes do not compress, so
    that a search for a size knows an upper bound.
    """
    size = sum(
        sum(len(part or b"") for part in (p.head, p.refinement, p.tail))
        for p in (chunk.payloads for chunk in encoded.chunks)
    )
    each = len(encoded.chunks) + _VIEW_BYTES
    fit = int((size * _LARGEST_SHARE - _MAP_BYTES) / each)
    most = min(fit, MAX_VIEWS, cameras, MAX_CODES // max(len(encoded.chunks), 1))
    return most if most >= _LEAST_VIEWS else 0


def add_view_table(
    encoded: EncodedScene,
    cameras: Sequence[Camera],
    *,
    workspace: Workspace = IN_MEMORY,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> EncodedScene:
    """Return a scene with a view table: the contribution of each chunk to some viewpoints.

    Parameters
    ----------
    encoded : EncodedScene
        Scene with its chunks.
    cameras : sequence of Camera
        Cameras in the frame of the means. Near cameras become one viewpoint with their mean
        position, direction and contributions.
    workspace : Workspace
        Allocator of long arrays.
    executor : Executor, optional
        Runs the work of single views; None for threads of this process.
    progress : Progress
        Called with the stage ``view table``.

    Returns
    -------
    EncodedScene
        Scene with a table; unchanged where it has too few bytes or cameras.
    """
    cameras = sample_evenly(cameras, MOST_CAMERAS)
    views = count_viewpoints(encoded, len(cameras))
    if not views:
        return encoded
    counts = np.array([chunk.splats for chunk in encoded.chunks], np.int64)
    chunks = np.repeat(np.arange(len(counts), dtype=np.int32), counts)
    shares = chunk_contributions(
        encoded.decoded,
        chunks,
        len(counts),
        cameras,
        workspace=workspace,
        executor=executor,
        progress=progress,
    )
    means = encoded.decoded.means[:: -(-len(encoded.decoded) // _SAMPLED_MEANS)]
    clusters = view_clusters(cameras, means, views)
    positions = np.stack([camera.position for camera in cameras])
    forward = np.stack([camera.rotation[2] for camera in cameras])
    directions = np.stack([forward[cluster].mean(axis=0) for cluster in clusters])
    lengths = np.sqrt(np.square(directions).sum(axis=1, keepdims=True))
    # Cameras with opposite directions have no mean direction: use that of the first.
    first = np.stack([forward[cluster[0]] for cluster in clusters])
    directions = np.where(lengths > 0.5, directions / np.maximum(lengths, 0.5), first)
    table = ViewTable(
        np.stack([positions[cluster].mean(axis=0) for cluster in clusters]).astype(np.float32),
        quantise_directions(directions),
        encode_shares(np.stack([shares[cluster].mean(axis=0) for cluster in clusters])),
    )
    return replace(encoded, view_table=table)


def reserve_view_table(encoded: EncodedScene, cameras: int) -> EncodedScene:
    """Return a scene with a placeholder view table of the largest size, for a size search.

    Parameters
    ----------
    encoded : EncodedScene
        Scene with its chunks.
    cameras : int
        Number of cameras for the table.
    """
    views = count_viewpoints(encoded, min(cameras, MOST_CAMERAS))
    if not views:
        return encoded
    # Random codes, which do not compress.
    codes = np.random.default_rng(0).integers(0, 256, (views, len(encoded.chunks)), np.uint8)
    zeros = np.zeros((views, 3), np.float32)
    return replace(encoded, view_table=ViewTable(zeros, np.ones((views, 3), np.int8), codes))
