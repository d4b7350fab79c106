"""From a scene to chunk payloads: score, order, prune, cut, quantise (SPEC 6, 7)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import DataError
from cogsplat.codec.geometry.bounds import box
from cogsplat.codec.order import chunks as chunking
from cogsplat.codec.order import objects
from cogsplat.codec.order.orders import Unordered, order_rows
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.rate import allocation, segment_order
from cogsplat.codec.rate import costs as rate_costs
from cogsplat.codec.rate.pruning import kept_rows
from cogsplat.codec.scoring.contribution import Scores, unscored
from cogsplat.codec.scoring.reference_views import ReferenceViews
from cogsplat.codec.segments.attributes import pack_attributes
from cogsplat.codec.segments.codebooks import Codebook, decode_shape_codebook
from cogsplat.codec.segments.heads import decode_head
from cogsplat.codec.segments.payloads import Payloads
from cogsplat.codec.splats import Splats, empty
from cogsplat.codec.streams.grid import MAX_VALUE
from cogsplat.codec.threads import ordered_map, thread_count

from .config import EncodeConfig, require_quality
from .encoded import EncodedChunk, EncodedCodebook, EncodedScene
from .profiles import near_lossless, transform, vq


@dataclass(frozen=True, eq=False)
class Prepared:
    """A scene in its order: all that does not depend on how fine it is stored.

    Parameters
    ----------
    source : Splats
        What is encoded.
    ordered : Splats
        The rows that may stay, in chunk order.
    rows : (n,) int64
        Where they stand in the source.
    scores : Scores
        Of the source.
    slices : sequence of slice
        The chunks.
    objects : (chunks,) uint32
        What each holds; zeros where chunks are not cut by object.
    config : EncodeConfig
    """

    source: Splats
    ordered: Splats
    rows: NDArray[np.int64]
    scores: Scores
    slices: Sequence[slice]
    objects: NDArray[np.uint32]
    config: EncodeConfig

    def pruned(self, quality_db: float) -> Prepared:
        """Return the scene without the splats that are not worth their bytes at a quality."""
        lagrangian = allocation.lagrangian(self.scores, quality_db)
        kept = kept_rows(self.source, self.scores, self.config.dropping(), lagrangian)
        return _laid_out(self.source, self.rows[kept[self.rows]], self.scores, self.config)

    def encode(self, quality_db: float, *, progress: Progress = silent) -> EncodedScene:
        """Encode at a nominal quality in place of the configuration's.

        Raises
        ------
        ValueError
            A quality outside 10 to 90 dB.
        """
        require_quality(quality_db)
        return self.pruned(quality_db)._encode(quality_db, progress)

    def _encode(self, quality_db: float, progress: Progress) -> EncodedScene:
        codebooks, encode_run = _profile(self, quality_db, progress)
        shapes: dict[int, Codebook] = {
            number: decode_shape_codebook(memoryview(book.payloads[0]), book.rows, "shape codebook")
            for number, book in enumerate(codebooks)
            if book.attribute == "shape"
        }

        def encode_one(chunk: tuple[slice, int]) -> EncodedChunk:
            run, label = chunk
            part = self.rows[run]
            payloads = encode_run(run)
            # Coarse steps move splats past the box of the source.
            stored = empty(0, len(part))
            decode_head(memoryview(payloads.head), shapes, stored, "chunk")
            reach = box(stored)
            if payloads.refinement is not None:
                refined = memoryview(payloads.refinement)
                decode_head(memoryview(payloads.head), shapes, stored, "chunk", refined)
                fine = box(stored)
                reach = np.concatenate(
                    [np.minimum(reach[:3], fine[:3]), np.maximum(reach[3:], fine[3:])]
                )
            return EncodedChunk(
                splats=len(part),
                payloads=payloads,
                box=reach,
                contribution=float(self.scores.contribution[part].sum()),
                attributes=self._attributes(run, payloads),
                object=label,
                tail_gain=segment_order.tail_gain(
                    self.ordered.shN[run], self.scores.energy[part], self.scores.basis_spread
                ),
            )

        chunks: list[EncodedChunk] = []
        progress("chunks", 0, len(self.slices))
        runs = list(zip(self.slices, self.objects.tolist(), strict=True))
        for chunk in ordered_map(encode_one, runs, thread_count(self.config.threads)):
            chunks.append(chunk)
            progress("chunks", len(chunks), len(self.slices))
        boxes = np.array([chunk.box for chunk in chunks]).reshape(-1, 6)
        whole = np.zeros(6)
        if len(boxes):
            whole = np.concatenate([boxes[:, :3].min(axis=0), boxes[:, 3:].max(axis=0)])
        return EncodedScene(
            scene=self.source.take(slice(0, 0)),
            splats=len(self.rows),
            pruned=len(self.source) - len(self.rows),
            box=whole,
            codebooks=codebooks,
            chunks=chunks,
        )

    def _attributes(self, run: slice, payloads: Payloads) -> bytes | None:
        extras = self.ordered.extras
        if not extras:
            return None
        return pack_attributes(
            {name: values[run][payloads.order] for name, values in extras.items()}
        )


def prepare(
    splats: Splats,
    scores: Scores | None,
    config: EncodeConfig | None = None,
    *,
    views: Sequence[Camera] = (),
    jitter: bool = True,
    references: ReferenceViews | None = None,
    progress: Progress = silent,
) -> Prepared:
    """Order a scene and cut it.

    Parameters
    ----------
    splats, scores, config
        As `encode` takes them.
    views : sequence of Camera
        Those the scores are of, for orders that render.
    jitter : bool
        Whether these look from jittered copies as well.
    references : ReferenceViews, optional
        What they would draw, where it has been drawn.
    progress : Progress

    Raises
    ------
    DataError
        As `encode` does.
    """
    config = config or EncodeConfig()
    splats.require_valid()
    _require_storable(splats)
    scores = unscored(len(splats)) if scores is None else scores
    _require_scores(scores, len(splats))
    kept = kept_rows(splats, scores, config.dropping(), 0.0)
    scene = Unordered(splats, scores, views, config.threads, progress, jitter, references)
    inflated = config.ordering.inflated and config.compensate
    rows = order_rows(config.order, scene, replace(config.ordering, inflated=inflated))
    return _laid_out(splats, rows[kept[rows]], scores, config)


def _laid_out(
    splats: Splats, rows: NDArray[np.int64], scores: Scores, config: EncodeConfig
) -> Prepared:
    """Cut rows in their order into chunks."""
    if config.ordering.by_object:
        arranged = objects.arrange(
            rows,
            objects.labels_of(splats),
            scores.contribution,
            config.chunk_splats,
            config.ordering.object_budgets,
        )
    else:
        if config.order == "gain":
            # Again: what was pruned moved the others into other chunks. Not where a pose is served
            # first: its splats would lose their places.
            rows = chunking.sort_runs(rows, scores.contribution, config.chunk_splats)
        slices = chunking.plan_chunks(len(rows), config.chunk_splats)
        arranged = objects.Arrangement(rows, slices, np.zeros(len(slices), np.uint32))
    return Prepared(
        source=splats,
        ordered=splats.take(arranged.rows),
        rows=arranged.rows,
        scores=scores,
        slices=arranged.slices,
        objects=arranged.objects,
        config=config,
    )


def encode(
    splats: Splats,
    scores: Scores | None,
    config: EncodeConfig | None = None,
    *,
    progress: Progress = silent,
) -> EncodedScene:
    """Encode a scene.

    Parameters
    ----------
    splats : Splats
        Rows must be valid (`Splats.require_valid`).
    scores : Scores or None
        Of these splats, row by row. None where nothing was scored: every splat counts the same,
        none is pruned for its contribution, and the order by contribution is the source's.
    config : EncodeConfig, optional
    progress : Progress
        Called with ``codebooks`` and ``chunks`` as stages.

    Returns
    -------
    EncodedScene
        The same bytes for any number of threads.

    Raises
    ------
    DataError
        ``invalid-rows``, ``value-range`` where a value is beyond what the format holds, or
        ``scores-mismatch`` where the scores are another scene's.
    """
    config = config or EncodeConfig()
    return prepare(splats, scores, config).encode(config.quality_db, progress=progress)


def _require_scores(scores: Scores, splats: int) -> None:
    for name in ("contribution", "energy", "peak", "covered"):
        length = len(getattr(scores, name))
        if length != splats:
            raise DataError("scores-mismatch", f"{name} of {length} splats for a scene of {splats}")


def _require_storable(splats: Splats) -> None:
    for name in ("means", "scales", "opacities", "sh0", "shN"):
        values = getattr(splats, name)
        far = np.argwhere((np.abs(values) > MAX_VALUE) & np.isfinite(values))
        if len(far):
            raise DataError(
                "value-range",
                f"{name} of splat {far[0, 0]}: {values[tuple(far[0])]:g}, "
                f"expected at most {MAX_VALUE:g} either way (SPEC 6.4)",
            )


def _profile(
    prepared: Prepared, quality_db: float, progress: Progress
) -> tuple[Sequence[EncodedCodebook], Callable[[slice], Payloads]]:
    """Return the codebooks of a profile and what encodes one run of the ordered scene."""
    ordered, scores, rows = prepared.ordered.without_extras(), prepared.scores, prepared.rows
    config = prepared.config
    if config.profile == "near-lossless" or len(rows) == 0:
        bound = near_lossless.mean_bound(ordered, config.near_lossless)
        return [], lambda run: near_lossless.encode_chunk(
            ordered.take(run), bound, config.near_lossless, config.morton
        )
    ordered = vq.clip_strays(ordered)
    if config.profile == "transform":
        known = scores.take(rows)
        if not config.ablation.sensitivities:
            known = replace(known, sensitivities=None)
        costs = rate_costs.costs(ordered, known)
        if not config.ablation.chunk_steps:
            costs = costs.levelled()
        lagrangian = allocation.lagrangian(scores, quality_db)
        shared = transform.plan(
            ordered,
            costs,
            scores.basis_spread,
            lagrangian,
            prepared.slices,
            config.ablation,
            known.contribution if config.refine else None,
            segment_order.MISSING_COMPENSATED if config.compensate else segment_order.MISSING_ALL,
        )
        books = []
        if shared.basis is not None:
            books = [EncodedCodebook("colour", len(shared.basis.rows), shared.basis_payloads)]
        return books, lambda run: transform.encode_chunk(ordered, shared, run, config.morton)
    plan = vq.plan(
        ordered,
        rate_costs.floor_energy(scores)[rows],
        allocation.lagrangian(scores, quality_db),
        training=config.training,
        threads=config.threads,
        progress=progress,
    )
    codebooks = [EncodedCodebook("shape", plan.shape_rows, (plan.shape_payload,))]
    if plan.colour_rows:
        codebooks.append(EncodedCodebook("colour", plan.colour_rows, plan.colour_payloads))
    return codebooks, lambda run: vq.encode_chunk(
        ordered, plan, np.arange(run.start, run.stop), config.morton
    )
