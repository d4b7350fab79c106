"""Encode the chunks of a scene at a nominal quality, and decode the result (SPEC 6, 7)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.executor import Executor, LocalThreads
from cogsplat.codec.geometry.bounds import box
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.rate import segment_order
from cogsplat.codec.segments.attributes import pack_attributes
from cogsplat.codec.segments.codebooks import Codebook
from cogsplat.codec.segments.heads import decode_head
from cogsplat.codec.segments.payloads import Payloads
from cogsplat.codec.segments.tails import decode_tail
from cogsplat.codec.splats import Splats, empty
from cogsplat.codec.threads import one_blas_thread

from .config import EncodeConfig, require_quality
from .encoded import EncodedChunk, EncodedScene
from .prepared import ChunkedScene, PreparedScene
from .profiles.dispatch import PROFILES, PlannedScene


@one_blas_thread()
def encode_chunks(
    prepared: PreparedScene,
    quality_db: float,
    *,
    compress: bool = True,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> EncodedScene:
    """Encode the chunks of a prepared scene at a nominal quality.

    Parameters
    ----------
    prepared : PreparedScene
        Ordered scene.
    quality_db : float
        Nominal PSNR, 10 to 90 dB; it replaces that of the configuration.
    compress : bool
        Compress the planes of the payloads, a third of the time. Uncompressed planes take several
        times the memory until `compress_chunks`.
    executor : Executor, optional
        Runs the work of single chunks; None for threads of this process.
    progress : Progress
        Called with the stages ``codebooks``, ``quantisers`` (parts that all chunks share) and
        ``chunks``.

    Returns
    -------
    EncodedScene
        Without compensation and without predicted quality; the same bytes for any number of
        threads.

    Raises
    ------
    ValueError
        The quality is outside 10 to 90 dB.
    """
    require_quality(quality_db)
    scene = prepared.lay_out(quality_db)
    planned = PlannedScene()
    if len(scene.rows):
        planned = PROFILES[scene.config.profile](scene, quality_db, progress)
        progress("quantisers", 1, 1)
    degree = scene.source.sh_degree
    codebooks = {number: book.decode(degree) for number, book in enumerate(planned.codebooks)}
    decoded = prepared.workspace.splats(len(scene.rows), degree, scene.source.info)

    chunks: list[EncodedChunk] = []
    count = len(scene.slices)
    progress("chunks", 0, count)
    executor = executor or LocalThreads(scene.config.threads)
    digits = _digits(scene.config) if compress else None
    plan = _Plan(planned, codebooks, empty(degree, 0, scene.source.info), digits)
    made = executor.map(_encode_chunk, scene.slices, plan)
    for number, (payloads, reach, rows) in enumerate(made):
        _write_rows(rows, decoded.take(scene.slices[number]))
        prepared.workspace.trim()
        chunks.append(_chunk(scene, number, payloads, reach))
        progress("chunks", len(chunks), count)
    boxes = np.array([chunk.box for chunk in chunks]).reshape(-1, 6)
    whole = np.zeros(6)
    if len(boxes):
        whole = np.concatenate([boxes[:, :3].min(axis=0), boxes[:, 3:].max(axis=0)])
    return EncodedScene(
        scene=scene.source.take(slice(0, 0)),
        splats=len(scene.rows),
        pruned=len(prepared.source) - len(scene.rows),
        box=whole,
        codebooks=planned.codebooks,
        chunks=chunks,
        decoded=decoded,
        compressed=compress,
    )


def compress_chunks(
    encoded: EncodedScene,
    config: EncodeConfig,
    *,
    executor: Executor | None = None,
    progress: Progress = silent,
) -> EncodedScene:
    """Compress the planes of a scene whose chunks were encoded uncompressed.

    Parameters
    ----------
    encoded : EncodedScene
        Encoded scene; returned unchanged if its planes are compressed already.
    config : EncodeConfig
        Configuration of the encode.
    executor : Executor, optional
        Runs the work of single chunks; None for threads of this process.
    progress : Progress
        Called with ``chunks``.

    Returns
    -------
    EncodedScene
        Scene with the bytes that `encode_chunks` gives with compression.
    """
    if encoded.compressed:
        return encoded
    executor = executor or LocalThreads(config.threads)
    payloads = [chunk.payloads for chunk in encoded.chunks]
    chunks: list[EncodedChunk] = []
    for made in executor.map(partial(Payloads.compress, digits=_digits(config)), payloads):
        chunks.append(replace(encoded.chunks[len(chunks)], payloads=made))
        progress("chunks", len(chunks), len(payloads))
    return replace(encoded, chunks=chunks, compressed=True)


def _digits(config: EncodeConfig) -> bool:
    """Tell whether several symbols may share a byte of a plane."""
    return config.ablation.digits or config.profile == "near-lossless"


@dataclass(frozen=True, eq=False)
class _Plan:
    """Inputs of the encode of a chunk that all chunks share.

    Parameters
    ----------
    planned : PlannedScene
        Codebooks and chunk encoder of the profile.
    codebooks : mapping of int to Codebook
        Decoded codebooks by number.
    blank : Splats
        Scene without rows, with the SH degree and `info` of the decoded chunks.
    digits : bool or None
        Whether several symbols may share a byte of a plane (`Payloads.compress`); None leaves
        planes uncompressed.
    """

    planned: PlannedScene
    codebooks: Mapping[int, Codebook]
    blank: Splats
    digits: bool | None


def _write_rows(rows: Splats, out: Splats) -> None:
    """Copy decoded rows into an array of the workspace."""
    for name in ("means", "scales", "quats", "opacities", "sh0", "shN"):
        getattr(out, name)[:] = getattr(rows, name)


# Worker processes of an executor have a BLAS of their own.
@one_blas_thread()
def _encode_chunk(run: slice, plan: _Plan) -> tuple[Payloads, NDArray[np.float64], Splats]:
    """Encode the rows of a chunk; return its payloads, bounding box and decoded rows."""
    payloads = plan.planned.encode_chunk(run)
    rows = empty(plan.blank.sh_degree, run.stop - run.start, plan.blank.info)
    reach = _decode_chunk(payloads, plan.codebooks, rows)
    if plan.digits is not None:
        payloads = payloads.compress(digits=plan.digits)
    return payloads, reach, rows


def _chunk(
    scene: ChunkedScene, number: int, payloads: Payloads, reach: NDArray[np.float64]
) -> EncodedChunk:
    """Return the payloads of a chunk with its row of the chunk table."""
    run = scene.slices[number]
    rows = scene.rows[run]
    attributes = None
    if scene.source.extras:
        stored = rows[payloads.order]
        extras = scene.source.extras.items()
        attributes = pack_attributes(
            {name: scene.workspace.gather(values, stored) for name, values in extras}
        )
    return EncodedChunk(
        splats=len(rows),
        payloads=payloads,
        box=reach,
        contribution=float(scene.scores.contribution[rows].sum()),
        attributes=attributes,
        object=int(scene.objects[number]),
        cell=int(scene.cells[number]),
        tail_drop=segment_order.tail_distortion_drop(
            scene.workspace.gather(scene.source.shN, rows),
            scene.scores.energy[rows],
            scene.scores.basis_spread,
        ),
    )


def _decode_chunk(
    payloads: Payloads, codebooks: Mapping[int, Codebook], out: Splats
) -> NDArray[np.float64]:
    """Decode a chunk into `out`; return one bounding box around its coarse and refined splats."""
    head = memoryview(payloads.head)
    # The box must contain the coarse splats of the head as well: coarse steps move them.
    decode_head(head, codebooks, out, "chunk")
    reach = box(out)
    if payloads.refinement is not None:
        decode_head(head, codebooks, out, "chunk", memoryview(payloads.refinement))
        fine = box(out)
        reach = np.concatenate([np.minimum(reach[:3], fine[:3]), np.maximum(reach[3:], fine[3:])])
    if payloads.tail is not None:
        decode_tail(memoryview(payloads.tail), codebooks, out.shN, "chunk")
    return reach
