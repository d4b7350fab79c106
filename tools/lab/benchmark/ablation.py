"""Ablation of the encoder: bytes at equal PSNR with one technique at a time disabled."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.progress import Progress, StageCost, silent
from cogsplat.codec.views.roam_views import roam

if TYPE_CHECKING:
    from cogsplat.codec.encode.config import EncodeConfig
    from cogsplat.codec.encode.prepared import PreparedScene
    from cogsplat.codec.encode.quality_prediction import PrefixEvaluator

    from .rate_distortion import BenchInput

Change = Callable[["EncodeConfig"], "EncodeConfig"]

# PSNR added to the correction after each of the three measurements of a technique, dB. The second
# correction overshoots the target by 0.3 dB, so that two measurements bracket it.
_OVERSHOOT_DB: Final = (0.0, 0.3, 0.0)


@dataclass(frozen=True)
class AblationRow:
    """Bytes and PSNR of the encoder without one technique.

    Parameters
    ----------
    technique : str
        Disabled technique.
    bytes_per_splat : float
        Bytes per source splat at the held-out PSNR of the full encoder, interpolated.
    more : float
        Relative increase of the bytes over the full encoder.
    roam_db : float
        PSNR of roam views at that held-out PSNR, interpolated, dB.
    encode_s : float
        Shortest encoding time, without scoring, s.
    nearest_db : float
        Distance of the nearest measured PSNR from the PSNR of the interpolation, dB.
    """

    technique: str
    bytes_per_splat: float
    more: float
    roam_db: float
    encode_s: float
    nearest_db: float

    def report(self) -> dict[str, object]:
        """Return the figures for CSV and JSON output."""
        return asdict(self)


@dataclass(frozen=True)
class AblationTable:
    """Results of an ablation: the full encoder, and the encoder without each technique.

    Parameters
    ----------
    held_out_db : float
        Held-out PSNR at which all sizes are compared.
    rows : tuple of AblationRow
        Results, the full encoder first.
    """

    held_out_db: float
    rows: tuple[AblationRow, ...]


@dataclass(frozen=True)
class _Point:
    """Result of one encode: PSNR in held-out and roam views, file size and duration."""

    held_out_db: float
    roam_db: float
    file_bytes: int
    encode_s: float


def changes(sh_degree: int) -> dict[str, Change]:
    """Return functions that disable one technique in an encoder configuration, by technique."""
    from cogsplat.codec.encode.config import Ablation

    def without(**flags: bool) -> Change:
        return lambda config: replace(config, ablation=replace(config.ablation, **flags))

    named: dict[str, Change] = {
        "order by gain (contribution instead)": lambda config: replace(
            config, order="contribution"
        ),
        "reordering (source order instead)": lambda config: replace(config, order="source"),
        "coarse heads and refinements": lambda config: replace(config, refine=False),
        "quantiser steps per chunk": without(chunk_steps=False),
        "measured sensitivities": without(sensitivities=False),
        "means quantised by splat size": without(fine_means=False),
        "Morton order in chunks": lambda config: replace(config, morton=False),
        "rotations quantised by anisotropy": without(fine_rotations=False),
        "area correction of coarse scales": without(areas=False),
        "several symbols per byte": without(digits=False),
        "pruning": lambda config: replace(config, prune=None),
    }
    if sh_degree:
        named |= {
            "principal axes of shN": without(colour_basis=False),
            "shN errors weighted by views": without(view_metric=False),
            "mean shN error added to sh0": without(sh0_makes_up=False),
        }
    nothing = Ablation(**dict.fromkeys(Ablation.__dataclass_fields__, False))
    named["all techniques"] = lambda config: replace(
        config, order="source", refine=False, morton=False, prune=None, ablation=nothing
    )
    return named


def stage_cost(splats: int, sh_degree: int, cameras: Sequence[Camera]) -> StageCost:
    """Estimate the cost of `run` in the unit of `codec.encode.stage_costs`.

    Parameters
    ----------
    splats : int
        Splats of the scene.
    sh_degree : int
        SH degree of the scene.
    cameras : sequence of Camera
        Test views; at least one.
    """
    from cogsplat.codec.encode.config import EncodeConfig
    from cogsplat.codec.encode.request import EncodeRequest
    from cogsplat.codec.encode.stage_costs import render_cost, stage_costs

    config = EncodeConfig(compensate=False, order="contribution")
    encode = stage_costs(splats, EncodeRequest(config=config), scored=True)
    # Each test view, and two roam views for each.
    once = sum(cost.total() for cost in encode) + 3 * render_cost(splats, cameras)
    return StageCost("ablation", len(_OVERSHOOT_DB) * once, len(changes(sh_degree)) + 1)


def run(given: BenchInput, *, quality_db: float, progress: Progress = silent) -> AblationTable:
    """Measure the full encoder and the encoder without each technique, at three qualities.

    Parameters
    ----------
    given : BenchInput
        Input; its background is ignored, all views are rendered on black.
    quality_db : float
        Nominal quality whose held-out PSNR with the full encoder is the target.
    progress : Progress
        Called with the stage ``ablation``.

    Returns
    -------
    AblationTable

    Raises
    ------
    DataError
        ``no-cameras``: there are no test views.
    """
    from cogsplat.codec.encode.config import EncodeConfig
    from cogsplat.codec.encode.prepared import prepare
    from cogsplat.codec.encode.quality_prediction import PrefixEvaluator

    whole = EncodeConfig(profile="transform", quality_db=quality_db, threads=given.threads)
    named = changes(given.splats.sh_degree)
    progress("ablation", 0, len(named) + 1)
    held_out = PrefixEvaluator(given.splats, given.cameras, given.threads)
    roaming = roam(given.splats, given.cameras)
    evaluators = held_out, PrefixEvaluator(given.splats, roaming, given.threads)
    start = time.perf_counter()
    prepared = prepare(given.splats, given.scores, whole, views=given.scored_on)
    ordered_s = time.perf_counter() - start
    measure = _measurement(given, prepared, evaluators, ordered_s)
    base = measure(quality_db)
    per_splat = 1 / len(given.splats)
    rows = [
        AblationRow("nothing", base.file_bytes * per_splat, 0.0, base.roam_db, base.encode_s, 0.0)
    ]
    progress("ablation", 1, len(named) + 1)
    for name, change in named.items():
        changed = replace(prepared, config=change(whole))
        prepare_s = ordered_s
        if changed.config.order != whole.order:
            start = time.perf_counter()
            changed = prepare(given.splats, given.scores, changed.config)
            prepare_s = time.perf_counter() - start
        measure = _measurement(given, changed, evaluators, prepare_s)
        points = _measure_near(measure, quality_db, base.held_out_db)
        size, roam_db = equal_quality(
            [(p.held_out_db, p.file_bytes, p.roam_db) for p in points], base.held_out_db
        )
        rows.append(
            AblationRow(
                name,
                size * per_splat,
                size / base.file_bytes - 1,
                roam_db,
                min(point.encode_s for point in points),
                min(abs(point.held_out_db - base.held_out_db) for point in points),
            )
        )
        progress("ablation", len(rows), len(named) + 1)
    return AblationTable(base.held_out_db, tuple(rows))


def _measurement(
    given: BenchInput,
    prepared: PreparedScene,
    evaluators: tuple[PrefixEvaluator, PrefixEvaluator],
    prepare_s: float,
) -> Callable[[float], _Point]:
    """Return a function that encodes at a given nominal quality, dB, and measures the result.

    Parameters
    ----------
    given : BenchInput
        Input of the benchmark.
    prepared : PreparedScene
        Scene in chunk order, with the configuration to measure.
    evaluators : pair of PrefixEvaluator
        Evaluators in the held-out and in the roam views.
    prepare_s : float
        Duration of the preparation, s; part of the encoding time.
    """
    from cogsplat.codec.encode.encoder import encode_chunks
    from cogsplat.formats.cogs import scene_writer

    def measure(quality_db: float) -> _Point:
        start = time.perf_counter()
        encoded = encode_chunks(prepared, quality_db)
        encode_s = prepare_s + time.perf_counter() - start
        size = scene_writer.size_bytes(encoded, writer=f"cogsplat {cogsplat.__version__}")
        held_out_db, roam_db = (evaluator.psnr_db(encoded.decoded) for evaluator in evaluators)
        return _Point(held_out_db, roam_db, size, encode_s)

    return measure


def _measure_near(
    measure: Callable[[float], _Point], quality_db: float, target_db: float
) -> list[_Point]:
    """Measure at three nominal qualities, each corrected by the last difference to the target.

    The second correction overshoots (`_OVERSHOOT_DB`): two measurements bracket the target.

    Parameters
    ----------
    measure : callable
        Encodes at a nominal quality, dB.
    quality_db : float
        First nominal quality, dB.
    target_db : float
        Held-out PSNR to approach, dB.
    """
    points: list[_Point] = []
    at = quality_db
    for overshoot in _OVERSHOOT_DB:
        points.append(measure(_clamp(at)))
        missing = target_db - points[-1].held_out_db
        at += missing + math.copysign(overshoot, missing)
    return points


def _clamp(quality_db: float) -> float:
    """Clamp a nominal quality to the valid range."""
    from cogsplat.codec.encode.config import MAX_QUALITY_DB, MIN_QUALITY_DB

    return min(max(quality_db, MIN_QUALITY_DB), MAX_QUALITY_DB)


def equal_quality(
    points: Sequence[tuple[float, float, float]], target_db: float
) -> tuple[float, float]:
    """Interpolate bytes and PSNR in roam views at a held-out PSNR.

    Parameters
    ----------
    points : sequence of (held-out dB, bytes, roam dB)
        Measurements. The two that bracket the target are used, or else the nearest two.
    target_db : float
        Held-out PSNR.

    Returns
    -------
    tuple of float
        Bytes, interpolated in their logarithm, and PSNR in roam views, dB.
    """
    table = np.unique(np.array(points, np.float64), axis=0)
    quality, sizes, roam = table.T
    if len(quality) == 1:
        return float(sizes[0]), float(roam[0])
    upper = int(np.clip(np.searchsorted(quality, target_db), 1, len(quality) - 1))
    lower = upper - 1
    span = quality[upper] - quality[lower]
    share = (target_db - quality[lower]) / span if span > 0 else 0.0
    logs = np.log(sizes)
    size = math.exp(float(logs[lower] + share * (logs[upper] - logs[lower])))
    return size, float(roam[lower] + share * (roam[upper] - roam[lower]))
