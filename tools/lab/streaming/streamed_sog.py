"""Streamed SOG as a client: its files, its levels of detail, and the order of PlayCanvas' viewer.

The rules are those of PlayCanvas' engine 2.23 (``gsplat-octree-instance``, ``gsplat-asset-loader``,
``gsplat-budget-balancer``) as SuperSplat's viewer 1.36 configures it, written from what they do:

- Each leaf of the tree shows one level at a time. The viewer asks for the coarsest level of all
  leaves first, then for the level that each leaf should have, whatever lies between.
- With room for all splats of the finest level, that is the level of every leaf. Otherwise leaves
  are refined by their distance, each level reaching `_STEP` times as far as the finer one, as far
  as the budget goes.
- Files of what shows nothing yet come before files that take the place of others; among these
  coarser ones come first, then those of the nearest leaf.
- The distance is that of the eye from the leaf's box, of which 3/4 of what it is larger than the
  median is taken off; five times as far where the box lies straight behind the eye.

It is granted more than it has: a file's images do not wait for its ``meta.json``, files follow each
other without a pause, and an image takes no time to decode.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import FormatError
from cogsplat.codec.splats import Splats, concatenate, sh_coefficients
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.scenes.sog.lod_meta import StreamedSog, read_lod_meta
from cogsplat.formats.scenes.sog.sog_scene import read_sog, sog_files
from cogsplat.formats.storage.atomic import StrPath
from cogsplat.formats.storage.limits import Limits

from .client import Units

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

BUDGET_SPLATS: Final = 4_000_000
"""Splats that SuperSplat's viewer 1.36 draws on a desktop, by default."""

# Engine 2.23: `lodMultiplier` and `lodDistanceShrink`. Viewer 1.36: `lodBehindPenalty`.
_STEP: Final = 3.0
_SHRINK: Final = 0.75
_BEHIND: Final = 5.0
# Tiers of requests: what shows nothing yet, what takes the place of something.
_NOTHING_YET: Final = 2.0
_BETTER: Final = 1.0


@dataclass(frozen=True, eq=False)
class StreamedSogClient:
    """A client of a Streamed SOG scene.

    Parameters
    ----------
    tree : StreamedSog
    scene : Splats
        Of all files, one after the other, the environment last.
    rows : list of slice
        Of `scene`, for each file.
    units : Units
        The files, each of its own chunk, in the order of the index.
    budget_splats : int
        Most splats that are drawn, where the coarsest level has fewer.
    """

    tree: StreamedSog
    scene: Splats
    rows: list[slice]
    units: Units
    budget_splats: int

    def wanted(self, camera: Camera) -> F64:
        """Return how much each file is wanted from a pose, 0 for one that no leaf asks for."""
        tree, wanted = self.tree, np.zeros(len(self.rows))
        if tree.environment is not None:
            wanted[-1] = _NOTHING_YET + 1.0
        away = _distances(tree.boxes, camera)
        nearness = 1.0 / (1.0 + away * away)
        depth = tree.file.shape[1]
        best = self._levels(away)
        tiers = ((_NOTHING_YET, np.full(len(best), depth - 1)), (_BETTER, best))
        for tier, levels in tiers:
            leaves = np.flatnonzero(_chosen(tree.file, levels) >= 0)
            urgency = tier + (levels[leaves] + nearness[leaves]) / depth
            np.maximum.at(wanted, _chosen(tree.file, levels)[leaves], urgency)
        return wanted

    def drawn(self, there: Sequence[int], camera: Camera) -> Splats:
        """Return what is drawn of files that are there, from a pose.

        Of each leaf the level that it should have, or the finest of those that are coarser, or the
        coarsest there is.
        """
        tree = self.tree
        has = np.zeros(len(self.rows), np.bool_)
        has[list(there)] = True
        best = self._levels(_distances(tree.boxes, camera))
        depth = tree.file.shape[1]
        rows = [np.zeros(0, np.int64)]
        if tree.environment is not None and has[-1]:
            rows.append(np.arange(self.rows[-1].start, self.rows[-1].stop))
        for leaf in np.flatnonzero(best >= 0).tolist():
            level = int(best[leaf])
            for other in [*range(level, depth), *range(level - 1, -1, -1)]:
                file = int(tree.file[leaf, other])
                if file >= 0 and has[file]:
                    first = self.rows[file].start + int(tree.start[leaf, other])
                    rows.append(np.arange(first, first + int(tree.count[leaf, other])))
                    break
        return self.scene.take(np.concatenate(rows))

    def _levels(self, away: F64) -> I64:
        """Return the level that each leaf should have; -1 for one without splats."""
        tree = self.tree
        depth = tree.file.shape[1]
        # What a leaf has at a level where it has no splats: the next finer, or else coarser one. It
        # is left out where all that it has is finer.
        used = np.stack([_used_level(tree.file, level) for level in range(depth)], axis=1)
        counts = np.where(used >= 0, np.take_along_axis(tree.count, np.maximum(used, 0), 1), 0)
        # Refinements of leaves from level k + 1 to k, by the reach of level 0 that it would take.
        reach = np.maximum(away, 1e-6)[:, None] / _STEP ** np.arange(depth - 1)
        order = np.argsort(reach, axis=None, kind="stable")
        more = (counts[:, :-1] - counts[:, 1:]).ravel()[order]
        beyond = np.flatnonzero(counts[:, -1].sum() + np.cumsum(more) > self.budget_splats)
        taken = order[: beyond[0]] if len(beyond) else order
        place = depth - 1 - np.bincount(taken // max(depth - 1, 1), minlength=len(away))
        levels: I64 = used[np.arange(len(away)), place]
        return levels


def streamed_sog_client(
    path: StrPath, budget_splats: int = BUDGET_SPLATS, *, limits: Limits | None = None
) -> StreamedSogClient:
    """Read a Streamed SOG scene, and return its client.

    Parameters
    ----------
    path : path
        A ``lod-meta.json``.
    budget_splats : int
    limits : Limits, optional
        Of the index and of each file.

    Raises
    ------
    FormatError
        ``sog-bad-levels``: a leaf names more splats than a file has.
    CogsplatError
        As `read_lod_meta` and `read_sog`.
    """
    tree = read_lod_meta(path, limits=limits)
    paths = [*tree.files, *([] if tree.environment is None else [tree.environment])]
    parts = [read_sog(part, limits=limits) for part in paths]
    has = np.array([*map(len, parts)])
    beyond = np.argwhere((tree.file >= 0) & (tree.start + tree.count > has[tree.file]))
    for leaf, level in beyond.tolist():
        end = int(tree.start[leaf, level] + tree.count[leaf, level])
        part = paths[int(tree.file[leaf, level])]
        raise FormatError(
            "sog-bad-levels",
            f"{os.fspath(path)}: leaf {leaf} ends at splat {end} of {part.parent.name}, expected "
            f"at most its {has[tree.file[leaf, level]]}",
        )
    degree = max(part.sh_degree for part in parts)
    parts = [_of_degree(part, degree) for part in parts]
    sizes = np.array(
        [sum(file.stat().st_size for file in sog_files(part)) for part in paths], np.int64
    )
    ends = np.cumsum([0, *map(len, parts)]).tolist()
    units = Units(
        kind=np.full(len(paths), int(SegmentKind.HEAD), np.int64),
        chunk=np.arange(len(paths), dtype=np.int64),
        end=tree.size_bytes + np.cumsum(sizes),
        size_bytes=sizes,
        after=[()] * len(paths),
        opening_bytes=tree.size_bytes,
    )
    rows = [slice(a, b) for a, b in pairwise(ends)]
    return StreamedSogClient(tree, concatenate(parts), rows, units, budget_splats)


def _of_degree(splats: Splats, degree: int) -> Splats:
    """Return a scene with SH of a degree no lower than its own, of which what it lacks is zero."""
    missing = sh_coefficients(degree) - sh_coefficients(splats.sh_degree)
    return replace(splats, shN=np.pad(splats.shN, ((0, 0), (0, missing), (0, 0))))


def _chosen(file: I64, levels: I64) -> I64:
    """Return the file of each leaf at a level of its own; -1 where it has none."""
    found: I64 = file[np.arange(len(file)), np.maximum(levels, 0)]
    return np.where(levels >= 0, found, -1)


def _used_level(file: I64, level: int) -> I64:
    """Return the level that each leaf shows where it should have this one; -1 for none."""
    depth = file.shape[1]
    found = np.full(len(file), -1, np.int64)
    for other in [*range(depth - 1, level, -1), *range(level), level]:
        found[file[:, other] >= 0] = other
    found[~(file[:, level:] >= 0).any(axis=1)] = -1
    return found


def _distances(boxes: F64, camera: Camera) -> F64:
    """Return how far the engine takes each box to be from a pose, in scene units, (n,)."""
    half = 0.5 * (boxes[:, 3:] - boxes[:, :3])
    excess = _SHRINK * np.maximum(half - np.median(half, axis=0), 0.0)
    eye = camera.position.astype(np.float64)
    near = np.clip(eye, boxes[:, :3] + excess, boxes[:, 3:] - excess) - eye
    away: F64 = np.sqrt((near * near).sum(axis=1))
    ahead = (near * camera.rotation[2]).sum(axis=1) / np.maximum(away, 1e-6)
    away *= 1.0 + (_BEHIND - 1.0) * np.maximum(-ahead, 0.0)
    return away
