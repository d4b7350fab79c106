"""Encode a scene with levels: chunks of one run of levels each, and opacities for each level."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.encode import pipeline
from cogsplat.codec.encode.config import EncodeConfig
from cogsplat.codec.encode.encoded import EncodedChunk, EncodedLevel, EncodedScene
from cogsplat.codec.encode.presets import PRESETS
from cogsplat.codec.order.objects import ATTRIBUTE
from cogsplat.codec.order.orders import OrderConfig
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.scoring.contribution import Scores, score
from cogsplat.codec.segments.attributes import types_of, unpack_attributes
from cogsplat.codec.segments.opacities import pack_opacities

from .level_training import LevelledSplats

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]

# Name of the extra attribute that tells, after encoding, which row stands where.
_ROW: Final = "row"


@dataclass(frozen=True)
class LevelEncoding:
    """How a scene with levels is encoded.

    Parameters
    ----------
    quality_db : float
        Nominal PSNR, dB, 10 to 90.
    opacity_step : float
        Largest distance between stored opacities of later levels, logits.
    chunk_splats : int
        Most splats in a chunk.
    threads : int
        0 uses all cores; the bytes do not depend on it.
    """

    quality_db: float = 40.0
    opacity_step: float = 0.1
    chunk_splats: int = 4096
    threads: int = 0

    def __post_init__(self) -> None:
        if not self.opacity_step > 0:
            raise ValueError(f"opacity step {self.opacity_step}, expected more than 0")


def encode_levels(
    levels: LevelledSplats,
    cameras: Sequence[Camera],
    encoding: LevelEncoding | None = None,
    *,
    progress: Progress = silent,
) -> EncodedScene:
    """Encode a scene with levels.

    Parameters
    ----------
    levels : LevelledSplats
    cameras : sequence of Camera
        Of the full pictures: how finely a splat is stored follows from what it shows there at the
        last level that draws it.
    encoding : LevelEncoding, optional
    progress : Progress
        Called with ``score`` for each level and the stages of `pipeline.encode`.

    Returns
    -------
    EncodedScene
        Its chunks stand level by level.
    """
    encoding = encoding or LevelEncoding()
    splats, count = levels.splats, len(levels.splats)
    config = EncodeConfig(
        quality_db=encoding.quality_db,
        order="contribution",
        ordering=OrderConfig(by_object=True),
        chunk_splats=encoding.chunk_splats,
        refine=False,
        prune=None,
        compensate=False,
        threads=encoding.threads,
    )
    # One label for each pair of a first and a last level.
    labels = levels.first * len(levels.scales) + levels.last
    extras = {ATTRIBUTE: labels.astype(np.uint32), _ROW: np.arange(count, dtype=np.uint32)}
    made = pipeline.encode(
        replace(splats, extras=extras),
        config,
        scores=_scores(levels, cameras, config, progress),
        progress=progress,
    )
    return _in_levels(made, levels, encoding.opacity_step)


def _scores(
    levels: LevelledSplats, cameras: Sequence[Camera], config: EncodeConfig, progress: Progress
) -> Scores:
    """Return the scores of each splat at the last level that draws it."""
    settings = PRESETS["balanced"].score_config(config.profile, threads=config.threads)
    merged: Scores | None = None
    count = len(levels.splats)
    for level in range(len(levels.scales)):
        rows = levels.rows(level)
        found = score(levels.at(level), cameras, settings, progress=progress)
        if merged is None:
            merged = _blank(found, count)
        ending = levels.last[rows] == level
        merged = _filled(merged, found, rows[ending], np.flatnonzero(ending))
    assert merged is not None
    return merged


def _blank(scores: Scores, count: int) -> Scores:
    return scores.take(np.zeros(count, np.int64)) if len(scores.contribution) else scores


def _filled(into: Scores, scores: Scores, rows: I64, places: I64) -> Scores:
    """Return scores with those of some rows in their places, and what all share of `scores`."""
    taken = scores.take(places)
    changes = {}
    for field in fields(scores):
        part = getattr(taken, field.name)
        kept = getattr(into, field.name)
        if field.name == "sensitivities":
            if part is not None:
                inner = {}
                for each in fields(part):
                    values = getattr(part, each.name)
                    inner[each.name] = _placed(getattr(kept, each.name), values, rows)
                changes[field.name] = type(part)(**inner)
        elif field.name not in ("basis_spread", "num_pixels"):
            changes[field.name] = _placed(kept, part, rows)
    return replace(scores, **changes)


def _placed(into: np.ndarray, values: np.ndarray, rows: I64) -> np.ndarray:
    out = into.copy()
    out[rows] = values
    return out


def _in_levels(made: EncodedScene, levels: LevelledSplats, step: float) -> EncodedScene:
    """Return an encoded scene with its chunks level by level, and opacities of later levels."""
    kinds = types_of(made.scene.extras)
    starts = np.cumsum([0, *(chunk.splats for chunk in made.chunks)])
    runs = [(chunk, int(start)) for chunk, start in zip(made.chunks, starts, strict=False)]
    firsts = [chunk.object // len(levels.scales) for chunk, _ in runs]
    order = np.argsort(firsts, kind="stable").tolist()
    ends = np.cumsum(np.bincount(firsts, minlength=len(levels.scales)))
    # A level that adds no chunk would have those of the level before.
    kept = [k for k, end in enumerate(ends) if end > (ends[k - 1] if k else 0)]
    chunks: list[EncodedChunk] = []
    rows: list[I64] = []
    for place in order:
        chunk, start = runs[place]
        first, last = divmod(chunk.object, len(levels.scales))
        extras = {kind.name: kind.allocate(chunk.splats) for kind in kinds}
        assert chunk.attributes is not None
        unpack_attributes(memoryview(chunk.attributes), kinds, extras, "chunk")
        own = extras[_ROW].astype(np.int64)
        head = made.decoded.opacities[start : start + chunk.splats]
        # What the encoder made of the opacities for the shapes that it stores holds at all levels.
        moved = head - levels.splats.opacities[own]
        payloads = tuple(
            pack_opacities(levels.opacities[k][own] + moved, head, step)
            for k in kept
            if first < k <= last
        )
        later = [k for k in kept if k > last]
        chunks.append(
            replace(
                chunk,
                object=0,
                attributes=None,
                opacities=payloads,
                until=int(ends[later[0]]) if later else 0,
            )
        )
        rows.append(np.arange(start, start + chunk.splats))
    stored = np.concatenate([np.zeros(0, np.int64), *rows])
    return replace(
        made,
        scene=made.scene.without_extras(),
        chunks=chunks,
        decoded=made.decoded.take(stored),
        levels=tuple(EncodedLevel(int(ends[k]), float(levels.scales[k])) for k in kept),
    )
