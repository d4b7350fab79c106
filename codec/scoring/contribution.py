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
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.render.blend_weights import PEAK, SQUARE, WEIGHT
from cogsplat.codec.render.cuda_views import CudaScene
from cogsplat.codec.render.sensitivities import COLUMNS, Sensitivities, from_columns
from cogsplat.codec.render.splat_blocks import add_hidden, blocks_if_large
from cogsplat.codec.render.tiles import sampled_pixels, sampled_tiles
from cogsplat.codec.splats import MAX_SH_DEGREE, Splats, sh_coefficients
from cogsplat.codec.threads import thread_count
from cogsplat.codec.views.roam_views import jitter
from cogsplat.codec.workspace import IN_MEMORY, Gather, Workspace

from .score_config import ScoreConfig
from .splat_groups import GroupShares, SplatGroups
from .view_scores import ViewScores, score_on_device, score_view
from .view_sums import ViewSums, add_rows

_BASES = sh_coefficients(MAX_SH_DEGREE)

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

# Rows scaled at once.
_BLOCK = 1 << 16


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
    shown : (N,) int32
        Number of views, covering views included, that show the splat with a weight of 0.01 or
        more in some pixel; weights in covering views count as for `peak`.
    covered : (N,) int32
        Number of views, covering views included, that the splat's footprint reaches, hidden or not.
    basis_mean : (N, K-1) float32
        SH bases above DC, of the scene's degree, in the viewing directions of a splat:
        energy-weighted mean over its views; zeros if no view sees it.
    basis_spread : (K-1, K-1) float64
        Covariance of these bases over the views of one splat, as the energy-weighted mean of every
        eighth splat. It gives the cost of an error of shN that sh0 cannot compensate.
    num_pixels : int
        Number of pixels of all views, jittered and covering views included.
    sensitivities : Sensitivities or None
        Costs of errors of the stored values; None if `ScoreConfig.sensitivity_every` is 0.
    sparse : bool
        Whether the given cameras show too little in common, so that planned views were scored as
        well. Pruning then keeps more splats, and colours have finer steps.
    """

    contribution: NDArray[np.float64]
    colour_sensitivity: NDArray[np.float64]
    energy: NDArray[np.float64]
    largest_energy: NDArray[np.float64]
    peak: NDArray[np.float32]
    shown: NDArray[np.int32]
    covered: NDArray[np.int32]
    basis_mean: NDArray[np.float32]
    basis_spread: NDArray[np.float64]
    num_pixels: int
    sensitivities: Sensitivities | None = None
    sparse: bool = False

    def __repr__(self) -> str:
        shown = int(np.count_nonzero(self.shown))
        return f"Scores({len(self.shown):,} splats, {shown:,} shown, {self.num_pixels:,} pixels)"

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
            shown=gather(self.shown, rows),
            covered=gather(self.covered, rows),
            basis_mean=gather(self.basis_mean, rows),
            sensitivities=None if found is None else found.take(rows, gather),
        )


def zero_scores(splats: int) -> Scores:
    """Return scores of zero for `splats` splats, for a scene without rendered views.

    They have the bases of degree 3, of which scenes of lower degrees use the first.
    """
    return Scores(
        contribution=np.zeros(splats, np.float64),
        colour_sensitivity=np.zeros(splats, np.float64),
        energy=np.zeros(splats, np.float64),
        largest_energy=np.zeros(splats, np.float64),
        peak=np.zeros(splats, np.float32),
        shown=np.zeros(splats, np.int32),
        covered=np.zeros(splats, np.int32),
        basis_mean=np.zeros((splats, _BASES - 1), np.float32),
        basis_spread=np.zeros((_BASES - 1, _BASES - 1), np.float64),
        num_pixels=0,
    )


class Scorer:
    """Scores of a scene, summed up view by view.

    Parameters
    ----------
    splats, config, workspace, executor, progress
        See `score`.
    groups : SplatGroups, optional
        Groups of the splats whose shares of the pictures are recorded.

    Attributes
    ----------
    sums : ViewSums
        Sums over the views so far.
    """

    def __init__(
        self,
        splats: Splats,
        config: ScoreConfig,
        *,
        workspace: Workspace = IN_MEMORY,
        executor: Executor | None = None,
        groups: SplatGroups | None = None,
        progress: Progress = silent,
    ) -> None:
        if executor is not None and config.device == "cuda":
            raise ValueError("an executor and the device cuda, expected one of them")
        n = len(splats)
        self.sums = ViewSums(splats, config.colour_sensitivity, workspace.zeros)
        measured = n if config.sensitivity_every else 0
        self._columns: NDArray[np.float64] = workspace.zeros((measured, COLUMNS), np.float64)
        self._splats = splats
        self._config = config
        self._workspace = workspace
        self._executor = executor
        self._groups = groups
        self._shares: list[NDArray[np.float64]] = []
        self._progress = progress
        self._device = CudaScene(splats) if config.device == "cuda" else None
        self._blocks = None if self._device else blocks_if_large(splats, workspace)
        # Views in which each block was left out, because nearer splats hide it.
        self._hidden = np.zeros(0 if self._blocks is None else len(self._blocks), np.int32)
        # Views so far, and the cameras among them. Pixels: all, weighted by the share of their
        # view, and likewise those of tiles with sensitivities.
        self._views = 0
        self._cameras = 0
        self._num_pixels = 0
        self._pixels = 0.0
        self._measured_pixels = 0.0

    def add(
        self, cameras: Sequence[Camera], *, jittered: bool = False, covering: bool = False
    ) -> None:
        """Score further views.

        Parameters
        ----------
        cameras : sequence of Camera
            Cameras in the frame of the means.
        jittered : bool
            Whether to score `ScoreConfig.jitter_copies` of each camera as well.
        covering : bool
            Whether the views count as ``covering`` of `score`.
        """
        config, every = self._config, self._config.sensitivity_every
        views = list(cameras)
        shares = [0.0 if covering else 1.0] * len(views)
        recorded = 0 if covering else len(views)
        if jittered:
            copies = jitter(self._splats, cameras, config.jitter_copies, self._cameras)
            views += copies
            shares += [1.0 / config.jitter_copies] * len(copies)
        if not covering:
            self._cameras += len(cameras)
        if not views:
            return
        numbers = range(self._views, self._views + len(views))
        self._views += len(views)
        # The phase shifts by one after `every` views: jittered copies alternate between two kinds,
        # and a kind would always have the same tiles measured.
        phases = [
            (number + number // every) % every if every and share else -1
            for number, share in zip(numbers, shares, strict=True)
        ]
        work = list(zip(views, phases, strict=True))
        self._progress("score", numbers.start, self._views)
        for done, result in enumerate(self._results(work)):
            if self._groups is not None and done < recorded:
                self._record(self._groups, result, work[done][0])
            self._add(result, *work[done], shares[done])
            self._workspace.trim()
            self._progress("score", numbers[done] + 1, self._views)

    def _record(self, groups: SplatGroups, result: ViewScores, camera: Camera) -> None:
        """Record the shares of groups in the picture of one view."""
        weights = result.weight_sums[:, WEIGHT]
        sums = np.bincount(groups.numbers[result.seen], weights, minlength=len(groups))
        self._shares.append(sums / (camera.width * camera.height))

    @property
    def group_shares(self) -> GroupShares | None:
        """Shares in the cameras so far, not in jittered and covering views; None without groups."""
        if self._groups is None:
            return None
        return GroupShares(
            self._groups, np.array(self._shares).reshape(len(self._shares), len(self._groups))
        )

    def _results(self, work: Sequence[tuple[Camera, int]]) -> Iterator[ViewScores]:
        """Yield the scores of each view, in their order."""
        config, splats = self._config, self._splats
        if self._device is not None:
            return (score_on_device(view, splats, self._device, config) for view in work)
        threads = thread_count(config.threads)
        by_view = self._executor is not None or (
            self._workspace.views_at_once
            and threads <= len(work)
            and len(splats) <= MAX_VIEW_PARALLEL_SPLATS
        )
        executor = self._executor or LocalThreads(threads if by_view else 1)
        shared = (splats,) if self._blocks is None else (splats, self._blocks)
        return executor.map(
            partial(score_view, config=config, threads=1 if by_view else threads),
            work,
            *shared,
        )

    def _add(self, result: ViewScores, camera: Camera, phase: int, share: float) -> None:
        """Add the scores of one view; a share of 0 is that of a covering view."""
        num_pixels = camera.width * camera.height
        self._num_pixels += num_pixels
        self._pixels += share * num_pixels
        sums = result.weight_sums
        if not share:
            sums[:, PEAK] *= COVERING_SHARE
            sums[:, SQUARE] *= COVERING_ENERGY
        self._hidden[result.hidden] += 1
        self.sums.add(result.covered, result.seen, sums, camera.position, num_pixels, share)
        if phase >= 0:
            size = (camera.width, camera.height)
            tiles = sampled_tiles(*size, self._config.sensitivity_every, phase)
            self._measured_pixels += share * sampled_pixels(*size, tiles)
            add_rows(
                result.measured, result.measured_places, result.sensitivities, share, self._columns
            )

    def scores(self) -> Scores:
        """Return the scores in all views added; call it once, after the last view.

        It scales the sums in place.

        Raises
        ------
        DataError
            ``no-cameras`` without views, ``cameras-see-nothing`` if no splat reaches a pixel.
        """
        totals, n = self.sums, len(self._splats)
        if not self._cameras:
            raise DataError("no-cameras", "0 cameras to score with, expected at least 1")
        if not totals.peak.any():
            raise DataError(
                "cameras-see-nothing",
                f"none of {n} splats reaches a pixel of the {self._cameras} cameras, expected "
                "cameras in the frame of the scene",
            )
        if self._blocks is not None:
            add_hidden(self._blocks, self._splats.opacities, self._hidden, totals.covered)
            self._hidden[:] = 0
        basis_mean, basis_spread = totals.basis_mean(), totals.basis_spread()
        self._scale(totals.contribution, 1.0 / self._cameras)
        for sums in (totals.energy, totals.bases):
            self._scale(sums, 1.0 / self._pixels)
        every = self._config.sensitivity_every
        if every:
            self._scale(self._columns, 1.0 / self._measured_pixels)
        return Scores(
            contribution=totals.contribution,
            colour_sensitivity=(
                totals.bases.max(axis=1)
                if self._config.colour_sensitivity
                else np.zeros(n, np.float64)
            ),
            energy=totals.energy,
            largest_energy=totals.largest_energy,
            peak=totals.peak,
            shown=totals.shown,
            covered=totals.covered,
            basis_mean=basis_mean,
            basis_spread=basis_spread,
            num_pixels=self._num_pixels,
            sensitivities=from_columns(self._columns) if every else None,
        )

    def _scale(self, values: NDArray[np.float64], factor: float) -> None:
        """Multiply an array in place, by blocks: it may be mapped."""
        for start in range(0, len(values), _BLOCK):
            values[start : start + _BLOCK] *= factor
            self._workspace.trim()


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
        ``shown`` and ``covered``. They are excluded from all sums and means and have no jittered
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
    >>> from cogsplat.codec.scoring.contribution import score
    >>> from cogsplat.codec.scoring.score_config import ScoreConfig
    >>> import cogsplat
    >>> splats = cogsplat.read("scene.ply")
    >>> cameras = cogsplat.read_cameras("cameras.json")[:2]
    >>> scores = score(splats, cameras, ScoreConfig(jitter=False))
    >>> scores.contribution.shape, int(scores.shown.max())
    ((1000,), 2)
    """
    config = config or ScoreConfig()
    scorer = Scorer(splats, config, workspace=workspace, executor=executor, progress=progress)
    if cameras:
        scorer.add(cameras, jittered=config.jitter)
        scorer.add(covering, covering=True)
    return scorer.scores()
