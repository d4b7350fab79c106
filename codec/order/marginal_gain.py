"""The order by marginal gain: each stage adds the splats that lower the prefix's error most."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.executor import Executor, LocalThreads
from cogsplat.codec.geometry.frustum import NEAR
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.render.marginal_gains import marginal_gains
from cogsplat.codec.render.projection import project
from cogsplat.codec.render.shading import footprint_colours
from cogsplat.codec.scoring.contribution import Scores
from cogsplat.codec.scoring.reference_views import ReferenceViews, render_references
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import thread_count

from . import prefix_inflation
from .gain_effort import GainEffort

# First size of the prefix as a share of the scene.
_FIRST: Final = 1 / 8000
_MOST_FIRST: Final = 16
# Least growth in one stage once the prefix holds this share of the scene: what is still missing
# there is spread over the picture, and splats that join together are rarely redundant.
_LATE: Final = 0.25
_LATE_GROWTH: Final = 0.3
# Views in which gains are measured in one such stage, at most.
_LATE_VIEWS: Final = 12
# Candidates of a stage, in multiples of the prefix, and at least so many: the best by contribution,
# or by contribution times a power of the volume. Splats further down gain too little to be measured
# yet.
_POOL: Final = 8
_LEAST_POOL: Final = 4000
# Splats that are picked in one stage because the same part of the picture is missing are redundant.
# A stage therefore picks from a random share of the candidates only, so that it takes fewer for
# each such part, and the next stage measures what is still missing. This gives 0.5 dB at 10 to 20 %
# of a scene, and costs as much where nearly all splats are needed: it begins after so many stages
# and ends at this share of the scene.
_RANDOM_SHARE: Final = 0.45
_RANDOM_FROM: Final = 4
_RANDOM_UNTIL: Final = 0.25
# Exponent of the volume in the second choice of candidates, which favours large splats as the
# orders antimatter and sgss do.
_VOLUME: Final = 0.2


@dataclass(frozen=True)
class GainConfig:
    """Settings of the order by marginal gain.

    Parameters
    ----------
    inflated : bool
        Whether gains are measured with prefixes inflated as compensation will draw them
        (`prefix_inflation.typical`), which shows far more with few splats, or as they are.
    jitter : bool
        Also measure gains in jittered copies of the cameras (`view_sets.jitter`).
    threads : int
        0 for every core this process may use. The order does not depend on it.
    effort : GainEffort
        How much of the scene is ordered by gain, in what stages and views.
    """

    inflated: bool = True
    jitter: bool = True
    threads: int = 0
    effort: GainEffort = field(default_factory=GainEffort)

    def __post_init__(self) -> None:
        thread_count(self.threads)


@dataclass(frozen=True, eq=False)
class Pool:
    """Rows of a scene as they are drawn while gains are measured, without a copy of their colours.

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
    colours = footprint_colours(pool.scene, camera, footprints, rows=pool.rows)
    found, error = marginal_gains(footprints, colours, present[footprints.index], target)
    return footprints.index, found, error


def _places(priority: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return each row's place in the order of descending priority, ties in file order: (N,)."""
    places = np.empty(len(priority), np.int64)
    places[np.argsort(-priority, kind="stable")] = np.arange(len(priority))
    return places


@dataclass(frozen=True, eq=False)
class Stage:
    """What the gains of one stage are measured of.

    Parameters
    ----------
    rows : (n,) int32
        Of the scene, ascending.
    present : (n,) bool
        Those in the prefix.
    by : Inflation or None
        How they are inflated.
    """

    rows: NDArray[np.int32]
    present: NDArray[np.bool_]
    by: prefix_inflation.Inflation | None = None
    # Made where gains are measured, when it is first asked for: it is far larger than the rows.
    _made: dict[str, Pool] = field(default_factory=dict, init=False, repr=False)

    def pool(self, splats: Splats) -> Pool:
        """Return the pool of its rows; the same object every time."""
        made = self._made.get("pool")
        if made is None:
            made = self._made.setdefault("pool", pool_of(splats, self.rows, self.by))
        return made


def _view_gains(
    view: int, splats: Splats, references: ReferenceViews, stage: Stage
) -> tuple[NDArray[np.int32], NDArray[np.float64], float]:
    """Measure the gains of a stage in the reference view of a number."""
    return view_gains(
        stage.pool(splats),
        stage.present,
        references.cameras[view],
        references.pictures[view],
        kernel_px=references.kernels[view],
        near_plane=references.near_plane,
    )


def gains(
    splats: Splats,
    references: ReferenceViews,
    stage: Stage,
    views: Sequence[int],
    executor: Executor,
) -> NDArray[np.float64]:
    """Return the marginal gain of every splat of a stage: by how much it lowers the squared error.

    Parameters
    ----------
    splats : Splats
    references : ReferenceViews
    stage : Stage
        n splats.
    views : sequence of int
        Numbers of the reference views to measure in.
    executor : Executor
        What measures in single views. The gains do not depend on it.

    Returns
    -------
    (n,) float64
        Weighted sum over the views of the gain per pixel, summed over channels.
    """
    total = np.zeros(len(stage.rows), np.float64)
    found = executor.map(_view_gains, views, splats, references, stage)
    for view, (rows, gain, _) in zip(views, found, strict=True):
        camera = references.cameras[view]
        weight = references.weights[view]
        total[rows] += weight / (camera.width * camera.height) * gain
    return total


def gain_rows(
    splats: Splats,
    scores: Scores,
    references: ReferenceViews,
    config: GainConfig | None = None,
    *,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> NDArray[np.int64]:
    """Order a scene by marginal gain, measured in given reference views.

    Parameters
    ----------
    splats : Splats
    scores : Scores
        Of these splats.
    references : ReferenceViews
    config : GainConfig, optional
    executor : Executor, optional
        What runs the work of single views; threads of this process where it is not given.
    progress : Progress
        Called with ``("gain", splats placed, splats to place)``.

    Returns
    -------
    (N,) int64
        Rows of the scene, first to last; the same for any number of threads.

    Notes
    -----
    The prefix grows in stages. In each, the gain of every candidate is measured in a few views
    (`gains`), and the best of a random share of the candidates join. Contribution (PRoGS, section
    3.1) measures how much a splat weighs in a render of the *full* scene. In a prefix most of the
    splats that hide or overlap it are missing, so that it may matter more, or less.
    """
    config = config or GainConfig()
    executor = executor or LocalThreads(config.threads)
    count = len(splats)
    volume = np.exp(_VOLUME * splats.scales.astype(np.float64).sum(axis=1))
    by_contribution = _places(scores.contribution)
    place = np.minimum(by_contribution, _places(scores.contribution * volume))
    chosen = np.zeros(count, np.bool_)
    stages: list[NDArray[np.int64]] = []
    placed = 0
    effective_splats = prefix_inflation.effective_splats(scores.contribution)
    effort = config.effort
    until = int(effort.until * count)
    first = min(max(1, round(_FIRST * count)), _MOST_FIRST)
    rng = np.random.default_rng(0)
    progress("gain", 0, until)
    while placed < until:
        late = placed >= _LATE * count
        growth = max(effort.growth, _LATE_GROWTH) if late else effort.growth
        wanted = min(max(first, int(placed * growth)), until - placed)
        candidates = ~chosen & (place < max(_POOL * (placed + wanted), _LEAST_POOL))
        if len(stages) >= _RANDOM_FROM and placed + wanted < _RANDOM_UNTIL * count:
            part = candidates & (rng.random(count) < _RANDOM_SHARE)
            if part.sum() >= wanted:
                candidates = part
        # In file order: that is how memory is read fastest.
        rows = np.flatnonzero(chosen | candidates)
        present = chosen[rows]
        by = (
            prefix_inflation.typical((placed + wanted) / effective_splats)
            if config.inflated
            else None
        )
        most_views = min(effort.views, _LATE_VIEWS) if late else effort.views
        views = references.sample(most_views, len(stages))
        stage = Stage(rows.astype(np.int32), present, by)
        gain = gains(splats, references, stage, views, executor)
        gain[present] = -np.inf
        # Ties, such as splats that these views do not show, come by contribution.
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
    executor: Executor | None = None,
    progress: Progress = silent,
) -> NDArray[np.int64]:
    """Order a scene by marginal gain in the views of some cameras.

    Parameters
    ----------
    splats, scores, config, executor, progress
        As in `gain_rows`; progress also that of `reference_views.render_references`.
    cameras : sequence of Camera
        In the frame of the means. Without any, or without splats, the order is by contribution.
    references : ReferenceViews, optional
        Reference views of these cameras, if they have been rendered already; then
        `GainConfig.jitter` has no effect.

    Returns
    -------
    (N,) int64
    """
    config = config or GainConfig()
    if not cameras or not len(splats):
        return np.argsort(-scores.contribution, kind="stable").astype(np.int64)
    if references is None:
        references = render_references(
            splats,
            cameras,
            jittered=config.jitter,
            threads=config.threads,
            executor=executor,
            progress=progress,
        )
    return gain_rows(splats, scores, references, config, executor=executor, progress=progress)
