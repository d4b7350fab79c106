"""Scores of splats: sums of their blending weights in a set of views (PRoGS, section 3.1)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError
from cogsplat.codec.executor import Executor, LocalThreads
from cogsplat.codec.finite_fields import require_finite
from cogsplat.codec.geometry.frustum import NEAR
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.render.blend_weights import PEAK, SQUARE, add_weights
from cogsplat.codec.render.cuda_device import require_device
from cogsplat.codec.render.cuda_views import CudaScene
from cogsplat.codec.render.projection import Footprints, project
from cogsplat.codec.render.sensitivities import (
    COLUMNS,
    PAIRS_AT_ONCE,
    Sensitivities,
    add_moments,
    from_columns,
    view_sensitivities,
)
from cogsplat.codec.render.shading import footprint_colours
from cogsplat.codec.render.tiles import TileLists, tile_lists
from cogsplat.codec.splats import MAX_SH_DEGREE, Splats, sh_coefficients
from cogsplat.codec.threads import thread_count
from cogsplat.codec.views.view_sets import jitter
from cogsplat.codec.workspace import IN_MEMORY, Gather, Workspace

from .view_sums import ViewSums, add_rows, sort_by_row

_BASES = sh_coefficients(MAX_SH_DEGREE)

TOP_K = 20
"""Number of a pixel's largest weights that count (PRoGS, section 3.1, Zoomers et al. 2024)."""

LEAST_WEIGHT = 0.01
"""`ScoreConfig.least_weight` for scoring without top K; the 20th weight is at most 1/20.

Ordered by either contribution, a captured room differs by less than 0.2 dB in its first 16 to 256
KiB, and files of three scenes by less than 0.5 % in bytes at equal PSNR.
"""

COVERING_SHARE = 1 / 4
"""Factor on the weights of covering views in `Scores.peak`."""

COVERING_ENERGY = 1 / 48
"""Factor on the energies of covering views.

Covering views show parts that an orbit misses, where viewers seldom are. With factors of 1/3 on
peaks and 1/9 on energies, two trained figures show 0.2 dB less around them in as many bytes. The
worst view of one from below has 36.7 dB with the factors here, 37.8 dB with those, and 31.3 dB
without covering views.
"""

MAX_VIEW_PARALLEL_SPLATS = 2_000_000
"""Splats of a scene up to which every core scores its own view; larger scenes share the cores.

The sums of one view take up to 0.4 kB for each splat in it.
"""


@dataclass(frozen=True)
class ScoreConfig:
    """Settings of `score`.

    Parameters
    ----------
    top_k : int
        Number of the largest weights of each pixel that count in the contribution. 0 counts all
        weights of at least `least_weight`, which is faster.
    least_weight : float
        Minimum of the weights that count in the contribution, 0 to 1; ignored unless `top_k` is 0.
    jitter : bool
        Whether to score jittered copies of the cameras too (`view_sets.jitter`), so that splats
        hidden from the capture path do not score 0.
    jitter_copies : int
        Jittered copies of each camera: 2 for both kinds, 1 for alternating kinds.
    near_plane : float
        Camera-space depth up to which nothing is drawn, scene units.
    threads : int
        Number of threads; 0 for every core this process may use. Scores do not depend on it.
    sensitivity_every : int
        Interval of the views in which `Sensitivities` are measured: every n-th view; 0 for none.
        At 1 they double the run time.
    colour_sensitivity : bool
        Whether to compute `Scores.colour_sensitivity`, which takes 128 bytes per splat.
    device : str
        ``cpu``, or ``cuda`` to draw the views with gsplat on a CUDA device (extra ``train``). CUDA
        scores differ by rounding, from run to run too, and so does the order of splats with nearly
        equal scores.
    """

    top_k: int = TOP_K
    least_weight: float = 0.0
    jitter: bool = True
    jitter_copies: int = 2
    near_plane: float = NEAR
    threads: int = 0
    sensitivity_every: int = 0
    colour_sensitivity: bool = True
    device: str = "cpu"

    def __post_init__(self) -> None:
        require_finite(self)
        if self.top_k < 0:
            raise ValueError(f"top_k {self.top_k}, expected 0 (all) or more")
        if not 0.0 <= self.least_weight <= 1.0:
            raise ValueError(f"least_weight {self.least_weight}, expected 0 to 1")
        if self.jitter_copies not in (1, 2):
            raise ValueError(f"jitter_copies {self.jitter_copies}, expected 1 or 2")
        if not self.near_plane > 0.0:
            raise ValueError(f"near_plane {self.near_plane}, expected more than 0")
        thread_count(self.threads)
        require_device(self.device)
        if self.sensitivity_every < 0:
            raise ValueError(
                f"sensitivity_every {self.sensitivity_every}, expected 0 (none) or more"
            )


@dataclass(frozen=True, eq=False, repr=False)
class Scores:
    """Statistics of each splat's blending weights w = T·alpha over the pixels of a set of views.

    Parameters
    ----------
    contribution : (N,) float64
        Sum of w over a view's pixels, px, averaged over the given views (PRoGS, section 3.1). With
        jitter, the average over the jittered copies is added. Only weights selected by
        `ScoreConfig.top_k` or `ScoreConfig.least_weight` count.
    colour_sensitivity : (N,) float64
        Sum over pixels of the absolute derivative of a colour channel, before clamping, w.r.t. one
        SH coefficient of the splat, divided by the number of pixels (Niedermayr et al. 2024,
        section 3.1). For the SH basis Y this is ``|Y| · Σw``, summed over views. The value is the
        maximum over the bases. With jitter, given and jittered views count half each. If
        `ScoreConfig.top_k` drops weights, the value is a lower bound. Zeros unless
        `ScoreConfig.colour_sensitivity` is set.
    energy : (N,) float64
        Sum of w² over all weights, per pixel of the views: a colour error Δ of the splat alone
        costs ``energy · Δ²`` of mean squared error. With jitter, given and jittered views count
        half each.
    largest_energy : (N,) float64
        Largest energy in a single view, Σw² per pixel of that view: the cost of a colour error in
        the view that shows the splat best. That of a covering view counts times `COVERING_ENERGY`.
    peak : (N,) float32
        Largest w in any pixel of any view. Weights in covering views count times `COVERING_SHARE`.
    seen : (N,) int32
        Number of views, covering views included, in which the splat was blended into a pixel.
    covered : (N,) int32
        Number of views, covering views included, that the splat's footprint reaches, hidden or not.
    basis_mean : (N, 15) float32
        SH bases above DC in the viewing directions of a splat: energy-weighted mean over its views;
        zeros if no view sees it.
    basis_spread : (15, 15) float64
        Covariance of these bases over the views of one splat, as the energy-weighted mean of every
        eighth splat. It gives the cost of an error of shN that sh0 cannot compensate.
    num_pixels : int
        Number of pixels of all views, jittered and covering views included.
    sensitivities : Sensitivities or None
        Costs of errors of the stored values; None if `ScoreConfig.sensitivity_every` is 0.
    """

    contribution: NDArray[np.float64]
    colour_sensitivity: NDArray[np.float64]
    energy: NDArray[np.float64]
    largest_energy: NDArray[np.float64]
    peak: NDArray[np.float32]
    seen: NDArray[np.int32]
    covered: NDArray[np.int32]
    basis_mean: NDArray[np.float32]
    basis_spread: NDArray[np.float64]
    num_pixels: int
    sensitivities: Sensitivities | None = None

    def __repr__(self) -> str:
        seen = int(np.count_nonzero(self.seen))
        return f"Scores({len(self.seen):,} splats, {seen:,} seen, {self.num_pixels:,} pixels)"

    def take(self, rows: NDArray[np.int64], gather: Gather = IN_MEMORY.gather) -> Scores:
        """Return the scores of the splats `rows`, copied by `gather` (see `Workspace.gather`)."""
        found = self.sensitivities
        return replace(
            self,
            contribution=gather(self.contribution, rows),
            colour_sensitivity=gather(self.colour_sensitivity, rows),
            energy=gather(self.energy, rows),
            largest_energy=gather(self.largest_energy, rows),
            peak=gather(self.peak, rows),
            seen=gather(self.seen, rows),
            covered=gather(self.covered, rows),
            basis_mean=gather(self.basis_mean, rows),
            sensitivities=None if found is None else found.take(rows, gather),
        )


def zero_scores(splats: int) -> Scores:
    """Return scores of zero for `splats` splats, for a scene without rendered views."""
    return Scores(
        contribution=np.zeros(splats, np.float64),
        colour_sensitivity=np.zeros(splats, np.float64),
        energy=np.zeros(splats, np.float64),
        largest_energy=np.zeros(splats, np.float64),
        peak=np.zeros(splats, np.float32),
        seen=np.zeros(splats, np.int32),
        covered=np.zeros(splats, np.int32),
        basis_mean=np.zeros((splats, _BASES - 1), np.float32),
        basis_spread=np.zeros((_BASES - 1, _BASES - 1), np.float64),
        num_pixels=0,
    )


@dataclass(frozen=True, eq=False)
class _ViewScores:
    """Weight sums and sensitivities of one view, for the splats whose footprints reach it.

    Parameters
    ----------
    index : (M,) int32
        Rows of the splats in the scene, ascending.
    weight_sums : (M, 3) float64
        Sums of the blending weights, from `add_weights`, in the order of `index`.
    sensitivity_rows : (M,) int32
        Row of `sensitivities` for each row of `index`.
    sensitivities : (M, 13) float64 or None
        Result of `view_sensitivities`, nearest splat first; None if not measured in this view.
    """

    index: NDArray[np.int32]
    weight_sums: NDArray[np.float64]
    sensitivity_rows: NDArray[np.int32]
    sensitivities: NDArray[np.float64] | None


def _score_view(
    view: tuple[Camera, bool],
    splats: Splats,
    *,
    config: ScoreConfig,
    threads: int,
) -> _ViewScores:
    """Score one view; `view` is its camera and whether to measure sensitivities."""
    camera, sensitive = view
    footprints = project(splats, camera, near_plane=config.near_plane)
    sums = np.zeros((len(footprints), 3), np.float64)

    def weigh(lists: TileLists) -> None:
        least = config.least_weight
        add_weights(lists, footprints, camera, config.top_k, threads, sums, least_weight=least)

    if not sensitive:
        for lists in tile_lists(footprints, camera.width, camera.height):
            weigh(lists)
        return _view_scores(footprints, sums, None)
    colours = footprint_colours(splats, camera, footprints)
    moments = np.zeros((len(footprints), COLUMNS), np.float64)
    for lists in tile_lists(footprints, camera.width, camera.height, PAIRS_AT_ONCE):
        weigh(lists)
        add_moments(lists, footprints, colours, camera, threads, moments)
    columns = view_sensitivities(splats, camera, footprints, colours, moments, sums[:, SQUARE])
    return _view_scores(footprints, sums, columns)


def _view_scores(
    footprints: Footprints,
    weight_sums: NDArray[np.float64],
    sensitivities: NDArray[np.float64] | None,
) -> _ViewScores:
    """Return the scores of a view with the weight sums sorted by row of the scene.

    The sensitivities, the largest array, stay in the order of the footprints, nearest first.
    """
    return _ViewScores(
        footprints.sorted_rows(),
        sort_by_row(footprints, weight_sums),
        footprints.row_order(),
        sensitivities,
    )


def _score_on_device(
    view: tuple[Camera, bool], splats: Splats, scene: CudaScene, config: ScoreConfig
) -> _ViewScores:
    """Score one view on a CUDA device; `view` is as for `_score_view`."""
    camera, sensitive = view
    shown = scene.view(camera, near_plane=config.near_plane)
    footprints, sums = shown.footprints, shown.weights(config.top_k, config.least_weight)
    columns = None
    if sensitive:
        moments = shown.moments()
        columns = view_sensitivities(
            splats, camera, footprints, shown.colours, moments, sums[:, SQUARE]
        )
    return _view_scores(footprints, sums, columns)


def _sensitivity_views(count: int, every: int) -> list[bool]:
    """Return a list that marks the views with sensitivities: one in each run of `every` views.

    The position of the marked view varies from run to run: jittered copies alternate between two
    kinds, and a fixed position would always meet the same kind.
    """
    if every == 0:
        return [False] * count
    return [(view + view // every) % every == 0 for view in range(count)]


def score(
    splats: Splats,
    cameras: Sequence[Camera],
    config: ScoreConfig | None = None,
    *,
    covering: Sequence[Camera] = (),
    workspace: Workspace = IN_MEMORY,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> Scores:
    """Score every splat of a scene in one pass over the views of given cameras.

    Parameters
    ----------
    splats : Splats
        Scene, drawn with the kernel and anti-aliasing of ``splats.info``. Splats that cannot be
        drawn score 0.
    cameras : sequence of Camera
        Cameras in the frame of the means.
    config : ScoreConfig or None
        None for the defaults.
    covering : sequence of Camera
        Views of parts that `cameras` miss (`planner.ViewPlan.covering_views`). They count in
        ``largest_energy`` (times `COVERING_ENERGY`) and ``peak`` (times `COVERING_SHARE`), and in
        ``seen`` and ``covered``. They are excluded from all sums and means and have no jittered
        copies.
    workspace : Workspace
        Allocator of the scores; also decides whether several views are scored at once.
    executor : Executor, optional
        Executor of the work on single views; by default threads of this process.
    progress : Progress
        Called with ``("score", views done, views)``; raising from it stops the work.

    Returns
    -------
    Scores
        Scores; on the device ``cpu`` they are bit-identical for any number of threads.

    Raises
    ------
    DataError
        ``no-cameras`` for an empty list, ``cameras-see-nothing`` if no splat reaches a pixel.
    MissingExtraError, LimitError
        The device ``cuda`` is not available (see `rasteriser.render`).
    ValueError
        Both an executor and the device ``cuda`` are given.

    Examples
    --------
    >>> from cogsplat.codec.scoring.contribution import ScoreConfig, score
    >>> import cogsplat
    >>> splats = cogsplat.read("scene.ply")
    >>> cameras = cogsplat.read_cameras("cameras.json")[:2]
    >>> scores = score(splats, cameras, ScoreConfig(jitter=False))
    >>> scores.contribution.shape, int(scores.seen.max())
    ((1000,), 2)
    """
    config = config or ScoreConfig()
    if not cameras:
        raise DataError("no-cameras", "0 cameras to score with, expected at least 1")
    sets = [list(cameras)]
    if config.jitter:
        sets.append(jitter(splats, cameras, config.jitter_copies))
    views: list[Camera] = []
    shares: list[tuple[float, float]] = []
    sensitive: list[float] = []
    for members in sets:
        pixels = sum(camera.width * camera.height for camera in members)
        views += members
        shares += [(1.0 / len(members), 1.0 / (pixels * len(sets)))] * len(members)
        chosen = _sensitivity_views(len(members), config.sensitivity_every)
        pixels = sum(
            camera.width * camera.height
            for camera, included in zip(members, chosen, strict=True)
            if included
        )
        sensitive += [1.0 / (pixels * len(sets)) if included else 0.0 for included in chosen]
    given = len(views)
    views += covering
    shares += [(0.0, 0.0)] * len(covering)
    sensitive += [0.0] * len(covering)

    totals = ViewSums(splats, config.colour_sensitivity, workspace.zeros)
    n = len(splats)
    columns = workspace.zeros((n if config.sensitivity_every else 0, COLUMNS), np.float64)
    threads = thread_count(config.threads)
    by_view = executor is not None or (
        workspace.views_at_once and threads <= len(views) and n <= MAX_VIEW_PARALLEL_SPLATS
    )
    if executor is not None and config.device == "cuda":
        raise ValueError("an executor and the device cuda, expected one of them")
    if executor is None:
        executor = LocalThreads(threads if by_view else 1)
    work = list(zip(views, (share > 0.0 for share in sensitive), strict=True))
    results: Iterator[_ViewScores]
    if config.device == "cuda":
        scene = CudaScene(splats)
        results = (_score_on_device(view, splats, scene, config) for view in work)
    else:
        results = executor.map(
            partial(_score_view, config=config, threads=1 if by_view else threads),
            work,
            splats,
        )
    progress("score", 0, len(views))
    for done, result in enumerate(results):
        view_share, pixel_share = shares[done]
        camera = views[done]
        num_pixels = camera.width * camera.height
        sums = result.weight_sums
        if done >= given:
            sums[:, PEAK] *= COVERING_SHARE
            sums[:, SQUARE] *= COVERING_ENERGY
        totals.add(result.index, sums, camera.position, num_pixels, view_share, pixel_share)
        if result.sensitivities is not None:
            add_rows(
                result.index,
                result.sensitivity_rows,
                result.sensitivities,
                sensitive[done],
                columns,
            )
        workspace.trim()
        progress("score", done + 1, len(views))
    if not totals.seen.any():
        raise DataError(
            "cameras-see-nothing",
            f"none of {n} splats reaches a pixel of the {len(cameras)} cameras, expected cameras "
            "in the frame of the scene",
        )
    return Scores(
        contribution=totals.contribution,
        colour_sensitivity=(
            totals.bases.max(axis=1) if config.colour_sensitivity else np.zeros(n, np.float64)
        ),
        energy=totals.energy,
        largest_energy=totals.largest_energy,
        peak=totals.peak,
        seen=totals.seen,
        covered=totals.covered,
        basis_mean=totals.basis_mean(),
        basis_spread=totals.basis_spread(),
        num_pixels=sum(camera.width * camera.height for camera in views),
        sensitivities=from_columns(columns) if config.sensitivity_every else None,
    )
