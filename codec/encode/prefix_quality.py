"""What an encoded scene will look like, in views that the encoder has: decoded and rendered."""

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
from cogsplat.codec.segments.codebooks import (
    Codebook,
    decode_colour_codebook,
    decode_shape_codebook,
)
from cogsplat.codec.segments.heads import decode_head
from cogsplat.codec.segments.tails import decode_tail
from cogsplat.codec.splats import Splats, concatenate, empty
from cogsplat.codec.threads import ordered_map, thread_count
from cogsplat.codec.views.view_sets import evenly

from .encoded import EncodedChunk, EncodedScene

PREFIX_VIEWS: Final = 8
"""Views that prefixes are predicted in, at most."""

# Prefixes that are measured; those between are interpolated.
_PREFIXES: Final = 12


class PrefixEvaluator:
    """The source as some views show it, to hold encoded scenes against.

    Parameters
    ----------
    source : Splats
    views : sequence of Camera
        In the frame of the means; never views that judge the result.
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
        found = self._pictures(splats)
        values = [psnr(a, b) for a, b in zip(self._expected, found, strict=True)]
        return float(np.mean(values))

    def prefixes_db(self, encoded: EncodedScene, *, progress: Progress = silent) -> list[float]:
        """Return what the first chunks show, for every number of them from 1, dB.

        Parameters
        ----------
        encoded : EncodedScene
        progress : Progress
            Called with ``predict``, prefixes measured and prefixes to measure.

        Returns
        -------
        list of float
            One per chunk. Of many chunks some are measured, the others lie on lines between them.
        """
        count = len(encoded.chunks)
        if count == 0:
            return []
        splats = decoded(encoded, threads=self._threads)
        ends = np.cumsum([chunk.splats for chunk in encoded.chunks])
        measured = np.unique(np.linspace(0, count - 1, min(count, _PREFIXES)).round().astype(int))
        values = []
        progress("predict", 0, len(measured))
        for done, chunk in enumerate(measured, start=1):
            values.append(self.psnr_db(splats.take(slice(0, int(ends[chunk])))))
            progress("predict", done, len(measured))
        return [float(x) for x in np.interp(ends, ends[measured], values)]


def predicted(
    encoded: EncodedScene,
    source: Splats,
    views: Sequence[Camera],
    *,
    most_views: int = PREFIX_VIEWS,
    threads: int = 0,
    progress: Progress = silent,
) -> EncodedScene:
    """Return an encoded scene whose chunks say what is seen once they are there.

    Parameters
    ----------
    encoded : EncodedScene
    source : Splats
        What it was encoded from.
    views : sequence of Camera
        That the encoder may look at.
    most_views : int
        So many of them are rendered, spread evenly.
    threads : int
        0 for all cores.
    progress : Progress
        As `PrefixEvaluator.prefixes_db`.
    """
    evaluator = PrefixEvaluator(source, evenly(views, most_views), threads)
    qualities = evaluator.prefixes_db(encoded, progress=progress)
    chunks = [
        replace(chunk, quality_db=quality)
        for chunk, quality in zip(encoded.chunks, qualities, strict=True)
    ]
    return replace(encoded, chunks=chunks)


def decoded(encoded: EncodedScene, *, threads: int = 0) -> Splats:
    """Return a scene as a reader of its file will have it.

    Parameters
    ----------
    encoded : EncodedScene
    threads : int
        0 for all cores.
    """
    degree = encoded.scene.sh_degree
    books: dict[int, Codebook] = {}
    for number, book in enumerate(encoded.codebooks):
        payloads = [memoryview(payload) for payload in book.payloads]
        if book.attribute == "shape":
            books[number] = decode_shape_codebook(payloads[0], book.rows, "shape codebook")
        else:
            bands = dict(enumerate(payloads, start=1))
            books[number] = decode_colour_codebook(bands, book.rows, degree, "colour codebook")

    def decode(chunk: EncodedChunk) -> Splats:
        out = empty(degree, chunk.splats)
        fine = chunk.payloads.refinement
        refinement = None if fine is None else memoryview(fine)
        decode_head(memoryview(chunk.payloads.head), books, out, "chunk", refinement)
        if chunk.payloads.tail is not None:
            decode_tail(memoryview(chunk.payloads.tail), books, out.shN, "chunk")
        return out

    parts = list(ordered_map(decode, encoded.chunks, thread_count(threads)))
    whole = concatenate(parts) if parts else empty(degree)
    return replace(whole, info=encoded.scene.info)
