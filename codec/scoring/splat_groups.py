"""Groups of splats that lie close together, and the share of each view's picture that each fills.

Regions, the parts of a scene that different views see, are made of whole groups.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.executor import Executor
from cogsplat.codec.geometry.morton import spatial_order
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.splats import Splats
from cogsplat.codec.workspace import IN_MEMORY, Workspace

from .chunk_contributions import chunk_contributions

F64 = NDArray[np.float64]

# Splats of a group, and groups at most: shares of all groups in all views have to fit into memory.
_GROUP_SPLATS: Final = 256
_MOST_GROUPS: Final = 16_384

# Groups between two trims of a workspace that maps files.
_GROUPS_PER_TRIM: Final = 16


@dataclass(frozen=True, eq=False)
class SplatGroups:
    """Groups of a scene of N splats.

    Parameters
    ----------
    numbers : (N,) int32
        Number of each splat's group.
    centres : (g, 3) float64
        Mean of the means of each group, scene units.
    """

    numbers: NDArray[np.int32]
    centres: F64

    def __len__(self) -> int:
        return len(self.centres)


@dataclass(frozen=True, eq=False)
class GroupShares:
    """Shares of groups of splats in the pictures of V views.

    Parameters
    ----------
    groups : SplatGroups
        The g groups.
    shares : (V, g) float64
        Sum of the blending weights of each group's splats over the pixels of a view, divided by the
        number of pixels: 0 to 1. A `Scorer` leaves out weights below `ScoreConfig.least_weight`.
    """

    groups: SplatGroups
    shares: F64


def group_splats(means: NDArray[np.float32], workspace: Workspace = IN_MEMORY) -> SplatGroups:
    """Cut the splats in Morton order into groups: of 256, or more in scenes above 4 million.

    Parameters
    ----------
    means : (N, 3) float32
        Means of the splats, scene units.
    workspace : Workspace
        Allocator of long arrays.

    Examples
    --------
    >>> import numpy as np
    >>> from cogsplat.codec.scoring.splat_groups import group_splats
    >>> groups = group_splats(np.random.default_rng(0).normal(size=(1000, 3)).astype(np.float32))
    >>> len(groups), np.bincount(groups.numbers).tolist()
    (4, [250, 250, 250, 250])
    """
    count = max(1, min(-(-len(means) // _GROUP_SPLATS), _MOST_GROUPS))
    order = workspace.zeros((len(means),), np.int64)
    order[:] = spatial_order(means)
    bounds = np.linspace(0, len(order), count + 1).astype(np.int64)
    numbers = workspace.zeros((len(order),), np.int32)
    centres = np.zeros((count, 3))
    for number, (start, stop) in enumerate(pairwise(bounds.tolist())):
        rows = order[start:stop]
        if number % _GROUPS_PER_TRIM == 0:
            workspace.trim()
        numbers[rows] = number
        if len(rows):
            centres[number] = means[rows].mean(axis=0, dtype=np.float64)
    return SplatGroups(numbers, centres)


def measure_shares(
    splats: Splats,
    cameras: Sequence[Camera],
    *,
    workspace: Workspace = IN_MEMORY,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> GroupShares:
    """Measure the shares of groups in small pictures, for a scene whose scores are given.

    A `Scorer` records them as it scores.

    Parameters
    ----------
    splats : Splats
        Scene of N splats.
    cameras : sequence of Camera
        Views of the scene, in the frame of the means.
    workspace : Workspace
        Allocator of long arrays.
    executor : Executor, optional
        Executor of the work on single views; by default threads of this process.
    progress : Progress
        Called with ``("regions", views done, views)``.
    """
    groups = group_splats(splats.means, workspace)
    shares = chunk_contributions(
        splats,
        groups.numbers,
        len(groups),
        cameras,
        workspace=workspace,
        executor=executor,
        progress=lambda _, done, views: progress("regions", done, views),
    )
    return GroupShares(groups, shares)
