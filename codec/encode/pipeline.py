"""Encoder from end to end: score, order, encode chunks, compensate, predict."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import Final

from cogsplat.codec.errors import CogsplatWarning, DataError
from cogsplat.codec.order import objects
from cogsplat.codec.order.orders import split_name
from cogsplat.codec.progress import Progress, TimedProgress, silent
from cogsplat.codec.scoring.contribution import zero_scores
from cogsplat.codec.scoring.reference_views import ReferenceViews, render_references
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import one_blas_thread
from cogsplat.codec.views.view_sets import sample_evenly

from .encoded import EncodedScene, EncodeReport
from .finishing import Finisher, SizeOf, mean_psnr_db
from .prepared import prepare
from .preview_chunks import PreviewMaker
from .rate_control import SearchResult
from .request import EncodeRequest
from .scored_views import ScoredViews, score_scene

LEAST_COVERAGE: Final[Mapping[str, float]] = MappingProxyType({"planned": 0.9, "given": 0.75})
"""Coverage of planned and of given views below which a warning is issued. Given views may leave out
what their owner does not want to show; planned views should show everything."""


@one_blas_thread()
def encode(
    splats: Splats,
    request: EncodeRequest,
    *,
    size_of: SizeOf | None = None,
    preview: PreviewMaker | None = None,
    progress: Progress = silent,
) -> EncodedScene:
    """Encode a scene: from arrays and cameras to payloads and tables.

    Parameters
    ----------
    splats : Splats
        Scene to encode.
    request : EncodeRequest
        Views, configuration, target and resources.
    size_of : callable, optional
        Size of the file that an encoded scene makes, bytes; required by a target size.
    preview : PreviewMaker, optional
        Maker of the preview splats; required by `EncodeConfig.preview`.
    progress : Progress
        Called with the stages ``plan views``, ``score`` (``regions`` if scores are given),
        ``reference views``, the stages of the order, ``order``, ``codebooks``, ``quantisers``,
        ``chunks``, ``view table``, ``preview``, ``compensate`` and ``predict``. A search for a
        target repeats some of these stages within the stage ``search``. A stage of one step is
        reported when it is done.

    Returns
    -------
    EncodedScene
        Its report has stages, views and predicted quality. The bytes are the same for any number of
        threads and any executor, on processors of one kind.

    Raises
    ------
    DataError
        ``invalid-rows``, ``value-range``, ``scores-mismatch``; ``no-cameras`` and
        ``cameras-see-nothing``; ``empty-scene`` where no view can be planned;
        ``target-out-of-reach``; ``basis-mismatch`` where the basis has another SH degree.
    ValueError
        A target PSNR without views to measure it in; a target size without `size_of`; a preview
        without views to compensate in, or without its maker.

    Examples
    --------
    >>> from cogsplat.codec.encode.config import EncodeConfig
    >>> from cogsplat.codec.encode.request import EncodeRequest
    >>> from cogsplat.codec.scoring.contribution import zero_scores
    >>> from cogsplat.codec.splats import empty
    >>> config = EncodeConfig(order="source", prune=None)
    >>> encoded = encode(empty(0, 100), EncodeRequest(config=config, scores=zero_scores(100)))
    >>> len(encoded.chunks), encoded.splats
    (1, 100)
    """
    timed = TimedProgress(progress)
    _require_encodable(splats, request, size_of, preview)
    request = request.at_shown_width()
    scored = score_scene(splats, request, timed)
    if len(splats):
        _warn_of_coverage(scored.report)
    request = _disable_without_views(splats, request, scored)
    references = _render_references(splats, request, scored, timed)
    prepared = prepare(
        splats,
        zero_scores(len(splats)) if scored.scores is None else scored.scores,
        request.config,
        views=scored.views,
        jitter=scored.jitter,
        references=references,
        effort=request.effort.gain,
        basis=request.basis,
        group_shares=scored.group_shares,
        workspace=request.workspace,
        executor=request.view_executor,
        progress=timed,
    )
    timed("order", 1, 1)
    # Where all views see all of a scene, the order of the file says more than a view table.
    with_table = request.config.view_table and prepared.regions.is_told_apart
    finisher = Finisher(
        prepared,
        splats,
        request.effort,
        references=references if request.config.compensates else None,
        test_views=scored.test_views,
        # A preset that scores few of the given cameras still describes all of them.
        table_views=(request.cameras or scored.views) if with_table else (),
        preview=preview if request.config.preview is not None else None,
        size_of=size_of,
        executor=request.executor,
        progress=timed,
    )
    hit = _encode_at_target(request, scored, finisher)
    return replace(hit.encoded, report=_report(scored, hit, timed))


def _require_encodable(
    splats: Splats,
    request: EncodeRequest,
    size_of: SizeOf | None,
    preview: PreviewMaker | None,
) -> None:
    """Refuse inputs that would fail after minutes of work."""
    if request.target is not None and request.target.size_bytes is not None and size_of is None:
        raise ValueError("a size as target without size_of, expected what measures a file")
    if request.config.preview is not None and preview is None:
        raise ValueError("a preview without its maker, expected `fit.preview_training`")
    splats.require_valid()
    if request.basis is not None and len(request.basis.payloads) != splats.sh_degree:
        raise DataError(
            "basis-mismatch",
            f"a basis of SH degree {len(request.basis.payloads)}, expected that of the scene, "
            f"{splats.sh_degree}",
        )
    if request.config.ordering.by_object:
        objects.require_objects(splats, request.config.ordering.object_budgets)


def _disable_without_views(
    splats: Splats, request: EncodeRequest, scored: ScoredViews
) -> EncodeRequest:
    """Return the request, without compensation and preview if no view was scored.

    Both are fitted to pictures of the scored views.
    """
    if scored.views:
        return request
    if request.config.preview is not None and len(splats):
        raise ValueError("a preview and no views to compensate in, expected cameras")
    return replace(request, config=replace(request.config, compensate=False, preview=None))


def _render_references(
    splats: Splats, request: EncodeRequest, scored: ScoredViews, progress: Progress
) -> ReferenceViews | None:
    """Return the ground-truth renders for the order by marginal gain and for compensation."""
    config, effort = request.config, request.effort
    compared = config.compensates or split_name(config.order)[0] == "gain"
    if not (compared and scored.views and len(splats)):
        return None
    return render_references(
        splats,
        sample_evenly(scored.views, effort.reference_views),
        jittered=scored.jitter and effort.reference_jitter,
        pixels=effort.reference_pixels,
        threads=config.threads,
        executor=request.view_executor,
        progress=progress,
    )


def _encode_at_target(
    request: EncodeRequest, scored: ScoredViews, finisher: Finisher
) -> SearchResult:
    """Encode at the nominal quality, or search for the target."""
    config = request.config
    planned = scored.report.views == "planned"
    if request.target is not None and len(finisher.source):
        hit = finisher.search(request.target)
        # The nominal quality that `search_nominal` would need to come near this result.
        return replace(hit, quality_db=mean_psnr_db(hit.encoded)) if planned else hit
    if request.target is None and planned and config.profile != "near-lossless":
        return finisher.search_nominal(config.quality_db)
    return SearchResult(finisher.encode(config.quality_db), config.quality_db, 0.0, 1)


def _report(scored: ScoredViews, hit: SearchResult, timed: TimedProgress) -> EncodeReport:
    """Return the report of the whole encode."""
    return replace(
        hit.encoded.report,
        views=scored.report.views,
        coverage=scored.report.coverage,
        test_views=scored.report.test_views,
        seconds=timed.seconds,
        cpu_seconds=timed.cpu_seconds,
        scored_views=timed.totals.get("score", 0),
        quality_db=hit.quality_db,
        trials=hit.trials,
    )


def _warn_of_coverage(report: EncodeReport) -> None:
    """Warn about scoring views that leave out much of the scene."""
    least = LEAST_COVERAGE.get(report.views, 0.0)
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
