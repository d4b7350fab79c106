"""Rendering of partly received files."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.executor import LocalThreads
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.segments.chunk_sets import (
    descendant_parts,
    equivalent_prefixes,
    has_all_parents,
)
from cogsplat.codec.segments.prefix_compensation import Compensation
from cogsplat.codec.splats import Splats, concatenate
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.reader import CogsFile
from cogsplat.tools.lab.scheduling.chunk_ratios import visible_splat_counts
from cogsplat.tools.lab.scheduling.growth import growth, missing_splats
from cogsplat.tools.lab.scheduling.scene_rows import scene_rows

from .client import CHUNK_KINDS, Units

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]
I64 = NDArray[np.int64]


class PartialRenderer:
    """Renderer of a scene from any subset of its segments.

    Parameters
    ----------
    file : CogsFile
        Open file. Its chunks are decoded when a picture needs them, so that a few chunks of a
        large file take little memory.
    threads : int
        Threads for rendering and scoring; 0 for one per core.
    compensate : bool
        Whether to apply compensation for missing chunks (SPEC 8.5): to prefixes of the file and, in
        a file of cells, to sets of chunks that contain all their parents.
    """

    def __init__(self, file: CogsFile, threads: int = 0, *, compensate: bool = False) -> None:
        self._file = file
        self._threads = threads
        counts = file.chunks.splats[: file.complete_chunks()].astype(np.int64)
        ends = np.cumsum(counts)
        self._runs = [
            slice(int(end - count), int(end)) for end, count in zip(ends, counts, strict=True)
        ]
        self._rows = scene_rows(file.indices, file.parents())
        self._has_cells = bool(file.chunks.cell.all())
        self._compensation: Compensation | None = file.compensation() if compensate else None

    @property
    def chunks(self) -> int:
        """Number of complete chunks."""
        return len(self._runs)

    @cached_property
    def splats(self) -> Splats:
        """Complete scene with refinements, in chunk order."""
        return self._file.decode(range(self.chunks), extras=False)

    def rows(self, chunk: int) -> slice:
        """Return the rows of a chunk in `splats`."""
        return self._runs[chunk]

    def splat_contributions(self, camera: Camera, splats: Splats | None = None) -> F64:
        """Return the contribution of each splat to a view, (N,); by default of the full scene."""
        # Imported late: commands that only decode need no compiler.
        from cogsplat.codec.scoring.contribution import score
        from cogsplat.codec.scoring.score_config import ScoreConfig

        config = ScoreConfig(jitter=False, threads=self._threads)
        return score(self.splats if splats is None else splats, [camera], config).contribution

    def chunk_contributions(self, camera: Camera) -> F64:
        """Return the contribution of each chunk to a view, (c,) float64."""
        by_splat = self.splat_contributions(camera)
        starts = [run.start for run in self._runs]
        return np.add.reduceat(by_splat, starts) if starts else np.zeros(0)

    def panorama_shares(self, positions: NDArray[np.floating], progress: Progress = silent) -> F64:
        """Return each chunk's share of the panoramas of viewpoints, (V, c) float64.

        Parameters
        ----------
        positions : (V, 3)
            Viewpoints, scene units.
        progress : Progress
            See `scoring.panorama_shares`.
        """
        # Imported late: commands that only decode need no compiler.
        from cogsplat.codec.scoring.panorama_shares import panorama_shares

        chunk_of_rows = np.repeat(np.arange(self.chunks), [r.stop - r.start for r in self._runs])
        executor = LocalThreads(self._threads)
        return panorama_shares(
            self.splats, chunk_of_rows, self.chunks, positions, executor=executor, progress=progress
        )

    def picture(self, camera: Camera, splats: Splats | None = None) -> F32:
        """Render splats, by default the full scene, to an (H, W, 3) picture of values 0 to 1."""
        from cogsplat.codec.render.rasteriser import RenderConfig, render

        scene = self.splats if splats is None else splats
        return np.clip(render(scene, camera, RenderConfig(threads=self._threads)), 0.0, 1.0)

    def splats_of_units(
        self, units: Units, present: Iterable[int], ratios: F64 | None = None
    ) -> Splats:
        """Return the splats that a client with some of the units draws.

        Chunks without refinement give coarse splats. Chunks without tail have higher SH
        coefficients of zero.

        Parameters
        ----------
        units : Units
        present : iterable of int
            Units received.
        ratios : (r,) float64, optional
            Visibility ratio of each row at the pose, for compensation (docs/streaming.md, 10). By
            default all rows count fully.
        """
        there = list(present)
        kinds: dict[int, set[int]] = {}
        for unit in there:
            if units.kind[unit] in CHUNK_KINDS:
                kinds.setdefault(int(units.row[unit]), set()).add(int(units.kind[unit]))
        chunks = sorted(chunk for chunk, have in kinds.items() if SegmentKind.HEAD in have)
        is_fine = np.array([SegmentKind.REFINEMENT in kinds[chunk] for chunk in chunks], np.bool_)
        has_tail = np.array([SegmentKind.TAIL in kinds[chunk] for chunk in chunks], np.bool_)
        numbers = np.array(chunks, np.int64)
        decoded = [
            self._file.decode(
                numbers[is_refined == is_fine].tolist(), extras=False, refine=is_refined
            )
            for is_refined in (True, False)
        ]
        counts = self._file.chunks.splats[numbers]
        decoded_as = np.argsort(~is_fine, kind="stable")
        order = np.argsort(np.repeat(decoded_as, counts[decoded_as]), kind="stable")
        out = concatenate(decoded).take(order)
        out.shN[np.repeat(~has_tail, counts)] = 0.0
        return self._compensate(out, numbers, units.pages_in(there), ratios)

    def _compensate(
        self, splats: Splats, chunks: I64, pages: list[int], ratios: F64 | None
    ) -> Splats:
        """Apply compensation to the splats of chunks, if the file defines it for this set."""
        if self._compensation is None or not len(chunks):
            return splats
        # Rows of the chunks and unread pages that the client knows, numbered in file order.
        known = self._rows.known(pages)
        unread = known[known >= self._rows.chunks]
        listed = min(self._rows.first_chunk[unread], default=self._rows.chunks)
        layers = [layer for layer in self._compensation.layers if layer.chunks <= listed]
        compensation = replace(self._compensation, layers=layers)
        if not self._has_cells:
            if not np.array_equal(chunks, np.arange(len(chunks))):
                return splats
            prefix = np.full(len(chunks), len(chunks), np.int64)
            return compensation.apply_per_chunk(splats, chunks, prefix)
        place = np.full(len(self._rows) + 1, -1, np.int64)
        place[known] = np.arange(len(known))
        parents, held = place[self._rows.parent[known]], place[chunks].tolist()
        if not has_all_parents(held, parents):
            return splats
        counts = self._rows.splats[known]
        if ratios is not None:
            counts = visible_splat_counts(counts, ratios[known])
        first_chunks = np.append(self._rows.first_chunk[known], self._rows.chunks)
        last = int(np.searchsorted(first_chunks, compensation.last_chunks))
        prefixes = first_chunks[equivalent_prefixes(held, parents, counts)]
        parts = descendant_parts(held, parents, counts, last)
        shifted = compensation.apply_per_chunk(splats, chunks, prefixes, parts)
        is_held = np.isin(np.arange(len(known)), held)
        missing = missing_splats(is_held, parents, counts)
        return self._grow(shifted, chunks[chunks >= compensation.last_chunks], known, missing)

    def _grow(self, splats: Splats, chunks: I64, known: I64, missing: I64) -> Splats:
        """Return the splats of the chunks held, larger in chunks of which a child is missing.

        Parameters
        ----------
        splats : Splats
            Splats of all chunks held; those of `chunks` are the last of them.
        chunks : (k,) int64
            Chunks that come after those of the last compensation layer, ascending.
        known : (r,) int64
            Rows that the indices read list, held or not, in the order of the file.
        missing : (r,) int64
            Number of missing splats at each of these rows (`missing_splats`).
        """
        children: dict[int, list[int]] = {}
        for place in np.flatnonzero(np.isin(self._rows.parent[known], chunks)).tolist():
            children.setdefault(int(self._rows.parent[known[place]]), []).append(place)
        scales = splats.scales.copy()
        end = len(splats)
        for chunk in chunks[::-1].tolist():
            start = end - int(self._rows.splats[chunk])
            below = children.get(chunk, [])
            if missing[below].any():
                boxes = self._rows.box[known[below]]
                scales[start:end] += growth(splats.means[start:end], boxes, missing[below])[:, None]
            end = start
        return replace(splats, scales=scales)
