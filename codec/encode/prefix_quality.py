"""The PSNR of an encoded scene and of its prefixes, measured in views that the encoder has."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError
from cogsplat.codec.metrics import psnr
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.render.rasteriser import RenderConfig, render
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import ordered_map, thread_count
from cogsplat.codec.views.view_sets import evenly

from .encoded import EncodedScene
from .measured_prefixes import interpolated, measured_prefixes

PREFIX_VIEWS: Final = 8
"""Views that prefixes are predicted in, at most."""

WHOLE_VIEWS: Final = 32
"""Views that the whole is predicted in, at most: a mean over few depends on which they are."""

# Prefixes that are measured at most: each takes a rendering of every view.
_PREFIXES: Final = 8


class PrefixEvaluator:
    """Measures the PSNR of scenes against pictures of the source in some views.

    Parameters
    ----------
    source : Splats
    views : sequence of Camera
        In the frame of the means; never held-out views, which judge the result.
    threads : int
        0 for all cores; the figures do not depend on it.

    Raises
    ------
    DataError
        ``no-cameras``.
    """

    def __init__(self, source: Splats, views: Sequence[Camera], threads: int = 0) -> None:
        if not views:
            raise DataError("no-cameras", "0 views to predict quality in, expected at least 1")
        self._views = list(views)
        self._threads = thread_count(threads)
        info = source.info
        self._config = RenderConfig(info.kernel_px, info.antialiased, threads=1)
        self._expected = list(self._pictures(source))

    def _pictures(self, splats: Splats) -> Sequence[NDArray[np.float32]]:
        def draw(view: Camera) -> NDArray[np.float32]:
            return render(splats, view, self._config)

        return list(ordered_map(draw, self._views, self._threads))

    def psnr_db(self, splats: Splats) -> float:
        """Return the mean PSNR of a scene against the source, dB, at most 100."""
        return float(np.mean(self.views_db(splats)))

    def views_db(self, splats: Splats) -> list[float]:
        """Return the PSNR of a scene against the source in each view, dB, at most 100."""
        found = self._pictures(splats)
        return [float(psnr(a, b)) for a, b in zip(self._expected, found, strict=True)]

    def prefixes_db(
        self,
        encoded: EncodedScene,
        *,
        whole_db: float | None = None,
        progress: Progress = silent,
    ) -> list[float]:
        """Return the PSNR of the first chunk, of the first two, and so on to all, dB.

        Parameters
        ----------
        encoded : EncodedScene
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
                prefix = encoded.decoded.take(slice(0, sum(counts[:chunks])))
                values.append(self.psnr_db(prefix))
            progress("predict", done, len(measured))
        return [float(x) for x in interpolated(counts, measured, np.array(values))]


def predicted(
    encoded: EncodedScene,
    source: Splats,
    views: Sequence[Camera],
    *,
    most_views: int = PREFIX_VIEWS,
    threads: int = 0,
    progress: Progress = silent,
) -> EncodedScene:
    """Return an encoded scene whose chunks state the PSNR of the scene that ends with them.

    Parameters
    ----------
    encoded : EncodedScene
    source : Splats
        What it was encoded from.
    views : sequence of Camera
        Views that the encoder may look at. The whole is measured in at most `WHOLE_VIEWS` of
        them, spread evenly.
    most_views : int
        Prefixes are measured in so many of these, and what the whole has there less than in all
        of them is added.
    threads : int
        0 for all cores.
    progress : Progress
        As `PrefixEvaluator.prefixes_db`.

    Returns
    -------
    EncodedScene
        Its report has the PSNR of the whole in each view.
    """
    for_whole = evenly(views, WHOLE_VIEWS)
    for_prefixes = evenly(for_whole, most_views)
    evaluator = PrefixEvaluator(source, for_prefixes, threads)
    others = [view for view in for_whole if not any(view is other for other in for_prefixes)]
    whole = evaluator.views_db(encoded.decoded)
    qualities = evaluator.prefixes_db(encoded, whole_db=float(np.mean(whole)), progress=progress)
    if others:
        whole += PrefixEvaluator(source, others, threads).views_db(encoded.decoded)
    shift = float(np.mean(whole)) - qualities[-1] if qualities else 0.0
    chunks = [
        replace(chunk, quality_db=quality + shift)
        for chunk, quality in zip(encoded.chunks, qualities, strict=True)
    ]
    report = replace(encoded.report, test_psnr_db=tuple(whole))
    return replace(encoded, chunks=chunks, report=report)
