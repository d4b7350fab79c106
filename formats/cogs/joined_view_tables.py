"""View tables of a joined file: what viewpoints in every part see of each part (SPEC 5.12)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.segments.view_shares import MAX_VIEWS, ViewTable, encode_shares
from cogsplat.codec.splats import concatenate
from cogsplat.codec.views.pose import Lens, Pose
from cogsplat.codec.views.view_sets import sample_evenly

from .reader import CogsFile

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

# Splats that are drawn at most, but for the first chunk of each part. With 83,000, a walk through a
# city of ten million splats shows 2 dB less after two seconds at 5 Mbit/s.
_DRAWN_SPLATS: Final = 500_000
# Pictures from viewpoints, whose angle of view is not stored: 90 degrees.
_LENS: Final = Lens(128, 128, 1.0)


def part_view_table(file: CogsFile) -> ViewTable | None:
    """Return the view table of a file, with all of its chunks as columns; None without one."""
    whole = file.view_table()
    if whole is None:
        return None
    views = {_viewpoint(whole, row): row for row in range(len(whole.positions))}
    codes = np.zeros((len(whole.positions), file.num_chunks), np.uint8)
    for index in file.indices:
        table = file.view_table(index.path)
        if table is None:
            continue
        rows = [views[_viewpoint(table, row)] for row in range(len(table.positions))]
        count = len(index.tables.chunks)
        codes[rows, index.first_chunk : index.first_chunk + count] = table.codes[:, :count]
    return ViewTable(whole.positions, whole.directions, codes)


def _viewpoint(table: ViewTable, row: int) -> bytes:
    """Return the bytes of a viewpoint, by which it is found again in the tables of pages."""
    return bytes(table.positions[row].tobytes() + table.directions[row].tobytes())


def measure_whole_table(
    files: Sequence[CogsFile],
    tables: Sequence[ViewTable | None],
    parts: I64,
    contribution: F64,
    *,
    progress: Progress = silent,
) -> ViewTable | None:
    """Measure what viewpoints of all parts see of each part, in pictures of their first chunks.

    Parameters
    ----------
    files : sequence of CogsFile
        Open files of the parts.
    tables : sequence of ViewTable or None
        View table of each part, from which the viewpoints are taken; 64 at most.
    parts : (c,) int64
        Part of each chunk of the joined file.
    contribution : (c,) float64
        Contribution of each chunk. The chunks of a part divide its share of a picture by it.
    progress : Progress
        Called with ``("view table", views done, views)``.

    Returns
    -------
    ViewTable or None
        Table with all chunks of the joined file as columns; None if no part has one.
    """
    found = [table for table in tables if table is not None]
    if not found:
        return None
    # Imported late: commands that only decode need no compiler.
    from cogsplat.codec.scoring.chunk_contributions import chunk_contributions

    positions = np.concatenate([table.positions for table in found])
    directions = np.concatenate([table.directions for table in found])
    rows = sample_evenly(range(len(positions)), MAX_VIEWS)
    cameras = [_camera(positions[row], directions[row]) for row in rows]
    share = _DRAWN_SPLATS / max(sum(int(file.root.splats) for file in files), 1)
    first = [_first_chunks(file, share) for file in files]
    drawn = [
        file.decode(range(count), sh_degree=0, extras=False, compensate=True)
        for file, count in zip(files, first, strict=True)
    ]
    owners = np.repeat(np.arange(len(files)), [len(splats) for splats in drawn])
    shares = chunk_contributions(concatenate(drawn), owners, len(files), cameras, progress=progress)
    whole = np.bincount(parts, contribution, minlength=len(files))
    of_part = contribution / np.where(whole > 0.0, whole, 1.0)[parts]
    return ViewTable(positions[rows], directions[rows], encode_shares(shares[:, parts] * of_part))


def _first_chunks(file: CogsFile, share: float) -> int:
    """Return how many first chunks have a share of a file's splats: 1 up to those of the root.

    The root's chunks show the whole of the part, those of a page only one place.
    """
    ends = np.cumsum(file.chunks.splats[: len(file.indices[0].tables.chunks)], dtype=np.int64)
    count = int(np.searchsorted(ends, share * float(file.root.splats), side="right"))
    return min(max(count, 1), len(ends))


def _camera(position: NDArray[np.float32], direction: NDArray[np.int8]) -> Camera:
    """Return the camera of a viewpoint; its roll is arbitrary."""
    forward = direction.astype(np.float64)
    forward /= np.linalg.norm(forward)
    return Pose(position.astype(np.float64), forward, 1.0).camera(_LENS, np.zeros(3))
