"""View tables of a joined file, which also tell what one part hides of another (SPEC 5.12)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.segments.view_shares import MAX_VIEWS, ViewTable, encode_shares
from cogsplat.codec.splats import concatenate
from cogsplat.codec.views.view_sets import sample_evenly

from .reader import CogsFile

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

# Splats drawn at most; more if the first chunk of each part has more. With 83,000, a walk through a
# city of ten million splats shows 2 dB less after two seconds at 5 Mbit/s.
_DRAWN_SPLATS: Final = 500_000


def part_view_table(file: CogsFile) -> ViewTable | None:
    """Return the view table of a part, with all chunks of its file as columns.

    It is None where the root has no table, or a page has other viewpoints than the root: then the
    part was joined itself, and what its viewpoints see of all chunks is not known.
    """
    of_root = file.view_table()
    if of_root is None:
        return None
    codes = np.zeros((len(of_root.positions), file.num_chunks), np.uint8)
    for index in file.indices:
        table = file.view_table(index.path)
        if table is None:
            continue
        if not np.array_equal(table.positions, of_root.positions):
            return None
        count = len(index.tables.chunks)
        codes[:, index.first_chunk : index.first_chunk + count] = table.codes[:, :count]
    return ViewTable(of_root.positions, codes)


def measure_joined_table(
    files: Sequence[CogsFile],
    tables: Sequence[ViewTable | None],
    parts: I64,
    contribution: F64,
    *,
    progress: Progress = silent,
) -> ViewTable | None:
    """Measure what viewpoints of all parts see of each part.

    The first chunks of all parts are drawn together. A part's share of a panorama is shared out
    among its chunks in proportion to their contributions.

    Parameters
    ----------
    files : sequence of CogsFile
        Open files of the parts.
    tables : sequence of ViewTable or None
        View table of each part. Of all their viewpoints, 64 are taken at most.
    parts : (c,) int64
        Part of each chunk of the joined file.
    contribution : (c,) float64
        Contribution of each chunk, at least 0.
    progress : Progress
        Called with ``("view table", pictures done, pictures)``.

    Returns
    -------
    ViewTable or None
        Table with all chunks of the joined file as columns; None if no part has a table.
    """
    found = {
        position.tobytes(): position
        for table in tables
        if table is not None
        for position in table.positions
    }
    if not found:
        return None
    # Imported late: commands that only decode need no compiler.
    from cogsplat.codec.scoring.panorama_shares import panorama_shares

    positions = np.array(sample_evenly(list(found.values()), MAX_VIEWS))
    share = _DRAWN_SPLATS / max(sum(int(file.root.splats) for file in files), 1)
    drawn = [
        file.decode(range(_first_chunks(file, share)), sh_degree=0, extras=False, compensate=True)
        for file in files
    ]
    owners = np.repeat(np.arange(len(files)), [len(splats) for splats in drawn])
    shares = panorama_shares(concatenate(drawn), owners, len(files), positions, progress=progress)
    sums = np.bincount(parts, contribution, minlength=len(files))
    of_chunk = contribution / np.where(sums > 0.0, sums, 1.0)[parts]
    return ViewTable(positions, encode_shares(shares[:, parts] * of_chunk))


def _first_chunks(file: CogsFile, share: float) -> int:
    """Return the number of a file's first chunks that are drawn, within a share of its splats.

    It is at least 1, and at most the number that the root lists: these show the whole part, others
    one place.
    """
    ends = np.cumsum(file.chunks.splats[: len(file.indices[0].tables.chunks)], dtype=np.int64)
    count = int(np.searchsorted(ends, share * float(file.root.splats), side="right"))
    return min(max(count, 1), len(ends))
