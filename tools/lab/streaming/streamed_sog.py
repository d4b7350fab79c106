"""Client of Streamed SOG with the level selection and fetch order of PlayCanvas' viewer.

The rules model PlayCanvas' engine 2.23 (``gsplat-octree-instance``, ``gsplat-asset-loader``,
``gsplat-budget-balancer``) as configured by SuperSplat's viewer 1.36:

- Each leaf of the tree shows one level at a time. The coarsest level of all leaves is fetched
  first, then the target level of each leaf; levels in between are skipped.
- If the budget allows the finest level everywhere, it is the target of all leaves. Otherwise leaves
  are refined by distance within the budget. Each level reaches `_LEVEL_REACH` times as far as the
  next finer one.
- Files for leaves that show nothing come before files that replace a level. Within each group
  coarser files come first, then those of nearer leaves.
- The distance is that from the camera to the leaf's box. Boxes larger than the median are shrunk by
  3/4 of the excess. Directly behind the camera the distance counts five times.

The model favours the peer: images do not wait for their ``meta.json``, files follow each other
without a pause, and decoding takes no time.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Sequence
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
"""Default splat budget of SuperSplat's viewer 1.36 on a desktop."""

# Engine 2.23: `lodMultiplier` and `lodDistanceShrink`. Viewer 1.36: `lodBehindPenalty`.
_LEVEL_REACH: Final = 3.0
_BOX_SHRINK: Final = 0.75
_BEHIND_PENALTY: Final = 5.0
# Priority tiers: first files for leaves that show nothing, then files that replace a level.
_FIRST_TIER: Final = 2.0
_REPLACEMENT_TIER: Final = 1.0


@dataclass(frozen=True, eq=False)
class StreamedSogClient:
    """Client of a Streamed SOG scene.

    Parameters
    ----------
    tree : StreamedSog
        Tree of the leaves and their levels.
    scene : Splats
        Splats of all files in sequence, the environment last.
    rows : list of slice
        Rows of `scene` in each file.
    units : Units
        One unit and chunk per file, in the order of the index.
    budget_splats : int
        Limit on drawn splats; the coarsest level is drawn even if it exceeds the limit.
    """

    tree: StreamedSog
    scene: Splats
    rows: list[slice]
    units: Units
    budget_splats: int

    def priorities(self, camera: Camera, _: Collection[int] = ()) -> F64:
        """Return the priority of each file at a pose; 0 for files that no leaf needs."""
        tree, priorities = self.tree, np.zeros(len(self.rows))
        if tree.environment is not None:
            priorities[-1] = _FIRST_TIER + 1.0
        distance = _distances(tree.boxes, camera)
        nearness = 1.0 / (1.0 + distance * distance)
        depth = tree.file.shape[1]
        target = self._target_levels(distance)
        tiers = ((_FIRST_TIER, np.full(len(target), depth - 1)), (_REPLACEMENT_TIER, target))
        for tier, levels in tiers:
            leaves = np.flatnonzero(_files_at(tree.file, levels) >= 0)
            urgency = tier + (levels[leaves] + nearness[leaves]) / depth
            np.maximum.at(priorities, _files_at(tree.file, levels)[leaves], urgency)
        return priorities

    def splats_of(self, present: Sequence[int], camera: Camera) -> Splats:
        """Return the splats drawn at a pose from the received files.

        A leaf without its target level shows the next coarser one received, else the next finer.
        """
        tree = self.tree
        has = np.zeros(len(self.rows), np.bool_)
        has[list(present)] = True
        target = self._target_levels(_distances(tree.boxes, camera))
        depth = tree.file.shape[1]
        rows = [np.zeros(0, np.int64)]
        if tree.environment is not None and has[-1]:
            rows.append(np.arange(self.rows[-1].start, self.rows[-1].stop))
        for leaf in np.flatnonzero(target >= 0).tolist():
            level = int(target[leaf])
            for other in [*range(level, depth), *range(level - 1, -1, -1)]:
                file = int(tree.file[leaf, other])
                if file >= 0 and has[file]:
                    first = self.rows[file].start + int(tree.start[leaf, other])
                    rows.append(np.arange(first, first + int(tree.count[leaf, other])))
                    break
        return self.scene.take(np.concatenate(rows))

    def _target_levels(self, distance: F64) -> I64:
        """Return the target level of each leaf; -1 for leaves without splats."""
        tree = self.tree
        depth = tree.file.shape[1]
        # Leaves without splats at a level use the next finer level, else the next coarser one. A
        # leaf is omitted at a level if it only has finer ones.
        used = np.stack([_used_level(tree.file, level) for level in range(depth)], axis=1)
        counts = np.where(used >= 0, np.take_along_axis(tree.count, np.maximum(used, 0), 1), 0)
        # Refinements of leaves from level k + 1 to k, ordered by the reach of level 0 they require.
        reach = np.maximum(distance, 1e-6)[:, None] / _LEVEL_REACH ** np.arange(depth - 1)
        order = np.argsort(reach, axis=None, kind="stable")
        growth = (counts[:, :-1] - counts[:, 1:]).ravel()[order]
        beyond = np.flatnonzero(counts[:, -1].sum() + np.cumsum(growth) > self.budget_splats)
        accepted = order[: beyond[0]] if len(beyond) else order
        place = depth - 1 - np.bincount(accepted // max(depth - 1, 1), minlength=len(distance))
        levels: I64 = used[np.arange(len(distance)), place]
        return levels


def streamed_sog_client(
    path: StrPath, budget_splats: int = BUDGET_SPLATS, *, limits: Limits | None = None
) -> StreamedSogClient:
    """Read a Streamed SOG scene and create its client.

    Parameters
    ----------
    path : path
        Path of ``lod-meta.json``.
    budget_splats : int
        Limit on drawn splats.
    limits : Limits, optional
        Limits for reading the index and each file.

    Raises
    ------
    FormatError
        ``sog-bad-levels``: a leaf refers to splats beyond the end of a file.
    CogsplatError
        Errors of `read_lod_meta` and `read_sog`.
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
    parts = [_pad_degree(part, degree) for part in parts]
    sizes = np.array(
        [sum(file.stat().st_size for file in sog_files(part)) for part in paths], np.int64
    )
    ends = np.cumsum([0, *map(len, parts)]).tolist()
    units = Units(
        kind=np.full(len(paths), int(SegmentKind.HEAD), np.int64),
        row=np.arange(len(paths), dtype=np.int64),
        end=tree.size_bytes + np.cumsum(sizes),
        size_bytes=sizes,
        dependencies=[()] * len(paths),
        index_bytes=tree.size_bytes,
    )
    rows = [slice(a, b) for a, b in pairwise(ends)]
    return StreamedSogClient(tree, concatenate(parts), rows, units, budget_splats)


def _pad_degree(splats: Splats, degree: int) -> Splats:
    """Pad the SH coefficients of a scene with zeros to a higher degree."""
    missing = sh_coefficients(degree) - sh_coefficients(splats.sh_degree)
    return replace(splats, shN=np.pad(splats.shN, ((0, 0), (0, missing), (0, 0))))


def _files_at(file: I64, levels: I64) -> I64:
    """Look up the file of each leaf at its level; -1 for none."""
    found: I64 = file[np.arange(len(file)), np.maximum(levels, 0)]
    return np.where(levels >= 0, found, -1)


def _used_level(file: I64, level: int) -> I64:
    """Return the level that each leaf shows when a level is its target; -1 for none."""
    depth = file.shape[1]
    found = np.full(len(file), -1, np.int64)
    for other in [*range(depth - 1, level, -1), *range(level), level]:
        found[file[:, other] >= 0] = other
    found[~(file[:, level:] >= 0).any(axis=1)] = -1
    return found


def _distances(boxes: F64, camera: Camera) -> F64:
    """Return the distance of each box from a camera by the engine's metric, scene units, (n,)."""
    half = 0.5 * (boxes[:, 3:] - boxes[:, :3])
    excess = _BOX_SHRINK * np.maximum(half - np.median(half, axis=0), 0.0)
    eye = camera.position.astype(np.float64)
    offset = np.clip(eye, boxes[:, :3] + excess, boxes[:, 3:] - excess) - eye
    distance: F64 = np.sqrt((offset * offset).sum(axis=1))
    ahead = (offset * camera.rotation[2]).sum(axis=1) / np.maximum(distance, 1e-6)
    distance *= 1.0 + (_BEHIND_PENALTY - 1.0) * np.maximum(-ahead, 0.0)
    return distance
