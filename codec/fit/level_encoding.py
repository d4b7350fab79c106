"""Training and encoding of a scene with levels: chunks by level, opacities for later levels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.encode import pipeline
from cogsplat.codec.encode.config import EncodeConfig
from cogsplat.codec.encode.encoded import EncodedChunk, EncodedLevel, EncodedScene
from cogsplat.codec.encode.presets import PRESETS
from cogsplat.codec.encode.request import EncodeRequest
from cogsplat.codec.order.objects import ATTRIBUTE
from cogsplat.codec.progress import Progress, silent
from cogsplat.codec.scoring.contribution import Scores, score
from cogsplat.codec.segments.attributes import attribute_types, unpack_attributes
from cogsplat.codec.segments.opacities import pack_opacities
from cogsplat.codec.splats import Splats
from cogsplat.codec.views.capture_choice import choose_capture

from .level_training import LevelledSplats, grow_levels, train_levels
from .train_config import LevelsConfig, LevelsRequest

F32 = NDArray[np.float32]
I64 = NDArray[np.int64]

# Extra attribute with the source row of each splat, which restores rows after encoding.
_ROW_ATTRIBUTE: Final = "row"


def make_levels(
    splats: Splats, request: LevelsRequest, *, progress: Progress = silent
) -> EncodedScene:
    """Train and encode levels of detail, from a trained scene or from points.

    Parameters
    ----------
    splats : Splats
        Trained scene with valid rows, or splats from `initial_splats.splats_from_points`; in the
        frame of the cameras. Without capture viewpoints of their own, they get those of given
        cameras.
    request : LevelsRequest
        Views, ground truth and configuration.
    progress : Progress
        Receives the stages of `train_levels` or `grow_levels`, and of `encode_levels`.

    Returns
    -------
    EncodedScene
        Scene with its chunks ordered by the first level that draws them.
    """
    cameras, config, pictures = request.cameras, request.config, request.pictures
    if not request.planned:
        splats = splats.with_capture(choose_capture(splats, cameras))
    if request.max_splats is None or pictures is None:
        levels = train_levels(splats, cameras, config, pictures=pictures, progress=progress)
    else:
        levels = grow_levels(
            splats, cameras, pictures, request.max_splats, config, progress=progress
        )
    return encode_levels(levels, cameras, config, progress=progress)


def encode_levels(
    levels: LevelledSplats,
    cameras: Sequence[Camera],
    config: LevelsConfig | None = None,
    *,
    progress: Progress = silent,
) -> EncodedScene:
    """Encode a scene with levels.

    Parameters
    ----------
    levels : LevelledSplats
        Trained scene with levels.
    cameras : sequence of Camera
        Views at full resolution, used to score the splats; scores set the quantiser steps. A splat
        is scored in the scene of the highest level that draws it.
    config : LevelsConfig, optional
        Settings of the encoding; those of levels and training are not used.
    progress : Progress
        Receives ``score`` for each level, and the stages of `pipeline.encode`.

    Returns
    -------
    EncodedScene
        Scene with its chunks ordered by the first level that draws them.
    """
    config = config or LevelsConfig()
    splats, count = levels.splats, len(levels.splats)
    encode_config = config.encode_config()
    # The object label of a splat is its pair of first and last level: no chunk mixes pairs.
    labels = levels.first_level * len(levels.scales) + levels.last_level
    extras = {
        ATTRIBUTE: labels.astype(np.uint32),
        _ROW_ATTRIBUTE: np.arange(count, dtype=np.uint32),
    }
    encoded = pipeline.encode(
        replace(splats, extras=extras),
        EncodeRequest(
            config=encode_config, scores=_scores(levels, cameras, encode_config, progress)
        ),
        progress=progress,
    )
    return _order_by_level(encoded, levels, config.opacity_step)


def _scores(
    levels: LevelledSplats, cameras: Sequence[Camera], config: EncodeConfig, progress: Progress
) -> Scores:
    """Score each splat in the scene of the highest level that draws it."""
    settings = PRESETS["balanced"].score_config(config.profile, threads=config.threads)
    merged: Scores | None = None
    count = len(levels.splats)
    for level in range(len(levels.scales)):
        rows = levels.rows(level)
        scores = score(levels.scene(level), cameras, settings, progress=progress)
        if merged is None:
            merged = _empty_scores(scores, count)
        ending = levels.last_level[rows] == level
        merged = _fill_scores(merged, scores, rows[ending], np.flatnonzero(ending))
    assert merged is not None
    return merged


def _empty_scores(scores: Scores, count: int) -> Scores:
    """Return placeholder scores of `count` splats, whose values are overwritten later."""
    return scores.take(np.zeros(count, np.int64)) if len(scores.contribution) else scores


def _fill_scores(merged: Scores, scores: Scores, rows: I64, level_rows: I64) -> Scores:
    """Return merged scores, with the scores of some splats replaced.

    Parameters
    ----------
    merged : Scores
        Scores of all splats.
    scores : Scores
        Scores of the splats of one level. Fields without a value per splat are taken from them.
    rows : (n,) int64
        Rows to replace in `merged`.
    level_rows : (n,) int64
        Rows of the new values in `scores`.
    """
    selected = scores.take(level_rows)
    changes = {}
    for field in fields(scores):
        new, old = getattr(selected, field.name), getattr(merged, field.name)
        if field.name == "sensitivities":
            if new is not None:
                filled = {
                    each.name: _with_rows(getattr(old, each.name), getattr(new, each.name), rows)
                    for each in fields(new)
                }
                changes[field.name] = type(new)(**filled)
        elif field.name not in ("basis_spread", "num_pixels", "sparse"):
            changes[field.name] = _with_rows(old, new, rows)
    return replace(scores, **changes)


def _with_rows(values: np.ndarray, new: np.ndarray, rows: I64) -> np.ndarray:
    """Return a copy of an array with some rows replaced."""
    copy = values.copy()
    copy[rows] = new
    return copy


def _order_by_level(encoded: EncodedScene, levels: LevelledSplats, step: float) -> EncodedScene:
    """Order the chunks of an encoded scene by their first level, and add the level tables.

    Parameters
    ----------
    encoded : EncodedScene
        Scene in chunks of one object label each, with the source row of each splat as attribute.
    levels : LevelledSplats
        The scene that was encoded.
    step : float
        Maximum quantiser step of opacities of later levels, in logits.
    """
    num_levels = len(levels.scales)
    starts = np.cumsum([0, *(chunk.splats for chunk in encoded.chunks)])
    first_levels = [chunk.object // num_levels for chunk in encoded.chunks]
    order = np.argsort(first_levels, kind="stable").tolist()
    ends = np.cumsum(np.bincount(first_levels, minlength=num_levels))
    # A level without chunks of its own would equal the level below: it is left out.
    kept = [k for k, end in enumerate(ends) if end > (ends[k - 1] if k else 0)]
    chunks: list[EncodedChunk] = []
    rows: list[I64] = []
    for number in order:
        chunk, start = encoded.chunks[number], int(starts[number])
        first, last = divmod(chunk.object, num_levels)
        source_rows = _source_rows(encoded, chunk)
        opacities = encoded.decoded.opacities[start : start + chunk.splats]
        # The encoder adapts opacities to stored shapes; later levels get the same change.
        change = opacities - levels.splats.opacities[source_rows]
        payloads = tuple(
            pack_opacities(levels.opacities[k][source_rows] + change, opacities, step)
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
    all_rows = np.concatenate([np.zeros(0, np.int64), *rows])
    return replace(
        encoded,
        scene=encoded.scene.without_extras(),
        chunks=chunks,
        decoded=encoded.decoded.take(all_rows),
        levels=tuple(EncodedLevel(int(ends[k]), float(levels.scales[k])) for k in kept),
    )


def _source_rows(encoded: EncodedScene, chunk: EncodedChunk) -> I64:
    """Return the row that each splat of a chunk had before encoding, from its attributes."""
    types = attribute_types(encoded.scene.extras)
    extras = {each.name: each.allocate(chunk.splats) for each in types}
    assert chunk.attributes is not None
    unpack_attributes(memoryview(chunk.attributes), types, extras, "chunk")
    return extras[_ROW_ATTRIBUTE].astype(np.int64)
