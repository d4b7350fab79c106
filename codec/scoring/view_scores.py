"""Scores of one view: blending weights and sensitivities of the splats that it shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.render.blend_weights import PEAK, add_weights
from cogsplat.codec.render.cuda_views import CudaScene
from cogsplat.codec.render.projection import Footprints, project
from cogsplat.codec.render.sensitivities import (
    COLUMNS,
    PAIRS_AT_ONCE,
    add_moments,
    view_sensitivities,
)
from cogsplat.codec.render.shading import footprint_colours
from cogsplat.codec.render.tiles import TileLists, sampled_tiles, tile_lists
from cogsplat.codec.splats import Splats

from .view_sums import sort_by_row


@dataclass(frozen=True)
class Weighing:
    """Settings of a scoring pass that apply to each view.

    Parameters
    ----------
    top_k, least_weight, near_plane, sensitivity_every
        See `contribution.ScoreConfig`.
    """

    top_k: int
    least_weight: float
    near_plane: float
    sensitivity_every: int


@dataclass(frozen=True, eq=False)
class ViewScores:
    """Weight sums and sensitivities of one view.

    Rows of the scene are ascending, the order in which a mapped scene is read fastest.

    Parameters
    ----------
    covered : (M,) int32
        Rows of the splats whose footprints reach the view, hidden or not.
    seen : (S,) int32
        Rows of the splats that a pixel shows.
    weight_sums : (S, 3) float64
        Sums of `blend_weights.add_weights`, in the order of `seen`.
    measured : (R,) int32
        Rows of the splats with sensitivities: those that change a pixel of the measured tiles; on a
        CUDA device, all with a footprint.
    measured_places : (R,) int32
        Row of `sensitivities` for each row of `measured`.
    sensitivities : (R, 13) float64
        Result of `view_sensitivities`, nearest splat first.
    """

    covered: NDArray[np.int32]
    seen: NDArray[np.int32]
    weight_sums: NDArray[np.float64]
    measured: NDArray[np.int32]
    measured_places: NDArray[np.int32]
    sensitivities: NDArray[np.float64]


def score_view(
    view: tuple[Camera, int], splats: Splats, *, rules: Weighing, threads: int
) -> ViewScores:
    """Score one view.

    Parameters
    ----------
    view : (Camera, int)
        Camera, and its phase in `sampled_tiles`; -1 to measure no sensitivities.
    splats : Splats
        Scene, drawn with the kernel of ``splats.info``.
    rules : Weighing
        Settings of the scoring pass.
    threads : int
        Number of threads, at least 1; the scores do not depend on it.
    """
    camera, phase = view
    footprints = project(splats, camera, near_plane=rules.near_plane)
    sums = np.zeros((len(footprints), 3), np.float64)
    size = (camera.width, camera.height)
    if phase < 0:
        for lists in tile_lists(footprints, *size):
            _weigh(lists, footprints, camera, rules, threads, sums)
        return _view_scores(footprints, sums, footprints.only(np.zeros(len(sums), np.bool_)))
    tiles = sampled_tiles(*size, rules.sensitivity_every, phase)
    measured: list[TileLists] = []
    for lists in tile_lists(footprints, *size, PAIRS_AT_ONCE):
        acts = _weigh(lists, footprints, camera, rules, threads, sums)
        measured.append(lists.of_pairs(acts & lists.pairs_in(tiles)))
    shown = np.zeros(len(footprints), np.bool_)
    for lists in measured:
        shown[lists.members] = True
    few = footprints.only(shown)
    places = np.cumsum(shown, dtype=np.int32) - np.int32(1)
    colours = footprint_colours(splats, camera, few)
    moments = np.zeros((len(few), COLUMNS), np.float64)
    for lists in measured:
        add_moments(lists.renumbered(places), few, colours, camera, threads, moments)
    columns = view_sensitivities(splats, camera, few, colours, moments)
    return _view_scores(footprints, sums, few, columns)


def _weigh(
    lists: TileLists,
    footprints: Footprints,
    camera: Camera,
    rules: Weighing,
    threads: int,
    sums: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """Add the weights of the footprints in some tiles; see `add_weights`."""
    least = rules.least_weight
    return add_weights(lists, footprints, camera, rules.top_k, threads, sums, least_weight=least)


def _view_scores(
    footprints: Footprints,
    weight_sums: NDArray[np.float64],
    measured: Footprints,
    sensitivities: NDArray[np.float64] | None = None,
) -> ViewScores:
    """Return the scores of a view with the weight sums sorted by row of the scene.

    The sensitivities, the widest array, stay in the order of the footprints, nearest first.
    """
    covered = footprints.sorted_rows()
    by_row = sort_by_row(footprints, weight_sums)
    seen = by_row[:, PEAK] > 0.0
    if sensitivities is None:
        sensitivities = np.zeros((0, COLUMNS), np.float64)
    return ViewScores(
        covered,
        covered[seen],
        by_row[seen],
        measured.sorted_rows(),
        measured.row_order(),
        sensitivities,
    )


def score_on_device(
    view: tuple[Camera, int], splats: Splats, scene: CudaScene, rules: Weighing
) -> ViewScores:
    """Score one view on a CUDA device; see `score_view`."""
    camera, phase = view
    drawn = scene.view(camera, near_plane=rules.near_plane)
    footprints, sums = drawn.footprints, drawn.weights(rules.top_k, rules.least_weight)
    if phase < 0:
        return _view_scores(footprints, sums, footprints.only(np.zeros(len(sums), np.bool_)))
    tiles = sampled_tiles(camera.width, camera.height, rules.sensitivity_every, phase)
    moments = drawn.moments(tiles)
    columns = view_sensitivities(splats, camera, footprints, drawn.colours, moments)
    return _view_scores(footprints, sums, footprints, columns)
