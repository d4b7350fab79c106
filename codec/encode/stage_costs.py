"""Relative costs of the stages of an encode, from which progress computes its overall share.

Units are seconds of processor time, measured with the synthetic scene at 5,000, 20,000 and 80,000
splats of SH degree 3, from 16 and 48 cameras of 480x360 pixels and from planned views, with the
presets ``fast`` and ``balanced``. Only ratios matter, so the machine does not. Measure again when a
stage becomes faster or slower: ``cogsplat encode --json`` has the processor time of each stage in
``cpu_seconds``. Two scene sizes separate the fixed cost of a stage from the cost per splat.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

from cogsplat.codec.cameras import Camera
from cogsplat.codec.order.gain_effort import GainEffort
from cogsplat.codec.order.orders import split_name
from cogsplat.codec.progress import StageCost
from cogsplat.codec.scoring.chunk_contributions import MAX_PIXELS
from cogsplat.codec.views.view_sets import TEST_VIEWS

from .presets import DEFAULT_PRESET, PRESETS, Preset
from .request import EncodeRequest
from .view_table_builder import MOST_VIEWPOINTS

# Pixels of a planned view of the usual width, and ratio of planned views to the number in a preset,
# as they were measured.
_PLANNED_PIXELS: Final = 480 * 360
_PLANNED_RATIO: Final = 1.15

_PLAN: Final = 2.0
# Costs per view: for each pixel, and for each splat; of scoring, up to a million splats.
_SCORE: Final = (1.9e-7, 6.1e-7)
_REFERENCE: Final = (6e-8, 9e-7)
_PREDICT: Final = (9.3e-7, 1.4e-6)
# Share of reference views that remains without jittered copies, of which each view has two.
_WITHOUT_JITTER: Final = 1 / 3
# Costs with the preset `balanced`: fixed, and for each splat.
_GAIN: Final = (5.5, 6e-5)
_COMPENSATE: Final = (1.35, 3.7e-5)
# Cost per view, for each pixel and for each splat, of regions where scores are given; the panorama
# of a viewpoint takes twice that.
_REGIONS: Final = (1.4e-7, 4e-7)
_PANORAMA: Final = 2.0
# The first prefix of the order by marginal gain, as a share of the scene. All splats are taken as
# effective here.
_FIRST_PREFIX: Final = 1 / 8000
_PREVIEW: Final = 16.0
_ORDER: Final = (1e-3, 7e-8)
_QUANTISERS: Final = (0.2, 2e-6)
_CHUNKS: Final = (0.05, 2e-5)
_RENDER: Final = (8e-8, 4e-7)
_CODEBOOKS: Final = (0.1, 5.5e-5)
_WRITE: Final = (0.02, 2e-6)

# Average encodes of a search for a target, and of a nominal quality in planned views; cost of one
# render of a view as a share of a prediction, which renders several prefixes.
_TRIALS: Final = 3
_NOMINAL_TRIALS: Final = 2
_ONE_RENDER: Final = 0.33


def stage_costs(splats: int, request: EncodeRequest, *, scored: bool = False) -> list[StageCost]:
    """Return the expected cost of each stage of an encode, in the order of the stages.

    Parameters
    ----------
    splats : int
        Number of splats of the source.
    request : EncodeRequest
        Inputs of the encode.
    scored : bool
        Whether the request will have scores by the time it is encoded.

    Returns
    -------
    list of StageCost
        The last is ``write``, which the caller reports.
    """
    request = request.at_shown_width()
    config, preset, cameras, target = (
        request.config, request.effort, request.cameras, request.target,
    )  # fmt: skip
    scored = scored or request.scores is not None
    fits = config.compensates
    planned = cameras is None and not scored
    jitter = request.jitters
    if cameras:
        views, pixels = len(preset.views(cameras)), _mean_pixels(cameras)
    else:
        usual = preset.plan_config()
        views = round(preset.planned_views * _PLANNED_RATIO)
        pixels = _PLANNED_PIXELS * (usual.at_width(request.shown_at).width / usual.width) ** 2
        jitter = jitter and preset.planned_jitter
    seen = bool(cameras) or planned
    order = split_name(config.order)[0]
    predictions = min(preset.prediction_views, len(cameras) if cameras else views)
    prediction = _of_view(_PREDICT, pixels, splats)
    costs = [StageCost("plan views", _PLAN)] if planned else []
    if scored and cameras and config.cells:
        costs.append(StageCost("regions", _of_view(_REGIONS, MAX_PIXELS, splats), views))
    if not scored:
        costs.append(_scoring(splats, views, pixels, preset, jitter=jitter))
    if seen and (fits or order == "gain"):
        share = preset.reference_share
        ratio = 1.0 if preset.reference_jitter else _WITHOUT_JITTER
        costs.append(_references(splats, min(views, preset.reference_views), share * pixels, ratio))
    if order == "gain":
        costs.append(_gain(splats, preset))
    costs.append(StageCost("order", _of_scene(_ORDER, splats)))
    books = _of_scene(_CODEBOOKS, splats) if config.profile == "vq" else 0.0
    quantisers = _of_scene(_QUANTISERS, splats)
    chunks = _of_scene(_CHUNKS, splats)
    nominal = planned and config.profile != "near-lossless"
    if target is None and not nominal:
        costs += [StageCost("codebooks", books)] if books else []
        costs += [StageCost("quantisers", quantisers), StageCost("chunks", chunks)]
    else:
        looked = min(TEST_VIEWS, views) if target is None or target.psnr_db is not None else 0
        trial = books + quantisers + chunks + looked * _ONE_RENDER * prediction
        trials = _NOMINAL_TRIALS if target is None else _TRIALS
        costs.append(StageCost("search", trial * trials, inner="chunks"))
    if seen and config.cells and config.view_table:
        panorama = _PANORAMA * _of_view(_REGIONS, MAX_PIXELS, splats)
        costs.append(StageCost("view table", panorama, min(views, MOST_VIEWPOINTS)))
    if seen and fits and config.preview is not None:
        costs.append(StageCost("preview", _PREVIEW * preset.reference_share))
    if seen and fits:
        costs.append(_fit(splats, preset))
    if seen:
        costs.append(StageCost("predict", prediction, predictions))
    return [*costs, StageCost("write", _of_scene(_WRITE, splats))]


def render_cost(splats: int, cameras: Sequence[Camera]) -> float:
    """Return the cost of rendering a scene once in each camera, in the unit of `stage_costs`.

    Parameters
    ----------
    splats : int
        Number of splats.
    cameras : sequence of Camera
        Cameras, at least one.
    """
    return len(cameras) * _of_view(_RENDER, _mean_pixels(cameras), splats)


def score_cost(
    splats: int, preset: Preset, cameras: Sequence[Camera], *, jitter: bool = True
) -> StageCost:
    """Return the cost of scoring a scene in a preset's share of the cameras.

    Parameters
    ----------
    splats : int
        Number of splats.
    preset : Preset
        Number of views and of jittered copies.
    cameras : sequence of Camera
        Given cameras, at least one.
    jitter : bool
        Score jittered copies as well.
    """
    views = len(preset.views(cameras))
    return _scoring(splats, views, _mean_pixels(cameras), preset, jitter=jitter)


def order_costs(splats: int, order: str, cameras: Sequence[Camera]) -> list[StageCost]:
    """Return the costs of the stages that order a scored scene.

    Parameters
    ----------
    splats : int
        Number of splats.
    order : str
        Name of the order (`order_rows`).
    cameras : sequence of Camera
        Scored cameras, at least one.

    Returns
    -------
    list of StageCost
        Stages that render; empty for an order that only sorts, whose cost is negligible.
    """
    if split_name(order)[0] != "gain":
        return []
    preset = PRESETS[DEFAULT_PRESET]
    return [
        _references(splats, len(cameras), _mean_pixels(cameras)),
        _gain(splats, preset),
    ]


def _scoring(splats: int, views: int, pixels: float, preset: Preset, *, jitter: bool) -> StageCost:
    """Return the cost of scoring."""
    steps = views * (1 + preset.jitter_copies if jitter else 1)
    return StageCost("score", _of_view(_SCORE, pixels, splats), steps)


def _references(splats: int, views: int, pixels: float, ratio: float = 1.0) -> StageCost:
    """Return the cost of rendering reference views, times the `ratio` that is rendered."""
    return StageCost("reference views", ratio * _of_view(_REFERENCE, pixels, splats), views)


def _gain(splats: int, preset: Preset) -> StageCost:
    """Return the cost of the order by marginal gain."""
    work = _gain_renders(preset.gain) / _gain_renders(GainEffort())
    fixed, each = _GAIN
    fixed *= preset.reference_share
    return StageCost("gain", work * _of_scene((fixed, each), splats))


def _gain_renders(effort: GainEffort) -> float:
    """Estimate the number of views that the order by marginal gain renders."""
    return effort.views * math.log(effort.ordered_ratio / _FIRST_PREFIX) / math.log1p(effort.growth)


def _fit(splats: int, preset: Preset) -> StageCost:
    """Return the cost of the compensation fit."""
    usual = PRESETS[DEFAULT_PRESET]
    work = preset.fit_iterations * preset.fit_views / (usual.fit_iterations * usual.fit_views)
    fixed, each = _COMPENSATE
    fixed *= preset.reference_share
    return StageCost("compensate", work * _of_scene((fixed, each), splats))


def _mean_pixels(cameras: Sequence[Camera]) -> float:
    """Return the mean number of pixels of the cameras."""
    return sum(camera.width * camera.height for camera in cameras) / len(cameras)


def _of_view(cost: tuple[float, float], pixels: float, splats: float) -> float:
    """Return a cost per view, from costs per pixel and per splat."""
    return cost[0] * pixels + cost[1] * splats


def _of_scene(cost: tuple[float, float], splats: int) -> float:
    """Return a cost per scene, from a fixed cost and a cost per splat."""
    return cost[0] + cost[1] * splats
