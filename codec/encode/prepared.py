"""Order the splats of a scene and cut the order into chunks: the steps before quantisation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError
from cogsplat.codec.executor import Executor
from cogsplat.codec.order import chunk_plan, objects
from cogsplat.codec.order.gain_effort import GainEffort
from cogsplat.codec.order.orders import OrderInputs, order_rows
from cogsplat.codec.partition.nested_cells import (
    WHOLE_SCENE,
    NestedCells,
    Region,
    box_of_most,
    nested_cells,
)
from cogsplat.codec.partition.regions import split_regions
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.rate import allocation
from cogsplat.codec.rate.pruning import keep_mask
from cogsplat.codec.scoring.contribution import Scores
from cogsplat.codec.scoring.reference_views import ReferenceViews
from cogsplat.codec.scoring.splat_groups import GroupShares
from cogsplat.codec.segments.codebooks import EncodedCodebook
from cogsplat.codec.splats import Splats
from cogsplat.codec.streams.grid import MAX_VALUE
from cogsplat.codec.workspace import IN_MEMORY, Rearrangement, Workspace

from .config import EncodeConfig

# A cell's chunk holds at least 1/8 of the maximum; splats of smaller cells move to the next layer.
_CELL_DIVISOR: Final = 8

# Splats that a split into regions saves a view at least, in smallest chunks: a split adds about
# two chunks. With 2, a house of six rooms takes 5 % more bytes than without cells, with 3, 2 %.
_LEAST_SAVING_CHUNKS: Final = 3

# Most splats that decide on the box of surroundings, sampled evenly.
_BOX_SPLATS: Final = 1 << 16

# Rows that are checked at a time; comparing all at once would copy the scene.
_BLOCK: Final = 1 << 16


@dataclass(frozen=True, eq=False)
class ChunkedScene:
    """Splats that are stored, in the order of their chunks.

    Parameters
    ----------
    source : Splats
        Scene that is encoded; of mapped arrays, a copy of the stored splats in chunk order.
    rows : (n,) int64
        Row numbers of the stored splats in the source, in chunk order.
    scores : Scores
        Scores of the source.
    lagrangian : float
        λ of the whole scene at the nominal quality (`allocation.lagrangian`).
    slices : sequence of slice
        Range of `rows` of each chunk, contiguous.
    objects : (c,) uint32
        Object label of each chunk; zeros for chunks not cut by object.
    cells : (c,) uint32
        Cell of each chunk (SPEC 5.4); zeros for chunks not cut by cell.
    config : EncodeConfig
        Configuration of the encode.
    workspace : Workspace
        Allocator of long arrays.
    codebooks : sequence of EncodedCodebook
        Initial codebooks of the profile ``vq``, as in `PreparedScene`.
    basis : EncodedCodebook or None
        Basis of shN of another file, as in `PreparedScene`.
    """

    source: Splats
    rows: NDArray[np.int64]
    scores: Scores
    lagrangian: float
    slices: Sequence[slice]
    objects: NDArray[np.uint32]
    cells: NDArray[np.uint32]
    config: EncodeConfig
    workspace: Workspace
    codebooks: Sequence[EncodedCodebook] = ()
    basis: EncodedCodebook | None = None

    def part(self, run: slice) -> Splats:
        """Return the splats of a range of `rows`, copied from the source.

        Copies of all rows at once would be a second scene in memory.

        Parameters
        ----------
        run : slice
            Range of `rows`.
        """
        return self.workspace.take(self.source, self.rows[run])


@dataclass(eq=False)
class PreparedScene:
    """Ordered scene that can be encoded at several qualities; caches its last chunks.

    Parameters
    ----------
    source : Splats
        Scene that is encoded.
    rows : (n,) int64
        Source rows of the splats, in encoding order, without splats too transparent to be drawn.
    scores : Scores
        Scores of the source.
    config : EncodeConfig
        Configuration of the encode.
    workspace : Workspace
        Allocator of decoded splats.
    codebooks : sequence of EncodedCodebook
        Codebooks of an earlier encode of nearly the same scene, from which the profile ``vq``
        starts; empty to start afresh.
    basis : EncodedCodebook or None
        Basis of shN of another file, to use as it is; None to fit one.
    regions : Region
        Regions of a scene that is cut into cells.
    """

    source: Splats
    rows: NDArray[np.int64]
    scores: Scores
    config: EncodeConfig
    workspace: Workspace = IN_MEMORY
    codebooks: Sequence[EncodedCodebook] = ()
    basis: EncodedCodebook | None = None
    regions: Region = WHOLE_SCENE
    # Kept rows and chunks of the last call. A search for a target often keeps the same splats in
    # every trial, and cutting a large scene takes longer than comparing row numbers.
    _last: tuple[NDArray[np.int64], ChunkedScene] | None = field(
        default=None, init=False, repr=False
    )

    def lay_out(self, quality_db: float) -> ChunkedScene:
        """Prune the splats at a nominal quality and cut the rest into chunks.

        Parameters
        ----------
        quality_db : float
            Nominal PSNR, dB.
        """
        lagrangian = allocation.lagrangian(self.scores, quality_db)
        kept = keep_mask(self.source, self.scores, self.config.pruning, lagrangian)
        rows = self.rows[kept[self.rows]]
        if self._last is None or not np.array_equal(self._last[0], rows):
            self._last = rows, _cut_chunks(self, rows, lagrangian)
        return replace(self._last[1], lagrangian=lagrangian)


def prepare(
    splats: Splats,
    scores: Scores,
    config: EncodeConfig,
    *,
    views: Sequence[Camera] = (),
    jitter: bool = True,
    references: ReferenceViews | None = None,
    effort: GainEffort | None = None,
    basis: EncodedCodebook | None = None,
    group_shares: GroupShares | None = None,
    workspace: Workspace = IN_MEMORY,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> PreparedScene:
    """Order the splats of a scene; leave out splats that are too transparent to be drawn.

    Parameters
    ----------
    splats : Splats
        Scene with valid rows (`Splats.require_valid`).
    scores : Scores
        Scores of the splats; `zero_scores` without rendered views.
    config : EncodeConfig
        Configuration of the encode.
    views : sequence of Camera
        Scored views, for orders that render.
    jitter : bool
        Use jittered copies of the views in orders that render.
    references : ReferenceViews, optional
        Pictures of the scene in the views, if they are rendered already.
    effort : GainEffort, optional
        Effort of the order by marginal gain.
    basis : EncodedCodebook, optional
        Basis of shN of another file, to use as it is.
    group_shares : GroupShares, optional
        Shares of groups of splats in the views, from which cells get regions.
    workspace : Workspace
        Allocator of decoded splats.
    executor : Executor, optional
        Runs the work of single views; None for threads of this process.
    progress : Progress
        Called with the stages of orders that render.

    Raises
    ------
    DataError
        ``invalid-rows``; ``value-range`` where a value is beyond what the format holds;
        ``scores-mismatch`` where the scores are another scene's.
    """
    splats.require_valid()
    _require_storable(splats)
    _require_scores(scores, len(splats))
    kept = keep_mask(splats, scores, config.pruning, 0.0)
    scene = OrderInputs(
        splats,
        scores,
        views,
        config.threads,
        progress,
        jitter,
        references,
        executor,
        effort or GainEffort(),
    )
    inflated = config.ordering.inflated and config.compensate
    rows = order_rows(config.order, scene, replace(config.ordering, inflated=inflated))
    regions = WHOLE_SCENE
    if config.cells:
        regions = _find_regions(splats, scores, config, group_shares)
    return PreparedScene(
        splats, rows[kept[rows]], scores, config, workspace, basis=basis, regions=regions
    )


def _find_regions(
    splats: Splats, scores: Scores, config: EncodeConfig, seen: GroupShares | None
) -> Region:
    """Return the tree of regions, by the splats that pruning keeps at the nominal quality."""
    smallest, _ = _cell_sizes(config)
    lagrangian = allocation.lagrangian(scores, config.quality_db)
    stored = np.flatnonzero(keep_mask(splats, scores, config.pruning, lagrangian))
    if not len(stored):
        return WHOLE_SCENE
    box = box_of_most(splats.means[stored[:: -(-len(stored) // _BOX_SPLATS)]])
    around = Region(box=box)
    has_surroundings = np.count_nonzero(around.in_second_half(splats.means, stored)) >= smallest
    found = WHOLE_SCENE
    if seen is not None:
        counts = np.bincount(seen.groups.numbers[stored], minlength=len(seen.groups))
        centres = seen.groups.centres
        chosen = np.arange(len(centres))
        if has_surroundings:
            chosen = chosen[~around.in_second_half(centres, chosen)]
        found = split_regions(
            centres[chosen],
            counts[chosen],
            seen.shares[:, chosen],
            smallest=smallest,
            saving=_LEAST_SAVING_CHUNKS * smallest,
        )
    return Region(halves=(found, WHOLE_SCENE), box=box) if has_surroundings else found


def _cut_chunks(
    prepared: PreparedScene, rows: NDArray[np.int64], lagrangian: float
) -> ChunkedScene:
    """Cut ordered rows into chunks."""
    splats, scores, config = prepared.source, prepared.scores, prepared.config
    if config.order == "gain" and not config.ordering.by_object:
        # Chunks were sorted before pruning, which shifts splats between chunks: sort again. Orders
        # for a first pose keep their order. Cells are cut from layers of the default chunk size.
        largest = chunk_plan.DEFAULT_CHUNK_SPLATS if config.cells else config.chunk_splats
        rows = chunk_plan.sort_runs(rows, scores.contribution, largest, config.ordering.run_chunks)
    cells: NDArray[np.uint32] | None = None
    if config.cells:
        nested = _cut_cells(prepared, rows)
        cells = nested.cells.astype(np.uint32)
        unlabelled = np.zeros(len(cells), np.uint32)
        arranged = objects.ChunkedOrder(rows[nested.order], nested.slices, unlabelled)
    elif config.ordering.by_object:
        arranged = objects.chunk_by_object(
            rows,
            objects.labels_of(splats),
            scores.contribution,
            config.chunk_splats,
            config.ordering.object_budgets,
        )
    else:
        slices = chunk_plan.plan_chunks(len(rows), config.chunk_splats)
        arranged = objects.ChunkedOrder(rows, slices, np.zeros(len(slices), np.uint32))
    rows, workspace = arranged.rows, prepared.workspace
    if workspace.in_files:
        gather = Rearrangement(workspace, rows).gather
        splats, scores = workspace.take(splats, rows, gather), scores.take(rows, gather)
        rows = np.arange(len(rows))
    return ChunkedScene(
        source=splats,
        rows=rows,
        scores=scores,
        lagrangian=lagrangian,
        slices=arranged.slices,
        objects=arranged.objects,
        cells=np.zeros(len(arranged.slices), np.uint32) if cells is None else cells,
        config=config,
        workspace=workspace,
        codebooks=prepared.codebooks,
        basis=prepared.basis,
    )


def _cut_cells(prepared: PreparedScene, rows: NDArray[np.int64]) -> NestedCells:
    """Cut ordered rows into layers of nested cells."""
    smallest, largest = _cell_sizes(prepared.config)
    means = prepared.workspace.gather(prepared.source.means, rows).astype(np.float64)
    weights = prepared.workspace.gather(prepared.scores.contribution, rows)
    return nested_cells(
        means,
        weights,
        first=min(chunk_plan.FIRST_SPLATS, largest),
        growth=chunk_plan.GROWTH,
        smallest=smallest,
        largest=largest,
        regions=prepared.regions,
    )


def _cell_sizes(config: EncodeConfig) -> tuple[int, int]:
    """Return the limits of the splats of a cell's chunk."""
    largest = config.chunk_splats
    return min(chunk_plan.FIRST_SPLATS, max(largest // _CELL_DIVISOR, 1)), largest


def _require_scores(scores: Scores, splats: int) -> None:
    """Refuse scores of another number of splats."""
    for name in ("contribution", "energy", "peak", "covered"):
        length = len(getattr(scores, name))
        if length != splats:
            raise DataError("scores-mismatch", f"{name} of {length} splats for a scene of {splats}")


def _require_storable(splats: Splats) -> None:
    """Refuse values beyond the range of the format."""
    for name in ("means", "scales", "opacities", "sh0", "shN"):
        for start in range(0, len(splats), _BLOCK):
            values = getattr(splats, name)[start : start + _BLOCK]
            far = np.argwhere((np.abs(values) > MAX_VALUE) & np.isfinite(values))
            if len(far):
                raise DataError(
                    "value-range",
                    f"{name} of splat {start + far[0, 0]}: {values[tuple(far[0])]:g}, "
                    f"expected at most {MAX_VALUE:g} either way (SPEC 6.4)",
                )
