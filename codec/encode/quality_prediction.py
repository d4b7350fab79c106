"""The PSNR of an encoded scene and of its prefixes, measured in views that the encoder has."""

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
from .measured_prefixes import interpolated, measured_prefixes

PREFIX_VIEWS: Final = 8
"""Views that prefixes are predicted in, at most."""

# Pixels of a view that are compared at least, where it has so many: one tile in so many. The mean
# over 32 views moves by a few hundredths of a dB.
_PIXELS: Final = 1 << 17
# Prefixes that are measured at most: each takes a rendering of every view.
_PREFIXES: Final = 8


def _draw(
    view: Camera, splats: Splats, *, config: RenderConfig, size: int | None = None
) -> NDArray[np.float32]:
    """Return the pixels of a view that are compared, (P, 3): of all splats, or of the first."""
    splats = splats.take(slice(0, size))
    every = max(1, view.width * view.height // _PIXELS)
    return render_tiles(splats, view, every, config)


class PrefixEvaluator:
    """Measures the PSNR of scenes against pictures of the source in some views.

    Parameters
    ----------
    source : Splats
    views : sequence of Camera
        In the frame of the means; never held-out views, which judge the result.
    threads : int
        0 for all cores; the figures do not depend on it.
    views_at_once : bool
        Whether each core draws a view of its own; otherwise all draw one, which takes less memory.
    executor : Executor, optional
        What runs the work of single views; threads of this process where it is not given.

    Raises
    ------
    DataError
        ``no-cameras``.
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
        info = source.info
        self._config = RenderConfig(
            info.kernel_px, info.antialiased, threads=1 if by_view else count
        )
        draw = partial(_draw, config=self._config)
        self._expected = list(self._executor.map(draw, views, source))

    def psnr_db(self, splats: Splats) -> float:
        """Return the mean PSNR of a scene against the source, dB, at most 100."""
        return float(np.mean(self.views_db(splats)))

    def views_db(
        self, splats: Splats, views: Sequence[int] | None = None, *, size: int | None = None
    ) -> list[float]:
        """Return the PSNR of a scene against the source in each view, dB, at most 100.

        Parameters
        ----------
        splats : Splats
        views : sequence of int, optional
            Numbers of the views to draw; all of them where it is not given.
        size : int, optional
            How many of the splats are drawn, from the first on; all where it is not given.
        """
        numbers = range(len(self._views)) if views is None else views

        seen = [self._views[number] for number in numbers]
        draw = partial(_draw, config=self._config, size=size)
        found = self._executor.map(draw, seen, splats)
        return [
            float(psnr(self._expected[number], pixels))
            for number, pixels in zip(numbers, found, strict=True)
        ]

    def _prefix_db(
        self, encoded: EncodedScene, chunks: int, views: Sequence[int] | None
    ) -> list[float]:
        """Return the PSNR of the first chunks in each view, dB."""
        if any(chunk.until for chunk in encoded.chunks):
            return self.views_db(encoded.drawn(chunks), views)
        # One object for all prefixes, which an executor hands to its workers once.
        size = sum(chunk.splats for chunk in encoded.chunks[:chunks])
        return self.views_db(encoded.decoded, views, size=size)

    def prefixes_db(
        self,
        encoded: EncodedScene,
        *,
        views: Sequence[int] | None = None,
        whole_db: float | None = None,
        progress: Progress = silent,
    ) -> list[float]:
        """Return the PSNR of the first chunk, of the first two, and so on to all, dB.

        Parameters
        ----------
        encoded : EncodedScene
        views : sequence of int, optional
            Numbers of the views to draw; all of them where it is not given.
        whole_db : float, optional
            PSNR of all chunks in these views, where it is known; then it is not measured again.
        progress : Progress
            Called with ``predict``, prefixes measured and prefixes to measure.

        Returns
        -------
        list of float
            One per chunk. At most 8 prefixes are measured; the values of those between are
            interpolated by the logarithm of their splats.
        """
        counts = [chunk.splats for chunk in encoded.chunks]
        measured = measured_prefixes(counts, _PREFIXES)
        values: list[float] = []
        progress("predict", 0, len(measured))
        for done, chunks in enumerate(measured.tolist(), start=1):
            if chunks == len(counts) and whole_db is not None:
                values.append(whole_db)
            else:
                values.append(float(np.mean(self._prefix_db(encoded, chunks, views))))
            progress("predict", done, len(measured))
        return [float(x) for x in interpolated(counts, measured, np.array(values))]


def measure_whole(encoded: EncodedScene, evaluator: PrefixEvaluator) -> EncodedScene:
    """Return an encoded scene whose report has the PSNR of the whole in each view."""
    values = tuple(evaluator.views_db(encoded.drawn(len(encoded.chunks))))
    return replace(encoded, report=replace(encoded.report, test_psnr_db=values))


def predict_quality(
    encoded: EncodedScene,
    evaluator: PrefixEvaluator,
    *,
    most_views: int = PREFIX_VIEWS,
    progress: Progress = silent,
) -> EncodedScene:
    """Return an encoded scene whose chunks state the PSNR of the scene that ends with them.

    Parameters
    ----------
    encoded : EncodedScene
        Where its report has the PSNR of the whole in each view (`measure_whole`), the whole is not
        drawn again.
    evaluator : PrefixEvaluator
        Of what it was encoded from.
    most_views : int
        Prefixes are measured in so many of its views, spread evenly, and what the whole has there
        less than in all of them is added.
    progress : Progress
        As `PrefixEvaluator.prefixes_db`.

    Returns
    -------
    EncodedScene
        Its report has the PSNR of the whole in each view.

    Notes
    -----
    Where the whole is far better in the views that prefixes are measured in than in the others,
    the first prefixes may have fewer dB than is taken away from them. They say 0, which stands for
    nothing predicted (SPEC 5.4).
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
