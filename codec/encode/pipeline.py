"""The encoder from end to end: score, order, lay out, encode, compensate, predict."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from types import MappingProxyType
from typing import Final

import numpy as np

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import CogsplatWarning, DataError
from cogsplat.codec.executor import Executor, LocalThreads
from cogsplat.codec.order import objects
from cogsplat.codec.order.orders import split_name
from cogsplat.codec.order.prefix_inflation import effective_splats
from cogsplat.codec.progress import Progress, TimedProgress, silent
from cogsplat.codec.scoring.contribution import (
    MAX_VIEW_PARALLEL_SPLATS,
    ScoreConfig,
    Scores,
    score,
    zero_scores,
)
from cogsplat.codec.scoring.reference_views import ReferenceViews, render_references
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import one_blas_thread
from cogsplat.codec.views.planner import ViewPlan, plan
from cogsplat.codec.views.view_sets import sample_evenly
from cogsplat.codec.workspace import IN_MEMORY, Workspace

from .compensation_fit import blank, compensated
from .config import EncodeConfig
from .encoded import EncodedScene, EncodeReport
from .encoder import compress_chunks, encode_chunks
from .prefix_quality import PrefixEvaluator, predicted, whole_measured
from .prepared import PreparedScene, prepare
from .presets import DEFAULT_PRESET, PRESETS, Preset
from .preview_chunks import PreviewMaker
from .rate_control import Hit, Target, to_finished_size, to_nominal, to_psnr
from .scored_views import score_given
from .shift_optimiser import FitConfig
from .view_tables import foreseen, with_view_table

LEAST_COVERAGE: Final[Mapping[str, float]] = MappingProxyType({"planned": 0.9, "given": 0.75})
"""Coverage of planned and of given views below which a warning is issued. Given views may leave out
what their owner does not want to show, planned ones ought to show all."""

SizeOf = Callable[[EncodedScene], int]
"""Returns the bytes of the whole file that an encoded scene makes."""


@one_blas_thread()
def encode(
    splats: Splats,
    config: EncodeConfig,
    *,
    cameras: Sequence[Camera] | None = None,
    scores: Scores | None = None,
    score_config: ScoreConfig | None = None,
    preset: Preset = PRESETS[DEFAULT_PRESET],
    target: Target | None = None,
    test_views: Sequence[Camera] = (),
    size_of: SizeOf | None = None,
    preview: PreviewMaker | None = None,
    workspace: Workspace = IN_MEMORY,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> EncodedScene:
    """Encode a scene: from arrays and cameras to payloads and tables.

    Parameters
    ----------
    splats : Splats
    config : EncodeConfig
        Where views are planned, its nominal quality is the PSNR in the test views, to about 1 dB
        (`rate_control.to_nominal`). An order that renders (``gain``) and compensation need cameras,
        given or planned: with `scores` alone the order is refused and no compensation is fitted.
    cameras : sequence of Camera, optional
        Views to score in, in the frame of the means. Without them, and without `scores`, views
        are planned around the splats.
    scores : Scores, optional
        Of an earlier `score` of these splats; then none are measured.
    score_config : ScoreConfig, optional
        In place of the preset's.
    preset : Preset
        How many views are planned, scored and predicted in.
    target : Target, optional
        A PSNR or a size to search for; then `EncodeConfig.quality_db` does not count.
    test_views : sequence of Camera
        Views that a PSNR is measured and predicted in. Where none are given, planned test views,
        or some of `cameras`.
    size_of : callable, optional
        Needed for a size as target.
    preview : PreviewMaker, optional
        Makes first chunks that stand for the whole scene until more of it has come.
    workspace : Workspace
        Where arrays as long as the scene are kept, and whether several views are drawn at once.
    executor : Executor, optional
        What runs the work of single views and chunks; `EncodeConfig.threads` threads of this
        process where it is not given.
    progress : Progress
        Called with the stages ``plan views``, ``score``, ``reference views``, those of the order,
        ``order``, ``codebooks``, ``quantisers``, ``chunks``, ``search`` around these where there
        may be several encodes, ``view table``, ``preview``, ``compensate`` and ``predict``. Those
        of a single step report it when it is done.

    Returns
    -------
    EncodedScene
        With a report of the stages, the views and the predicted quality. The same bytes for any
        number of threads and for any executor on processors of one kind.

    Raises
    ------
    DataError
        ``invalid-rows``, ``value-range``, ``scores-mismatch``; ``no-cameras`` and
        ``cameras-see-nothing``; ``empty-scene`` where no view can be planned;
        ``target-out-of-reach``.
    ValueError
        The order ``gain`` with scores and no cameras; a target for the profile ``near-lossless``;
        a PSNR as target and no views to measure it in; a size without `size_of`; a preview where
        no compensation is fitted, with cells, chunks by object or a workspace in files.

    Examples
    --------
    >>> from cogsplat.codec.encode.config import EncodeConfig
    >>> from cogsplat.codec.scoring.contribution import zero_scores
    >>> from cogsplat.codec.splats import empty
    >>> config = EncodeConfig(order="source", prune=None)
    >>> encoded = encode(empty(0, 100), config, scores=zero_scores(100))
    >>> len(encoded.chunks), encoded.splats
    (1, 100)
    """
    _require_consistent(config, cameras, scores, target, size_of)
    if preview is not None:
        _require_preview_possible(config, workspace)
    if executor is not None and workspace.in_files:
        raise ValueError("an executor and a workspace in files, expected one of them")
    timed = TimedProgress(progress)
    splats.require_valid()
    if config.ordering.by_object:
        objects.require_objects(splats, config.ordering.object_budgets)
    settings = score_config or preset.score_config(config.profile, threads=config.threads)
    views, covering, tests = list(cameras or ()), list[Camera](), list(test_views)
    report = EncodeReport(views="given" if views else "none")
    if tests or views:
        report = replace(report, test_views="given")
    if scores is None and len(splats):
        if cameras is None:
            planned = _planned(splats, config, preset, executor, timed)
            views, covering = planned.views, planned.covering_views
            settings = replace(settings, jitter=settings.jitter and preset.planned_jitter)
            if views:
                report = replace(report, views="planned", coverage=planned.coverage)
            if planned.test_views and not tests:
                tests = planned.test_views
                report = replace(report, test_views="planned")
            if views:
                scores = score(
                    splats,
                    views,
                    settings,
                    covering=covering,
                    workspace=workspace,
                    executor=executor,
                    progress=timed,
                )
        else:
            # An empty list of cameras is refused, not taken for none given.
            views, scores = score_given(
                splats,
                views,
                preset,
                settings,
                workspace=workspace,
                executor=executor,
                progress=timed,
            )
    if report.views == "given" and scores is not None and len(splats):
        report = replace(report, coverage=float((scores.covered > 0).mean()))
    if report.views != "none" and len(splats):
        _warn_of_coverage(report)
    if not views:
        # There are no pictures to fit it to, so nothing may count on it.
        config = replace(config, compensate=False)
    fits = config.compensate and config.profile != "near-lossless"
    if preview is not None and not fits and len(splats):
        raise ValueError("a preview and no views to compensate in, expected cameras")
    # With arrays in files, one view is worked on after the other, as in scoring.
    by_view = executor if workspace.views_at_once else LocalThreads(1)
    references = None
    # Both the order and the fit compare prefixes with pictures of the whole scene.
    if len(splats) and views and (fits or split_name(config.order)[0] == "gain"):
        references = render_references(
            splats,
            sample_evenly(views, preset.reference_views),
            jittered=settings.jitter and preset.reference_jitter,
            pixels=preset.reference_pixels,
            threads=config.threads,
            executor=by_view,
            progress=timed,
        )
    prepared = prepare(
        splats,
        zero_scores(len(splats)) if scores is None else scores,
        config,
        views=views,
        jitter=settings.jitter,
        references=references,
        effort=preset.gain,
        workspace=workspace,
        executor=by_view,
        progress=timed,
    )
    timed("order", 1, 1)
    # A preset that scores few of the given cameras tells of all of them all the same.
    told = list(cameras or views)
    table_views = told if config.cells and config.view_table else []
    finishing = _Finishing(
        prepared, references if fits else None, tests or views, table_views, preset, preview,
        executor, timed,
    )  # fmt: skip
    if target is None and report.views == "planned" and config.profile != "near-lossless":
        hit = to_nominal(finishing.measured, config.quality_db, _mean_test_psnr_db, progress=timed)
        hit = replace(hit, encoded=finishing.finish(hit.encoded))
    elif target is None or not len(splats):
        encoded = encode_chunks(prepared, config.quality_db, executor=executor, progress=timed)
        hit = Hit(finishing.finish(encoded), config.quality_db, 0.0, 1)
    else:
        hit = _search(prepared, target, finishing, size_of)
        if report.views == "planned":
            # What `to_nominal` takes to come near to this.
            hit = replace(hit, quality_db=_mean_test_psnr_db(hit.encoded))
    report = replace(
        report,
        seconds=timed.seconds,
        cpu_seconds=timed.cpu_seconds,
        scored_views=timed.totals.get("score", 0),
        quality_db=hit.quality_db,
        trials=hit.trials,
        test_psnr_db=hit.encoded.report.test_psnr_db,
    )
    return replace(hit.encoded, report=report)


def _warn_of_coverage(report: EncodeReport) -> None:
    """Say where the views that a scene is scored in leave out much of it."""
    least = LEAST_COVERAGE[report.views]
    if report.coverage >= least:
        return
    found = f"{report.coverage:.1%} of the splats"
    if report.views == "planned":
        message = (
            f"the {report.views} views show only {found} that are visible from anywhere, expected "
            f"{least:.0%}: views may be worse than predicted; cameras would help"
        )
    else:
        message = (
            f"only {found} lie in a picture of the cameras, expected "
            f"{least:.0%}: what no camera shows is kept, and views of it are not predicted"
        )
    warnings.warn(message, CogsplatWarning, stacklevel=3)


def _require_consistent(
    config: EncodeConfig,
    cameras: Sequence[Camera] | None,
    scores: Scores | None,
    target: Target | None,
    size_of: SizeOf | None,
) -> None:
    """Refuse what would fail, or be quietly left out, after minutes of work."""
    if scores is not None and not cameras and split_name(config.order)[0] == "gain":
        raise ValueError(
            f"order {config.order!r} with scores and no cameras, expected the cameras that were "
            "scored, or an order that does not render, such as 'contribution'"
        )
    if target is None:
        return
    if config.profile == "near-lossless":
        raise ValueError("a target for the profile 'near-lossless', expected a profile for viewing")
    if target.size_bytes is not None and size_of is None:
        raise ValueError("a size as target without size_of, expected what measures a file")


def _require_preview_possible(config: EncodeConfig, workspace: Workspace) -> None:
    """Refuse what a preview cannot stand in: it is of all cells and objects, and in memory."""
    if not config.compensate or config.profile == "near-lossless":
        raise ValueError("a preview without compensation, expected a profile that compensates")
    if config.cells or config.ordering.by_object:
        raise ValueError("a preview with cells or objects, expected one of them")
    if workspace.in_files:
        raise ValueError("a preview and a workspace in files, expected one of them")


def _planned(
    splats: Splats,
    config: EncodeConfig,
    preset: Preset,
    executor: Executor | None,
    progress: Progress,
) -> ViewPlan:
    """Return views to score in and test views, of a scene that came without cameras.

    There are none where a scene shows nothing and is to be stored without loss all the same.
    """
    try:
        settings = preset.plan_config(config.threads)
        return plan(splats, settings, executor=executor, progress=progress)
    except DataError as error:
        if error.code != "empty-scene" or config.profile != "near-lossless":
            raise
        return ViewPlan([], [], [], 1.0)


@dataclass(frozen=True, eq=False)
class _Finishing:
    """What is added to a scene once its chunks are encoded: compensation, view table, predictions.

    Parameters
    ----------
    prepared : PreparedScene
    references : ReferenceViews or None
        Pictures that compensation is fitted to; None where none is fitted.
    test_views : sequence of Camera
        Views to predict in; empty where nothing is predicted.
    table_views : sequence of Camera
        Views that a view table is made of; empty where there is none.
    preset : Preset
        How many of these are rendered, and how long compensation is fitted.
    preview : PreviewMaker or None
    executor : Executor or None
    progress : Progress
    """

    prepared: PreparedScene
    references: ReferenceViews | None
    test_views: Sequence[Camera]
    table_views: Sequence[Camera]
    preset: Preset
    preview: PreviewMaker | None
    executor: Executor | None
    progress: Progress

    @cached_property
    def evaluator(self) -> PrefixEvaluator:
        """Pictures of the source in the test views: drawn once, for a search and a prediction."""
        prepared, views = self.prepared, sample_evenly(self.test_views, self.preset.test_views)
        return PrefixEvaluator(
            prepared.source,
            views,
            prepared.config.threads,
            views_at_once=prepared.workspace.views_at_once
            and len(prepared.source) <= MAX_VIEW_PARALLEL_SPLATS,
            executor=self.executor,
        )

    @property
    def fit(self) -> FitConfig:
        """Configuration of the fit."""
        return self.preset.fit_config(self.prepared.config.threads)

    def measured(self, quality_db: float) -> EncodedScene:
        """Return the scene at a nominal quality, its report with the PSNR in each test view.

        Another quality may be tried after it, so that its planes are compressed by `finish`; but
        not where arrays are in files, since until then they take several times the memory.
        """
        encoded = encode_chunks(
            self.prepared,
            quality_db,
            compress=self.prepared.workspace.in_files,
            executor=self.executor,
            progress=self.progress,
        )
        return whole_measured(encoded, self.evaluator)

    def finish(self, encoded: EncodedScene) -> EncodedScene:
        """Return a scene with all that is added to its chunks, all compressed.

        That is a view table, a preview, compensation and predicted quality.
        """
        at_once = self.prepared.workspace.views_at_once
        encoded = compress_chunks(
            encoded, self.prepared.config, executor=self.executor, progress=self.progress
        )
        if self.table_views:
            encoded = with_view_table(
                encoded,
                self.table_views,
                executor=self.executor if at_once else LocalThreads(1),
                progress=self.progress,
            )
        if self.references is not None:
            if self.preview is not None:
                contribution = self.prepared.scores.contribution
                encoded = self.preview.add(
                    encoded,
                    self.references,
                    effective_splats(contribution),
                    progress=self.progress,
                )
            encoded = compensated(
                encoded,
                self.references,
                self.prepared.scores.contribution,
                self.fit,
                executor=self.executor if at_once else LocalThreads(1),
                progress=self.progress,
            )
        if self.test_views and len(encoded.chunks):
            encoded = predicted(
                encoded,
                self.evaluator,
                most_views=self.preset.prediction_views,
                progress=self.progress,
            )
        return encoded

    def foresee(self, encoded: EncodedScene) -> EncodedScene:
        """Return a scene that takes the bytes of the finished one, without fitting anything."""
        if self.references is not None:
            if self.preview is not None:
                encoded = self.preview.reserve(encoded)
            counts = [chunk.splats for chunk in encoded.chunks]
            carriers = effective_splats(self.prepared.scores.contribution)
            encoded = replace(encoded, compensation=blank(counts, carriers, self.fit))
        if self.table_views:
            encoded = foreseen(encoded, len(self.table_views))
        if self.test_views:
            chunks = [replace(chunk, quality_db=1.0) for chunk in encoded.chunks]
            encoded = replace(encoded, chunks=chunks)
        return encoded


def _mean_test_psnr_db(encoded: EncodedScene) -> float:
    return float(np.mean(encoded.report.test_psnr_db))


def _search(
    prepared: PreparedScene, target: Target, finishing: _Finishing, size_of: SizeOf | None
) -> Hit:
    """Return the finished scene that comes nearest to a target."""
    progress = finishing.progress
    if target.size_bytes is not None and size_of is not None:
        return to_finished_size(
            partial(encode_chunks, prepared, executor=finishing.executor),
            len(prepared.rows),
            target.size_bytes,
            lambda encoded: size_of(finishing.foresee(encoded)),
            finishing.finish,
            size_of,
            progress=progress,
        )
    if not finishing.test_views:
        raise ValueError("a PSNR as target and no cameras, expected views to see it in")
    hit = to_psnr(finishing.measured, target.psnr_db or 0.0, _mean_test_psnr_db, progress=progress)
    return replace(hit, encoded=finishing.finish(hit.encoded))
