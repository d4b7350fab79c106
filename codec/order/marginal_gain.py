"""Order by marginal gain: each stage adds the splats that lower the prefix's error most."""

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

# Size of the first stage as a share of the scene, and at most.
_FIRST: Final = 1 / 8000
_MAX_FIRST: Final = 16
# Minimum growth of a stage once the prefix holds this share of the scene. Missing splats are then
# spread over the picture, and splats that join together are rarely redundant.
_LATE: Final = 0.25
_LATE_GROWTH: Final = 0.3
# Views at most in which such a late stage measures gains.
_LATE_VIEWS: Final = 12
# Number of candidates of a stage relative to the prefix, and at least: the best by contribution,
# and by contribution times a power of the volume. Splats further down gain too little for now.
_CANDIDATES: Final = 8
_MIN_CANDIDATES: Final = 4000
# Splats that one stage picks for the same missing part of the picture are redundant. A stage
# therefore picks from a random share of the candidates, and the next stage measures what is still
# missing. This gains 0.5 dB at 10 to 20 % of a scene and loses as much at both ends, so it starts
# after this number of stages and stops at this share of the scene.
_RANDOM_SHARE: Final = 0.45
_RANDOM_FROM: Final = 4
_RANDOM_UNTIL: Final = 0.25
# Exponent of the volume in the second ranking of candidates, which favours large splats like the
# orders antimatter and sgss.
_VOLUME: Final = 0.2


@dataclass(frozen=True)
class GainConfig:
    """Settings of the order by marginal gain.

    Parameters
    ----------
    inflated : bool
        Whether prefixes are inflated as compensation will draw them
        (`prefix_inflation.best_inflation`) when gains are measured. Inflated prefixes show far
        more with few splats.
    jitter : bool
        Whether to measure gains in jittered copies of the cameras too (`roam_views.jitter`).
    threads : int
        Number of threads; 0 for every core this process may use. The order does not depend on it.
    effort : GainEffort
        Share of the effective splats ordered by gain, and size and views of each stage.
    """

    inflated: bool = True
    jitter: bool = True
    threads: int = 0
    effort: GainEffort = field(default_factory=GainEffort)

    def __post_init__(self) -> None:
        thread_count(self.threads)


@dataclass(frozen=True, eq=False)
class StageSplats:
    """Splats that one stage of `gain_order` draws: the prefix and its candidates.

    SH coefficients are read from the scene, without a copy.

    Parameters
    ----------
    scene : Splats
        Whole scene.
    rows : (n,) int32
        Rows of the stage's splats in the scene, ascending.
    shapes : Splats
        Splats of the stage, possibly inflated, of SH degree 0 and without extra attributes.
    """

    scene: Splats
    rows: NDArray[np.int32]
    shapes: Splats


def stage_splats(
    scene: Splats, rows: NDArray[np.integer], inflation: prefix_inflation.Inflation | None = None
) -> StageSplats:
    """Select the splats that a stage draws, by ascending rows; `inflation` enlarges each splat."""
    shapes = scene.without_extras().with_sh_degree(0).take(rows)
    inflated = shapes if inflation is None else prefix_inflation.inflate(shapes, inflation)
    return StageSplats(scene, rows.astype(np.int32), inflated)


def view_gains(
    splats: StageSplats,
    present: NDArray[np.bool_],
    camera: Camera,
    target: NDArray[np.float32],
    *,
    reduction: float = 1.0,
    near_plane: float = NEAR,
) -> tuple[NDArray[np.int32], NDArray[np.float64], float]:
    """Measure the marginal gain of every splat of a stage in one view.

    Parameters
    ----------
    splats : StageSplats
        Prefix and candidates: n splats.
    present : (n,) bool
        Mask of the prefix, whose splats are in the picture.
    camera : Camera
        Camera in the frame of the means.
    target : (H, W, 3) float32
        Picture of the whole scene over black, in the scene's colour space.
    reduction : float
        See `projection.project`.
    near_plane : float
        Camera-space depth up to which nothing is drawn, scene units.

    Returns
    -------
    rows : (M,) int32
        Rows of `splats.shapes` whose footprint reaches the image.
    gains : (M,) float64
        Marginal gains of these splats; see `marginal_gains`.
    error : float
        Squared error of the picture; see `marginal_gains`.
    """
    footprints = project(splats.shapes, camera, reduction=reduction, near_plane=near_plane)
    colours = footprint_colours(splats.scene, camera, footprints, rows=splats.rows)
    size = camera.width, camera.height
    found, error = marginal_gains(footprints, colours, present[footprints.index], size, target)
    return footprints.index, found, error


def _ranks(priority: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return each row's rank by descending priority, ties in file order: (N,)."""
    ranks = np.empty(len(priority), np.int64)
    ranks[np.argsort(-priority, kind="stable")] = np.arange(len(priority))
    return ranks


@dataclass(frozen=True, eq=False)
class Stage:
    """Prefix and candidates of one stage, as sent to the workers that measure gains.

    Parameters
    ----------
    rows : (n,) int32
        Rows of the prefix and the candidates in the scene, ascending.
    present : (n,) bool
        Mask of the rows that belong to the prefix; the rest are candidates.
    inflation : Inflation or None
        Offsets of all rows' log scales and opacities.
    """

    rows: NDArray[np.int32]
    present: NDArray[np.bool_]
    inflation: prefix_inflation.Inflation | None = None
    # Built by each worker on first use: the splats are far larger than their row numbers.
    _cache: dict[str, StageSplats] = field(default_factory=dict, init=False, repr=False)

    def splats(self, scene: Splats) -> StageSplats:
        """Return the prefix and candidates as splats of `scene`, selected at the first call."""
        found = self._cache.get("splats")
        if found is None:
            found = stage_splats(scene, self.rows, self.inflation)
            found = self._cache.setdefault("splats", found)
        return found


def _view_gains(
    view: int, splats: Splats, references: ReferenceViews, stage: Stage
) -> tuple[NDArray[np.int32], NDArray[np.float64], float]:
    """Measure the gains of a stage in reference view number `view`."""
    return view_gains(
        stage.splats(splats),
        stage.present,
        references.cameras[view],
        references.pictures[view],
        reduction=references.reductions[view],
        near_plane=references.near_plane,
    )


def gains(
    splats: Splats,
    references: ReferenceViews,
    stage: Stage,
    views: Sequence[int],
    executor: Executor,
) -> NDArray[np.float64]:
    """Return the marginal gain of every splat of a stage: the drop of squared error that it gives.

    Parameters
    ----------
    splats : Splats
        Whole scene.
    references : ReferenceViews
        Reference views of the scene.
    stage : Stage
        Stage with n splats.
    views : sequence of int
        Numbers of the reference views to measure in.
    executor : Executor
        Executor of the work on single views. Gains do not depend on it.

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
        Scene to order.
    scores : Scores
        Scores of these splats.
    references : ReferenceViews
        Reference views of the scene.
    config : GainConfig, optional
        Settings; None for the defaults.
    executor : Executor, optional
        Executor of the work on single views; by default threads of this process.
    progress : Progress
        Called with ``("gain", splats ordered, splats to order)``.

    Returns
    -------
    (N,) int64
        Rows of the scene, first to last; independent of the number of threads.

    Notes
    -----
    The prefix grows in stages. Each stage measures the gain of every candidate in a few views
    (`gains`), and the best of a random share of the candidates join the prefix. Contribution
    (PRoGS, section 3.1) measures the weight of a splat in a render of the *full* scene. In a prefix
    most splats that hide or overlap it are missing, so its effect may be larger or smaller.
    """
    config = config or GainConfig()
    executor = executor or LocalThreads(config.threads)
    count = len(splats)
    volume = np.exp(_VOLUME * splats.scales.astype(np.float64).sum(axis=1))
    by_contribution = _ranks(scores.contribution)
    best_rank = np.minimum(by_contribution, _ranks(scores.contribution * volume))
    chosen = np.zeros(count, np.bool_)
    stages: list[NDArray[np.int64]] = []
    placed = 0
    effective_splats = prefix_inflation.effective_splats(scores.contribution)
    effort = config.effort
    until = min(max(int(effort.ordered_ratio * effective_splats), 1), count)
    first = min(max(1, round(_FIRST * count)), _MAX_FIRST)
    rng = np.random.default_rng(0)
    progress("gain", 0, until)
    while placed < until:
        late = placed >= _LATE * count
        growth = max(effort.growth, _LATE_GROWTH) if late else effort.growth
        size = min(max(first, int(placed * growth)), until - placed)
        candidates = ~chosen & (best_rank < max(_CANDIDATES * (placed + size), _MIN_CANDIDATES))
        if len(stages) >= _RANDOM_FROM and placed + size < _RANDOM_UNTIL * count:
            part = candidates & (rng.random(count) < _RANDOM_SHARE)
            if part.sum() >= size:
                candidates = part
        # In file order, which reads memory fastest.
        rows = np.flatnonzero(chosen | candidates)
        present = chosen[rows]
        inflation = (
            prefix_inflation.best_inflation((placed + size) / effective_splats)
            if config.inflated
            else None
        )
        num_views = min(effort.views, _LATE_VIEWS) if late else effort.views
        views = references.sample(num_views, len(stages))
        stage = Stage(rows.astype(np.int32), present, inflation)
        gain = gains(splats, references, stage, views, executor)
        gain[present] = -np.inf
        # Ties, such as splats outside the sampled views, are ordered by contribution.
        picked = rows[np.lexsort((by_contribution[rows], -gain))[:size]]
        stages.append(picked)
        chosen[picked] = True
        placed += size
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
    """Order a scene by marginal gain in the views of given cameras.

    Parameters
    ----------
    splats, scores, config, executor, progress
        See `gain_rows`; `reference_views.render_references` also reports to `progress`.
    cameras : sequence of Camera
        Cameras in the frame of the means. Without cameras the order is by contribution.
    references : ReferenceViews, optional
        Reference views of these cameras if already rendered; `GainConfig.jitter` is then ignored.

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
