"""What a client that has some segments of a file draws, against the whole."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.partition.nested_cells import parents
from cogsplat.codec.segments.chunk_sets import equivalent_prefixes, has_all_parents
from cogsplat.codec.segments.prefix_compensation import Compensation
from cogsplat.codec.splats import Splats
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.reader import CogsFile
from cogsplat.tools.lab.scheduling.chunk_ratios import counted_splats

from .client import Units

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


class ShownScene:
    """A scene of which any of its segments may be there.

    Parameters
    ----------
    file : CogsFile
        Its chunks that are complete are decoded, with refinements and without.
    threads : int
        That draw.
    compensate : bool
        Whether what is there is changed to make up for what is missing, where SPEC 8.5 says how:
        for the first chunks of a file and, in one that is cut into cells, for chunks that each have
        their parent.
    """

    def __init__(self, file: CogsFile, threads: int = 0, *, compensate: bool = False) -> None:
        self._threads = threads
        chunks = range(file.complete_chunks())
        self._fine = file.decode(chunks, extras=False)
        self._coarse = file.decode(chunks, extras=False, refine=False)
        counts = file.chunks.splats[: len(chunks)].astype(np.int64)
        ends = np.cumsum(counts)
        self._runs = [
            slice(int(end - count), int(end)) for end, count in zip(ends, counts, strict=True)
        ]
        self._parents = parents(file.chunks.cell)
        self._is_cut = bool(file.chunks.cell.all())
        self._compensation: Compensation | None = file.compensation() if compensate else None

    @property
    def chunks(self) -> int:
        """Number of chunks."""
        return len(self._runs)

    @property
    def splats(self) -> Splats:
        """The whole scene, chunk by chunk, refined."""
        return self._fine

    def rows(self, chunk: int) -> slice:
        """Return the rows of `splats` that a chunk holds."""
        return self._runs[chunk]

    def contributions_of_splats(self, camera: Camera, splats: Splats | None = None) -> F64:
        """Return what each splat of the whole, or of others, contributes to a picture, (N,)."""
        # Imported late: commands that only decode need no compiler.
        from cogsplat.codec.scoring.contribution import ScoreConfig, score

        config = ScoreConfig(jitter=False, threads=self._threads)
        return score(self._fine if splats is None else splats, [camera], config).contribution

    def contributions(self, camera: Camera) -> F64:
        """Return what each chunk contributes to a picture, (c,) float64."""
        by_splat = self.contributions_of_splats(camera)
        starts = [run.start for run in self._runs]
        return np.add.reduceat(by_splat, starts) if starts else np.zeros(0)

    def picture(self, camera: Camera, splats: Splats | None = None) -> F32:
        """Return the picture of the whole, or of other splats: (H, W, 3), 0 to 1."""
        from cogsplat.codec.render.rasteriser import RenderConfig, render

        drawn = self._fine if splats is None else splats
        return np.clip(render(drawn, camera, RenderConfig(threads=self._threads)), 0.0, 1.0)

    def drawn(self, units: Units, there: Iterable[int], ratios: F64 | None = None) -> Splats:
        """Return what a client draws that has some units.

        Of chunks without their refinement that are coarse splats, without their tail ones of SH
        degree 0 but in the shape of the others.

        Parameters
        ----------
        units : Units
        there : iterable of int
            What the client has.
        ratios : (c,) float64, optional
            What the pose of the picture shows of each chunk; what is missing is made up for where
            the pose shows it (docs/streaming.md, 10). Without it everywhere alike.
        """
        kinds: dict[int, set[int]] = {}
        for unit in there:
            if units.chunk[unit] >= 0:
                kinds.setdefault(int(units.chunk[unit]), set()).add(int(units.kind[unit]))
        held = sorted(chunk for chunk, have in kinds.items() if SegmentKind.HEAD in have)
        is_fine = np.zeros(len(self._fine), np.bool_)
        has_tail = np.zeros(len(self._fine), np.bool_)
        for chunk, have in kinds.items():
            is_fine[self._runs[chunk]] = SegmentKind.REFINEMENT in have
            has_tail[self._runs[chunk]] = SegmentKind.TAIL in have
        rows = np.concatenate(
            [np.zeros(0, np.int64), *(np.arange(run.start, run.stop) for run in self._held(held))]
        )
        out = self._fine.take(rows)
        left = ~is_fine[rows]
        for name in ("means", "scales", "quats", "opacities", "sh0"):
            getattr(out, name)[left] = getattr(self._coarse, name)[rows[left]]
        out.shN[~has_tail[rows]] = 0.0
        return self._compensated(out, held, ratios)

    def _held(self, chunks: list[int]) -> list[slice]:
        return [self._runs[chunk] for chunk in chunks]

    def _compensated(self, splats: Splats, held: list[int], ratios: F64 | None) -> Splats:
        if self._compensation is None or not held:
            return splats
        is_prefix = held == list(range(len(held)))
        if not is_prefix and not (self._is_cut and has_all_parents(held, self._parents)):
            return splats
        counts = self._compensation.chunk_splats
        if ratios is not None:
            counts = counted_splats(counts, ratios)
        prefixes = equivalent_prefixes(held, self._parents, counts)
        return self._compensation.apply_per_chunk(splats, np.array(held, np.int64), prefixes)
