"""View tables of encoded scenes: which views, and what their pictures show of each chunk."""

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

from .encoded import EncodedScene

_LARGEST_SHARE: Final = 1 / 200
"""Most bytes of a view table, as a share of what the chunks take."""

# Fewer views say too little about where a visitor may be.
_LEAST_VIEWS: Final = 4

# Bytes of one viewpoint: a position of three float32 and a direction of three bytes; and of the
# map around the columns with their names.
_VIEW_BYTES: Final = 15
_MAP_BYTES: Final = 48

MOST_CAMERAS: Final = 4 * MAX_VIEWS
"""Cameras that are drawn for a view table, at most."""


def num_views(encoded: EncodedScene, cameras: int) -> int:
    """Return how many viewpoints a scene's view table has; 0 where it has no table.

    Parameters
    ----------
    encoded : EncodedScene
    cameras : int
        Cameras to take viewpoints from.

    Notes
    -----
    As many as fit into `_LARGEST_SHARE` of the scene's bytes even if their codes cannot be made
    smaller, so that a search for a size knows the most that the table takes.
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
    executor: Executor | None = None,
    progress: Progress = silent,
) -> EncodedScene:
    """Return a scene with its view table: what the pictures of some cameras show of each chunk.

    Parameters
    ----------
    encoded : EncodedScene
    cameras : sequence of Camera
        In the frame of the means. Those near each other are one viewpoint, in the mean of their
        positions and directions, and its shares are the means of theirs.
    executor : Executor, optional
        What runs the work of single views; threads of this process where it is not given.
    progress : Progress
        Called with the stage ``view table``.

    Returns
    -------
    EncodedScene
        The same without a table where the scene has too few bytes or cameras for one.
    """
    cameras = sample_evenly(cameras, MOST_CAMERAS)
    views = num_views(encoded, len(cameras))
    if not views:
        return encoded
    counts = np.array([chunk.splats for chunk in encoded.chunks], np.int64)
    chunks = np.repeat(np.arange(len(counts)), counts)
    shares = chunk_contributions(
        encoded.decoded, chunks, len(counts), cameras, executor=executor, progress=progress
    )
    clusters = view_clusters(cameras, views)
    positions = np.stack([camera.position for camera in cameras])
    forward = np.stack([camera.rotation[2] for camera in cameras])
    directions = np.stack([forward[cluster].mean(axis=0) for cluster in clusters])
    lengths = np.sqrt(np.square(directions).sum(axis=1, keepdims=True))
    # Cameras that look opposite ways have no mean direction; then the first one's counts.
    first = np.stack([forward[cluster[0]] for cluster in clusters])
    directions = np.where(lengths > 0.5, directions / np.maximum(lengths, 0.5), first)
    table = ViewTable(
        np.stack([positions[cluster].mean(axis=0) for cluster in clusters]).astype(np.float32),
        quantise_directions(directions),
        encode_shares(np.stack([shares[cluster].mean(axis=0) for cluster in clusters])),
    )
    return replace(encoded, view_table=table)


def reserve_view_table(encoded: EncodedScene, cameras: int) -> EncodedScene:
    """Return a scene with a view table of as many bytes as its own may take at most."""
    views = num_views(encoded, min(cameras, MOST_CAMERAS))
    if not views:
        return encoded
    # Codes that nothing makes smaller.
    codes = np.random.default_rng(0).integers(0, 256, (views, len(encoded.chunks)), np.uint8)
    zeros = np.zeros((views, 3), np.float32)
    return replace(encoded, view_table=ViewTable(zeros, np.ones((views, 3), np.int8), codes))
