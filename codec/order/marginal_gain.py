"""The order by marginal gain: at every moment, the splats that the picture so far needs most."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.geometry.frustum import NEAR
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.render.marginal_gains import marginal_gains
from cogsplat.codec.render.projection import project
from cogsplat.codec.render.shading import footprint_colours
from cogsplat.codec.scoring.contribution import Scores
from cogsplat.codec.scoring.reference_views import ReferenceViews, render_references
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import ordered_map, thread_count

from . import prefix_inflation

# By how much a prefix grows in one stage, and what it begins with, as a share of the scene: the
# fewer splats at once, the less they are redundant among themselves. From the sweep on a captured
# room; finer stages are worth 0.2 dB and cost in proportion.
_GROWTH: Final = 0.16
_FIRST: Final = 1 / 8000
_MOST_FIRST: Final = 16
# Views looked at in one stage; the next looks at others.
_VIEWS: Final = 24
# Only so many times the prefix, the best by contribution or by contribution and size, are
# candidates: what is further back is not worth looking at yet.
_POOL: Final = 8
_LEAST_POOL: Final = 4000
# Splats picked at once for the same hole are redundant. A stage picks from a random part of the
# candidates only, so that it takes fewer of each hole; the next sees what is still missing. It is
# worth 0.5 dB at 10 to 20 % of a scene and costs as much where nearly all are needed.
_THINNED: Final = 0.45
_THIN_FROM: Final = 4
_THIN_UNTIL: Final = 0.25
# Beyond this share the rest are in order of contribution: nothing is left to choose.
_UNTIL: Final = 0.8
# Big splats first (antimatter, SGSS): the exponent of volume in the second choice of candidates.
_VOLUME: Final = 0.2


@dataclass(frozen=True)
class GainConfig:
    """How the order by gain is made.

    Parameters
    ----------
    inflated : bool
        Whether prefixes are made for being drawn with compensation (`prefix_inflation.typical`),
        which shows far more in few splats, or as they are.
    jitter : bool
        Also look from copies of the cameras that step back and turn.
    threads : int
        0 for every core this process may use. The order does not depend on it.
    """

    inflated: bool = True
    jitter: bool = True
    threads: int = 0

    def __post_init__(self) -> None:
        thread_count(self.threads)


@dataclass(frozen=True, eq=False)
class Pool:
    """Some splats of a scene as they are drawn while gains are measured, colours not copied.

    Parameters
    ----------
    scene : Splats
        Anti-aliased where its `info` says so.
    rows : (n,) int32
        Ascending.
    shapes : Splats
        Those rows, inflated where asked for, without higher SH coefficients and extra attributes.
    """

    scene: Splats
    rows: NDArray[np.int32]
    shapes: Splats


def pool_of(
    scene: Splats, rows: NDArray[np.integer], by: prefix_inflation.Inflation | None = None
) -> Pool:
    """Return some rows of a scene, ascending, inflated where `by` is given."""
    shapes = scene.without_extras().with_sh_degree(0).take(rows)
    inflated = shapes if by is None else prefix_inflation.inflate(shapes, by)
    return Pool(scene, rows.astype(np.int32), inflated)


def view_gains(
    pool: Pool,
    present: NDArray[np.bool_],
    camera: Camera,
    target: NDArray[np.float32],
    *,
    kernel_px: float,
    near_plane: float = NEAR,
) -> tuple[NDArray[np.int32], NDArray[np.float64], float]:
    """Measure the marginal gain of every splat of a pool in one view.

    Parameters
    ----------
    pool : Pool
        n splats.
    present : (n,) bool
        Those in the picture.
    camera : Camera
        In the frame of the means.
    target : (H, W, 3) float32
        What the picture should be, over black, in the scene's colour space.
    kernel_px : float
        Variance added to projected covariances, px².
    near_plane : float
        Means at or before this camera-space depth are not drawn, scene units.

    Returns
    -------
    rows : (M,) int32
        Places in the pool of splats whose footprint reaches the image.
    gains : (M,) float64
    error : float
        As `marginal_gains` returns them.
    """
    footprints = project(
        pool.shapes,
        camera,
        kernel_px=kernel_px,
        antialiased=pool.scene.info.antialiased,
        near_plane=near_plane,
    )
    colours = footprint_colours(pool.scene, pool.rows, camera, footprints)
    found, error = marginal_gains(footprints, colours, present[footprints.index], target)
    return footprints.index, found, error


def _places(priority: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the place of every row in descending order, ties in file order."""
    places = np.empty(len(priority), np.int64)
    places[np.argsort(-priority, kind="stable")] = np.arange(len(priority))
    return places


def gains(
    pool: Pool,
    present: NDArray[np.bool_],
    references: ReferenceViews,
    views: Sequence[int],
    threads: int,
) -> NDArray[np.float64]:
    """Return by how much each splat would lower the mean squared error, summed over views.

    Parameters
    ----------
    pool : Pool
        n splats.
    present : (n,) bool
    references : ReferenceViews
    views : sequence of int
        Of the reference views.
    threads : int
        At least 1. The gains do not depend on it.

    Returns
    -------
    (n,) float64
        Weighted as the reference views are; per pixel, summed over channels.
    """
    total = np.zeros(len(pool.rows), np.float64)
    found = ordered_map(
        lambda view: view_gains(
            pool,
            present,
            references.cameras[view],
            references.pictures[view],
            kernel_px=references.kernels[view],
            near_plane=references.near_plane,
        ),
        views,
        threads,
    )
    for view, (rows, gain, _) in zip(views, found, strict=True):
        camera = references.cameras[view]
        total[rows] += references.weights[view] / (camera.width * camera.height) * gain
    return total


def gain_rows(
    splats: Splats,
    scores: Scores,
    references: ReferenceViews,
    config: GainConfig | None = None,
    *,
    progress: Progress = silent,
) -> NDArray[np.int64]:
    """Order a scene by marginal gain.

    Parameters
    ----------
    splats : Splats
    scores : Scores
        Of these splats.
    references : ReferenceViews
        What prefixes are compared with.
    config : GainConfig, optional
    progress : Progress
        Called with ``("gain", splats placed, splats to place)``.

    Returns
    -------
    (N,) int64
        Rows of the scene, first to last; the same for any number of threads.

    Notes
    -----
    In stages of growing size. One walk over the pixels of a few views tells for every candidate
    what adding it alone would do for the picture (`view_gains`); the best of a random
    part of them join. Contribution (PRoGS, section 3.1) measures what a splat adds to the *full*
    picture, where others stand before it and share its work; a prefix is another picture.
    """
    config = config or GainConfig()
    threads = thread_count(config.threads)
    count = len(splats)
    volume = np.exp(_VOLUME * splats.scales.astype(np.float64).sum(axis=1))
    by_contribution = _places(scores.contribution)
    place = np.minimum(by_contribution, _places(scores.contribution * volume))
    chosen = np.zeros(count, np.bool_)
    stages: list[NDArray[np.int64]] = []
    placed = 0
    effective_splats = prefix_inflation.effective_splats(scores.contribution)
    until = int(_UNTIL * count)
    first = min(max(1, round(_FIRST * count)), _MOST_FIRST)
    rng = np.random.default_rng(0)
    progress("gain", 0, until)
    while placed < until:
        wanted = min(max(first, int(placed * _GROWTH)), until - placed)
        candidates = ~chosen & (place < max(_POOL * (placed + wanted), _LEAST_POOL))
        if len(stages) >= _THIN_FROM and placed + wanted < _THIN_UNTIL * count:
            part = candidates & (rng.random(count) < _THINNED)
            if part.sum() >= wanted:
                candidates = part
        # In file order, in which memory is read fastest.
        rows = np.flatnonzero(chosen | candidates)
        present = chosen[rows]
        by = (
            prefix_inflation.typical((placed + wanted) / effective_splats)
            if config.inflated
            else None
        )
        views = references.sample(_VIEWS, len(stages))
        gain = gains(pool_of(splats, rows, by), present, references, views, threads)
        gain[present] = -np.inf
        # Ties, such as splats that these views do not show, are in order of contribution.
        picked = rows[np.lexsort((by_contribution[rows], -gain))[:wanted]]
        stages.append(picked)
        chosen[picked] = True
        placed += wanted
        progress("gain", placed, until)
    rest = np.flatnonzero(~chosen)
    rest = rest[np.argsort(by_contribution[rest])]
    return np.concatenate([*stages, rest]).astype(np.int64)


def gain_order(
    splats: Splats,
    scores: Scores,
    cameras: Sequence[Camera],
    config: GainConfig | None = None,
    *,
    references: ReferenceViews | None = None,
    progress: Progress = silent,
) -> NDArray[np.int64]:
    """Order a scene by marginal gain, drawing it from some cameras first unless that was done.

    Parameters
    ----------
    splats, scores, config, progress
        As `gain_rows`; progress also of `reference_views.render_references`.
    cameras : sequence of Camera
        In the frame of the means. Without any, or without splats, the order is by contribution.
    references : ReferenceViews, optional
        The scene in views of these cameras, where it has been drawn; then `GainConfig.jitter` does
        not count.

    Returns
    -------
    (N,) int64
    """
    config = config or GainConfig()
    if not cameras or not len(splats):
        return np.argsort(-scores.contribution, kind="stable").astype(np.int64)
    if references is None:
        references = render_references(
            splats, cameras, jittered=config.jitter, threads=config.threads, progress=progress
        )
    return gain_rows(splats, scores, references, config, progress=progress)
