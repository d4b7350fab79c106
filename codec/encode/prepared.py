"""A scene in its order and cut into chunks: all that does not depend on its quantisers."""

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
from cogsplat.codec.partition.nested_cells import NestedCells, nested_cells
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.rate import allocation
from cogsplat.codec.rate.pruning import keep_mask
from cogsplat.codec.scoring.contribution import Scores
from cogsplat.codec.scoring.reference_views import ReferenceViews
from cogsplat.codec.splats import Splats
from cogsplat.codec.streams.grid import MAX_VALUE
from cogsplat.codec.workspace import IN_MEMORY, Workspace

from .config import EncodeConfig
from .encoded import EncodedCodebook

# The least splats of a chunk of a cell, as a share of the most: cells of fewer wait for the next
# layer.
_LEAST_SHARE: Final = 8

# Rows whose values are looked at together: what is compared would be as large as the scene.
_BLOCK: Final = 1 << 16


@dataclass(frozen=True, eq=False)
class LaidOutScene:
    """The splats that stay, in the order of their chunks.

    Parameters
    ----------
    source : Splats
        The scene that is encoded.
    rows : (n,) int64
        The rows of the source that stay, in chunk order.
    scores : Scores
        Of the source.
    slices : sequence of slice
        Rows of each chunk, one run behind the other.
    objects : (c,) uint32
        Label of the object that each chunk holds; zeros where chunks are not cut by object.
    cells : (c,) uint32
        Cell that each chunk lies in (SPEC 5.4); zeros where chunks are not cut by cell.
    config : EncodeConfig
    workspace : Workspace
        Where long arrays are kept.
    codebooks : sequence of EncodedCodebook
        As `PreparedScene` has them.
    """

    source: Splats
    rows: NDArray[np.int64]
    scores: Scores
    slices: Sequence[slice]
    objects: NDArray[np.uint32]
    cells: NDArray[np.uint32]
    config: EncodeConfig
    workspace: Workspace
    codebooks: Sequence[EncodedCodebook] = ()

    def part(self, run: slice) -> Splats:
        """Return the splats of a run of rows in chunk order, gathered from the source.

        All of them at once would be a second scene in memory.
        """
        return self.workspace.take(self.source, self.rows[run])


@dataclass(frozen=True, eq=False)
class PreparedScene:
    """A scene in its order, which one quality after the other can be encoded from.

    Parameters
    ----------
    source : Splats
        The scene that is encoded.
    rows : (n,) int64
        The order: rows of the source, without those that nothing can ever show.
    scores : Scores
        Of the source.
    config : EncodeConfig
    workspace : Workspace
        Where what is decoded again is kept.
    codebooks : sequence of EncodedCodebook
        Of an earlier encode of nearly the same scene: the training of the profile ``vq`` goes on
        from them. None where it begins anew.
    """

    source: Splats
    rows: NDArray[np.int64]
    scores: Scores
    config: EncodeConfig
    workspace: Workspace = IN_MEMORY
    codebooks: Sequence[EncodedCodebook] = ()
    # The layout that was made last. A search for a target often keeps the same splats in every
    # trial, and arranging the rows of a large scene takes longer than comparing their numbers.
    _made: dict[str, tuple[NDArray[np.int64], LaidOutScene]] = field(
        default_factory=dict, init=False, repr=False
    )

    def laid_out(self, quality_db: float) -> LaidOutScene:
        """Return the chunks of the splats that are worth their bytes at a nominal quality."""
        lagrangian = allocation.lagrangian(self.scores, quality_db)
        kept = keep_mask(self.source, self.scores, self.config.pruning, lagrangian)
        rows = self.rows[kept[self.rows]]
        made = self._made.get("last")
        if made is None or not np.array_equal(made[0], rows):
            made = rows, _lay_out(self, rows)
            self._made["last"] = made
        return made[1]


def prepare(
    splats: Splats,
    scores: Scores,
    config: EncodeConfig,
    *,
    views: Sequence[Camera] = (),
    jitter: bool = True,
    references: ReferenceViews | None = None,
    effort: GainEffort | None = None,
    workspace: Workspace = IN_MEMORY,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> PreparedScene:
    """Order a scene.

    Parameters
    ----------
    splats : Splats
        Rows must be valid (`Splats.require_valid`).
    scores : Scores
        Of these splats, row by row; `zero_scores` where nothing was rendered.
    config : EncodeConfig
    views : sequence of Camera
        Those the scores are of, for orders that render.
    jitter : bool
        Whether orders that render look from jittered copies of the views as well.
    references : ReferenceViews, optional
        Pictures of the scene in these views, where they have been drawn.
    effort : GainEffort, optional
        How much work goes into the order by marginal gain.
    workspace : Workspace
        As `PreparedScene` has it.
    executor : Executor, optional
        What runs the work of single views; threads of this process where it is not given.
    progress : Progress
        Called by orders that render, with their own stages.

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
    return PreparedScene(splats, rows[kept[rows]], scores, config, workspace)


def _lay_out(prepared: PreparedScene, rows: NDArray[np.int64]) -> LaidOutScene:
    """Cut rows in their order into chunks."""
    splats, scores, config = prepared.source, prepared.scores, prepared.config
    if config.order == "gain" and not config.ordering.by_object:
        # The order was sorted before splats were pruned, and pruning moved those behind them
        # into other chunks. Not where a pose is served first: its splats would lose their
        # places. Cells are cut from layers: what is sorted does not become shorter with them.
        largest = chunk_plan.DEFAULT_CHUNK_SPLATS if config.cells else config.chunk_splats
        rows = chunk_plan.sort_runs(rows, scores.contribution, largest)
    cells: NDArray[np.uint32] | None = None
    if config.cells:
        nested = _nested(prepared, rows)
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
    return LaidOutScene(
        source=splats,
        rows=arranged.rows,
        scores=scores,
        slices=arranged.slices,
        objects=arranged.objects,
        cells=np.zeros(len(arranged.slices), np.uint32) if cells is None else cells,
        config=config,
        workspace=prepared.workspace,
        codebooks=prepared.codebooks,
    )


def _nested(prepared: PreparedScene, rows: NDArray[np.int64]) -> NestedCells:
    """Cut rows in their order into layers of cells."""
    most = prepared.config.chunk_splats
    first = min(chunk_plan.FIRST_SPLATS, most)
    means = prepared.workspace.gather(prepared.source.means, rows).astype(np.float64)
    weights = prepared.workspace.gather(prepared.scores.contribution, rows)
    return nested_cells(
        means,
        weights,
        first=first,
        growth=chunk_plan.GROWTH,
        smallest=min(first, max(most // _LEAST_SHARE, 1)),
        largest=most,
    )


def _require_scores(scores: Scores, splats: int) -> None:
    for name in ("contribution", "energy", "peak", "covered"):
        length = len(getattr(scores, name))
        if length != splats:
            raise DataError("scores-mismatch", f"{name} of {length} splats for a scene of {splats}")


def _require_storable(splats: Splats) -> None:
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
