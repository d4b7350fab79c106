"""What a client that has some segments of a file draws, against the whole."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.metrics import psnr
from cogsplat.codec.splats import Splats
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.reader import CogsFile

from .client import Units

F64 = NDArray[np.float64]


class ShownScene:
    """A scene of which any of its segments may be there.

    Parameters
    ----------
    file : CogsFile
        Its chunks that are complete are decoded, with refinements and without.
    threads : int
        That draw.
    """

    def __init__(self, file: CogsFile, threads: int = 0) -> None:
        self._threads = threads
        chunks = range(file.complete_chunks())
        self._fine = file.decode(chunks, extras=False)
        self._coarse = file.decode(chunks, extras=False, refine=False)
        counts = file.chunks.splats[: len(chunks)].astype(np.int64)
        ends = np.cumsum(counts)
        self._runs = [
            slice(int(end - count), int(end)) for end, count in zip(ends, counts, strict=True)
        ]

    @property
    def chunks(self) -> int:
        """Number of chunks."""
        return len(self._runs)

    def contributions(self, camera: Camera) -> F64:
        """Return what each chunk contributes to a picture, (c,) float64."""
        # Imported late: commands that only decode need no compiler.
        from cogsplat.codec.scoring.contribution import ScoreConfig, score

        config = ScoreConfig(jitter=False, threads=self._threads)
        by_splat = score(self._fine, [camera], config).contribution
        starts = [run.start for run in self._runs]
        return np.add.reduceat(by_splat, starts) if starts else np.zeros(0)

    def picture(self, camera: Camera) -> NDArray[np.float32]:
        """Return the picture of the whole."""
        from cogsplat.codec.render.rasteriser import RenderConfig, render

        return np.clip(render(self._fine, camera, RenderConfig(threads=self._threads)), 0.0, 1.0)

    def psnr_db(
        self, units: Units, there: Iterable[int], camera: Camera, whole: NDArray[np.float32]
    ) -> float:
        """Return how near the picture of what is there comes to the whole, dB."""
        kinds: dict[int, set[int]] = {}
        for unit in there:
            if units.chunk[unit] >= 0:
                kinds.setdefault(int(units.chunk[unit]), set()).add(int(units.kind[unit]))
        keep = np.zeros(len(self._fine), np.bool_)
        is_fine = np.zeros(len(self._fine), np.bool_)
        has_tail = np.zeros(len(self._fine), np.bool_)
        for chunk, have in kinds.items():
            keep[self._runs[chunk]] = SegmentKind.HEAD in have
            is_fine[self._runs[chunk]] = SegmentKind.REFINEMENT in have
            has_tail[self._runs[chunk]] = SegmentKind.TAIL in have
        drawn = self._drawn(np.flatnonzero(keep), is_fine, has_tail)
        from cogsplat.codec.render.rasteriser import RenderConfig, render

        config = RenderConfig(threads=self._threads)
        return psnr(np.clip(render(drawn, camera, config), 0.0, 1.0), whole)

    def _drawn(
        self, rows: NDArray[np.intp], is_fine: NDArray[np.bool_], has_tail: NDArray[np.bool_]
    ) -> Splats:
        out = self._fine.take(rows)
        left = ~is_fine[rows]
        for name in ("means", "scales", "quats", "opacities", "sh0"):
            getattr(out, name)[left] = getattr(self._coarse, name)[rows[left]]
        out.shN[~has_tail[rows]] = 0.0
        return out
