"""Measure the PSNR of an encoded scene and of its prefixes in test views."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError
from cogsplat.codec.executor import Executor, LocalThreads
from cogsplat.codec.metrics import PSNR_CAP_DB, psnr
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.render.rasteriser import RenderConfig, render_tiles
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import thread_count
from cogsplat.codec.views.view_sets import sample_evenly

from .encoded import EncodedScene
from .prefix_sampling import choose_prefixes, interpolate_prefixes

PREFIX_VIEWS: Final = 8
"""Views at most in which prefixes are predicted."""

# Minimum number of pixels compared per view; larger views are subsampled by tiles. The mean PSNR of
# 32 views changes by a few hundredths of a dB.
_MIN_PIXELS: Final = 1 << 17
# Measured prefixes at most: each renders every view.
_MAX_PREFIXES: Final = 8


def _draw(
    view: Camera, splats: Splats, *, config: RenderConfig, first: int | None = None
) -> NDArray[np.float32]:
    """Render the compared pixels of a view, (P, 3), from all splats or the `first` ones."""
    splats = splats.take(slice(0, first))
    every = max(1, view.width * view.height // _MIN_PIXELS)
    return render_tiles(splats, view, every, config)


class PrefixEvaluator:
    """Evaluator of the PSNR of scenes against renders of the source in test views.

    Parameters
    ----------
    source : Splats
        Ground truth.
    views : sequence of Camera
        Test views in the frame of the means; never the held-out views that judge the result.
    threads : int
        Number of threads, 0 for all cores; the values do not depend on it.
    views_at_once : bool
        Render a view on each core; otherwise all cores render one view, which takes less memory.
    executor : Executor, optional
        Runs the work of single views; None for threads of this process.

    Raises
    ------
    DataError
        ``no-cameras``: no test views.
    """

    def __init__(
        self,
        source: Splats,
        views: Sequence[Camera],
        threads: int = 0,
        *,
        views_at_once: bool = True,
        executor: Executor | None = None,
    ) -> None:
        if not views:
            raise DataError("no-cameras", "0 views to predict quality in, expected at least 1")
        self._views = list(views)
        count = thread_count(threads)
        by_view = views_at_once or executor is not None
        self._executor = executor or LocalThreads(count if by_view else 1)
        self._config = RenderConfig(threads=1 if by_view else count)
        draw = partial(_draw, config=self._config)
        self._expected = list(self._executor.map(draw, views, source))

    def psnr_db(self, splats: Splats) -> float:
        """Return the mean PSNR of a scene over the test views, dB, at most 100.

        Parameters
        ----------
        splats : Splats
            Scene to measure.
        """
        return float(np.mean(self.views_db(splats)))

    def views_db(
        self, splats: Splats, views: Sequence[int] | None = None, *, first: int | None = None
    ) -> list[float]:
        """Return the PSNR of a scene in each test view, dB, at most 100.

        Parameters
        ----------
        splats : Splats
            Scene to measure.
        views : sequence of int, optional
            Numbers of the test views to render; None for all.
        first : int, optional
            Number of splats to render, from the first on; None for all.
        """
        numbers = range(len(self._views)) if views is None else views

        seen = [self._views[number] for number in numbers]
        draw = partial(_draw, config=self._config, first=first)
        found = self._executor.map(draw, seen, splats)
        return [
            float(psnr(self._expected[number], pixels))
            for number, pixels in zip(numbers, found, strict=True)
        ]

    def _prefix_db(
        self, encoded: EncodedScene, chunks: int, views: Sequence[int] | None
    ) -> list[float]:
        """Return the PSNR of a prefix in each view, dB."""
        if any(chunk.until for chunk in encoded.chunks):
            return self.views_db(encoded.prefix_splats(chunks), views)
        # The same array for all prefixes: an executor sends it to its workers once.
        first = sum(chunk.splats for chunk in encoded.chunks[:chunks])
        return self.views_db(encoded.decoded, views, first=first)

    def prefixes_db(
        self,
        encoded: EncodedScene,
        *,
        views: Sequence[int] | None = None,
        whole_db: float | None = None,
        progress: Progress = silent,
    ) -> list[float]:
        """Return the mean PSNR of the prefixes of 1, 2, … all chunks, dB.

        Parameters
        ----------
        encoded : EncodedScene
            Scene to measure.
        views : sequence of int, optional
            Numbers of the test views to render; None for all.
        whole_db : float, optional
            Known mean PSNR of the whole scene in these views, dB.
        progress : Progress
            Called with ``predict``, measured prefixes and prefixes to measure.

        Returns
        -------
        list of float
            PSNR of each prefix. At most 8 are measured; the others are interpolated
            (`interpolate_prefixes`).
        """
        counts = [chunk.splats for chunk in encoded.chunks]
        measured = choose_prefixes(counts, _MAX_PREFIXES)
        values: list[float] = []
        progress("predict", 0, len(measured))
        for done, chunks in enumerate(measured.tolist(), start=1):
            if chunks == len(counts) and whole_db is not None:
                values.append(whole_db)
            else:
                values.append(float(np.mean(self._prefix_db(encoded, chunks, views))))
            progress("predict", done, len(measured))
        return [float(x) for x in interpolate_prefixes(counts, measured, np.array(values))]


def measure_whole(encoded: EncodedScene, evaluator: PrefixEvaluator) -> EncodedScene:
    """Return an encoded scene with its PSNR in each test view added to the report.

    Parameters
    ----------
    encoded : EncodedScene
        Scene to measure.
    evaluator : PrefixEvaluator
        Evaluator with the ground truth.
    """
    values = tuple(evaluator.views_db(encoded.prefix_splats(len(encoded.chunks))))
    return replace(encoded, report=replace(encoded.report, test_psnr_db=values))


def predict_quality(
    encoded: EncodedScene,
    evaluator: PrefixEvaluator,
    *,
    most_views: int = PREFIX_VIEWS,
    progress: Progress = silent,
) -> EncodedScene:
    """Predict the PSNR of each prefix and store it in the prefix's last chunk.

    Parameters
    ----------
    encoded : EncodedScene
        Scene to predict. A PSNR of the whole in its report (`measure_whole`) is not measured again.
    evaluator : PrefixEvaluator
        Evaluator with the ground truth.
    most_views : int
        Test views at most in which prefixes are measured, evenly spread. Their PSNR is corrected by
        the difference of the whole scene between these and all test views.
    progress : Progress
        Called with ``predict``.

    Returns
    -------
    EncodedScene
        Scene with predictions; its report has the PSNR of the whole in each test view.

    Notes
    -----
    A correction that is larger than the PSNR of a short prefix gives 0, which stands for no
    prediction (SPEC 5.4).
    """
    if not encoded.report.test_psnr_db:
        encoded = measure_whole(encoded, evaluator)
    whole = encoded.report.test_psnr_db
    some = sample_evenly(range(len(whole)), most_views)
    there = float(np.mean([whole[number] for number in some]))
    qualities = evaluator.prefixes_db(encoded, views=some, whole_db=there, progress=progress)
    shift = float(np.mean(whole)) - there
    chunks = [
        replace(chunk, quality_db=min(max(quality + shift, 0.0), PSNR_CAP_DB))
        for chunk, quality in zip(encoded.chunks, qualities, strict=True)
    ]
    return replace(encoded, chunks=chunks)
