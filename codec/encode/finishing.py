"""Finish an encoded scene: view table, preview splats, compensation and predicted quality."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from cogsplat.codec.cameras import Camera
from cogsplat.codec.executor import Executor, LocalThreads
from cogsplat.codec.order.prefix_inflation import effective_splats
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.scoring.contribution import MAX_VIEW_PARALLEL_SPLATS
from cogsplat.codec.scoring.reference_views import ReferenceViews
from cogsplat.codec.splats import Splats
from cogsplat.codec.views.close_views import ViewDistance, close_views, view_distances

from .compensation_fit import compensate_prefixes, most_layer_chunks, placeholder_compensation
from .config import Target
from .encoded import EncodedScene
from .encoder import compress_chunks, encode_chunks
from .prepared import PreparedScene
from .presets import Preset
from .preview_chunks import PreviewMaker
from .quality_prediction import PrefixEvaluator, measure_whole, predict_quality
from .rate_control import SearchResult, search_finished_size, search_nominal, search_psnr
from .view_table_builder import add_view_table, reserve_view_table

SizeOf = Callable[[EncodedScene], int]
"""Returns the size of the file that an encoded scene makes, bytes."""

# Stands for a predicted quality, dB, in a scene that is only measured in bytes.
_PLACEHOLDER_DB = 1.0


@dataclass(frozen=True, eq=False)
class Finisher:
    """Last step of an encode: additions to the chunks, computed from decoded splats.

    The additions are view table, preview splats, compensation and predicted quality. To meet a
    target, `search` encodes the chunks several times.

    Parameters
    ----------
    prepared : PreparedScene
        Scene that is encoded.
    source : Splats
        Scene that quality is measured against: the one that is encoded, or the one that it was
        trained from.
    preset : Preset
        Effort of prediction and of the compensation fit.
    references : ReferenceViews or None
        Pictures to fit compensation to; None for a file without compensation.
    test_views : sequence of Camera
        Views to predict quality in; empty for no prediction.
    table_views : sequence of Camera
        Views for a view table; empty for a file without one.
    preview : PreviewMaker or None
        Maker of preview splats; None for a file without a preview.
    size_of : callable or None
        Returns the size of an encoded scene's file, bytes; needed for a target size.
    executor : Executor or None
        Runs the work of single views and chunks; None for threads of this process.
    progress : Progress
        Receives ``chunks``, ``view table``, ``preview``, ``compensate`` and ``predict``; during a
        search ``search``, ``codebooks`` and ``quantisers`` as well.
    """

    prepared: PreparedScene
    source: Splats
    preset: Preset
    references: ReferenceViews | None = None
    test_views: Sequence[Camera] = ()
    table_views: Sequence[Camera] = ()
    preview: PreviewMaker | None = None
    size_of: SizeOf | None = None
    executor: Executor | None = None
    progress: Progress = silent

    @cached_property
    def evaluator(self) -> PrefixEvaluator:
        """Evaluator with renders of the source in the test views, for search and prediction."""
        return self._evaluator(self.test_views)

    @cached_property
    def _test_distances(self) -> list[ViewDistance]:
        """Test views with their distances and close views."""
        return view_distances(self.source, self.test_views, threads=self.prepared.config.threads)

    @cached_property
    def _close_evaluator(self) -> PrefixEvaluator:
        """Evaluator with renders of the source in the close views, of which there is at least one.

        A size search finishes several encodes, which are measured against the same renders.
        """
        return self._evaluator([view.camera for view in close_views(self._test_distances)])

    def _evaluator(self, views: Sequence[Camera]) -> PrefixEvaluator:
        """Return an evaluator with renders of the source in some views."""
        return PrefixEvaluator(
            self.source,
            views,
            self.prepared.config.threads,
            views_at_once=not self._in_files and len(self.source) <= MAX_VIEW_PARALLEL_SPLATS,
            executor=self.executor,
        )

    @property
    def effective_splats(self) -> int:
        """Smallest number of splats of the source with 95 % of the contribution."""
        return effective_splats(self.prepared.scores.contribution)

    @property
    def _in_files(self) -> bool:
        """Whether long arrays lie in mapped files."""
        return self.prepared.workspace.in_files

    @property
    def _view_executor(self) -> Executor | None:
        """Executor of single views; one thread for mapped arrays, to save memory."""
        # With mapped arrays one view is rendered after the other, to save memory.
        return LocalThreads(1) if self._in_files else self.executor

    def encode(self, quality_db: float) -> EncodedScene:
        """Encode the chunks at a nominal quality and finish the scene.

        Parameters
        ----------
        quality_db : float
            Nominal PSNR, dB.
        """
        return self.finish(self._encode_chunks(quality_db))

    def search_nominal(self, quality_db: float) -> SearchResult:
        """Encode at a nominal quality, corrected by the PSNR in the test views.

        Parameters
        ----------
        quality_db : float
            Nominal PSNR, dB.
        """
        hit = search_nominal(
            self._encode_measured, quality_db, mean_psnr_db, progress=self.progress
        )
        return replace(hit, encoded=self.finish(hit.encoded))

    def search(self, target: Target) -> SearchResult:
        """Search for the nominal quality that meets a PSNR or a file size, and finish the scene.

        Parameters
        ----------
        target : Target
            PSNR in the test views, or size of the file.

        Raises
        ------
        DataError
            ``target-out-of-reach``.
        ValueError
            A PSNR without test views, or a size without `size_of`.
        """
        if target.size_bytes is not None:
            if self.size_of is None:
                raise ValueError("a size as target without size_of, expected what measures a file")
            return search_finished_size(
                self._encode_chunks,
                len(self.prepared.rows),
                target.size_bytes,
                self.file_bytes,
                self.finish,
                self.size_of,
                progress=self.progress,
            )
        if not self.test_views:
            raise ValueError("a PSNR as target and no cameras, expected views to see it in")
        psnr_db = target.psnr_db or 0.0
        hit = search_psnr(self._encode_measured, psnr_db, mean_psnr_db, progress=self.progress)
        return replace(hit, encoded=self.finish(hit.encoded))

    def finish(self, encoded: EncodedScene) -> EncodedScene:
        """Return the scene with view table, preview, compensation and predicted quality.

        Parameters
        ----------
        encoded : EncodedScene
            Chunks of `prepared`; they are compressed here where they are not yet.
        """
        config, progress = self.prepared.config, self.progress
        encoded = compress_chunks(encoded, config, executor=self.executor, progress=progress)
        if self.table_views:
            encoded = add_view_table(
                encoded,
                self.table_views,
                workspace=self.prepared.workspace,
                executor=self._view_executor,
                progress=progress,
            )
        if self.references is not None:
            if self.preview is not None:
                encoded = self.preview.add(
                    encoded, self.references, self.effective_splats, progress=progress
                )
            encoded = compensate_prefixes(
                encoded,
                self.references,
                self.prepared.scores.contribution,
                self.preset.fit_config(config.threads),
                executor=self._view_executor,
                progress=progress,
            )
        if self.test_views and len(encoded.chunks):
            most = self.preset.prediction_views
            encoded = predict_quality(encoded, self.evaluator, most_views=most, progress=progress)
            encoded = self._measure_close(encoded)
        return encoded

    def _measure_close(self, encoded: EncodedScene) -> EncodedScene:
        """Return a finished scene with its PSNR in close views added to the report."""
        close = close_views(self._test_distances)
        values: tuple[float, ...] = ()
        if close:
            whole = encoded.prefix_splats(len(encoded.chunks))
            values = tuple(self._close_evaluator.views_db(whole))
        report = replace(
            encoded.report,
            test_distances=tuple(view.distance for view in self._test_distances),
            close_psnr_db=values,
            close_distances=tuple(view.distance for view in close),
        )
        return replace(encoded, report=report)

    def file_bytes(self, encoded: EncodedScene) -> int:
        """Return the size of the file after `finish`, bytes, before compensation is fitted.

        Parameters
        ----------
        encoded : EncodedScene
            Chunks of `prepared`.
        """
        if self.size_of is None:
            raise ValueError("a file size without size_of, expected what measures a file")
        if self.references is not None:
            if self.preview is not None:
                encoded = self.preview.reserve(encoded)
            counts = [chunk.splats for chunk in encoded.chunks]
            fit = self.preset.fit_config(self.prepared.config.threads)
            most = most_layer_chunks(encoded.chunks)
            blank = placeholder_compensation(counts, self.effective_splats, fit, most_chunks=most)
            encoded = replace(encoded, compensation=blank)
        if self.table_views:
            encoded = reserve_view_table(encoded, len(self.table_views))
        if self.test_views:
            chunks = [replace(chunk, quality_db=_PLACEHOLDER_DB) for chunk in encoded.chunks]
            encoded = replace(encoded, chunks=chunks)
        return self.size_of(encoded)

    def _encode_chunks(self, quality_db: float) -> EncodedScene:
        """Encode the chunks at a nominal quality, dB."""
        return encode_chunks(
            self.prepared, quality_db, executor=self.executor, progress=self.progress
        )

    def _encode_measured(self, quality_db: float) -> EncodedScene:
        """Encode at a nominal quality, and add the PSNR in each test view to the report.

        The planes stay uncompressed until `finish`, since a search may discard this encode. With
        mapped arrays they are compressed at once, to save memory.
        """
        encoded = encode_chunks(
            self.prepared,
            quality_db,
            compress=self._in_files,
            executor=self.executor,
            progress=self.progress,
        )
        return measure_whole(encoded, self.evaluator)


def mean_psnr_db(encoded: EncodedScene) -> float:
    """Return the mean PSNR over the test views in a scene's report, dB.

    Parameters
    ----------
    encoded : EncodedScene
        Measured or finished scene.
    """
    return float(np.mean(encoded.report.test_psnr_db))
