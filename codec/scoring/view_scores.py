"""Scores of one view: blending weights and sensitivities of the splats that it shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.render.blend_weights import PEAK, add_weights
from cogsplat.codec.render.cuda_views import CudaScene
from cogsplat.codec.render.front_to_back import FrontToBack
from cogsplat.codec.render.projection import Footprints
from cogsplat.codec.render.sensitivities import (
    COLUMNS,
    PAIRS_AT_ONCE,
    add_moments,
    view_sensitivities,
)
from cogsplat.codec.render.shading import footprint_colours
from cogsplat.codec.render.splat_blocks import SplatBlocks
from cogsplat.codec.render.tiles import TileLists, join_lists, sampled_tiles, tile_lists
from cogsplat.codec.splats import Splats

from .score_config import ScoreConfig


@dataclass(frozen=True, eq=False)
class ViewScores:
    """Weight sums and sensitivities of one view.

    Rows of the scene are ascending in each slab of depth (`FrontToBack`), the order in which a
    mapped scene is read fastest.

    Parameters
    ----------
    covered : (M,) int32
        Rows of the splats whose footprints reach the view, hidden or not, but for those of
        `hidden`.
    hidden : (h,) int64
        Blocks all of whose splats that can be drawn have footprints that nearer splats hide.
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
    hidden: NDArray[np.int64]
    seen: NDArray[np.int32]
    weight_sums: NDArray[np.float64]
    measured: NDArray[np.int32]
    measured_places: NDArray[np.int32]
    sensitivities: NDArray[np.float64]


def score_view(
    view: tuple[Camera, int],
    splats: Splats,
    blocks: SplatBlocks | None = None,
    *,
    config: ScoreConfig,
    threads: int,
) -> ViewScores:
    """Score one view.

    Parameters
    ----------
    view : (Camera, int)
        Camera, and its phase in `sampled_tiles`; -1 to measure no sensitivities.
    splats : Splats
        Scene, drawn with the kernel of ``splats.info``.
    blocks : SplatBlocks, optional
        Blocks of the scene. With them, most splats that the view does not show take no time; the
        scores are the same.
    config : ScoreConfig
        Settings of the scoring pass.
    threads : int
        Number of threads, at least 1; the scores do not depend on it.
    """
    camera, phase = view
    walk = FrontToBack(
        splats, blocks, camera, near_plane=config.near_plane, hides=config.top_k == 0
    )
    size = (camera.width, camera.height)
    is_measured = phase >= 0
    tiles = sampled_tiles(*size, config.sensitivity_every, phase) if is_measured else None
    found = _Found()
    for footprints in walk.slabs():
        sums = np.zeros((len(footprints), 3), np.float64)
        lists_of_slab: list[TileLists] = []
        for lists in tile_lists(footprints, *size, PAIRS_AT_ONCE, walk.is_open):
            acts = add_weights(
                lists,
                footprints,
                camera,
                config.top_k,
                threads,
                sums,
                least_weight=config.least_weight,
                transmittances=walk.transmittances,
            )
            if tiles is not None:
                lists_of_slab.append(lists.of_pairs(acts & lists.pairs_in(tiles)))
        found.add(footprints, sums, lists_of_slab)
    few = found.measured()
    if not len(few):
        return found.scores(few, np.zeros((0, COLUMNS), np.float64), walk.hidden)
    colours = footprint_colours(splats, camera, few)
    moments = np.zeros((len(few), COLUMNS), np.float64)
    for lists in join_lists(found.lists).bands(PAIRS_AT_ONCE):
        add_moments(lists, few, colours, camera, threads, moments)
    columns = view_sensitivities(splats, camera, few, colours, moments)
    return found.scores(few, columns, walk.hidden)


class _Found:
    """Rows and sums of the splats found in the slabs of a view so far."""

    def __init__(self) -> None:
        self._covered: list[NDArray[np.int32]] = []
        self._seen: list[NDArray[np.int32]] = []
        self._sums: list[NDArray[np.float64]] = []
        self._measured: list[Footprints] = []
        self._count = 0
        # Lists of the measured footprints, numbered from slab to slab.
        self.lists: list[TileLists] = []

    def add(
        self, footprints: Footprints, sums: NDArray[np.float64], measured: list[TileLists]
    ) -> None:
        """Add a slab: its footprints, their weight sums, and the lists of the measured tiles."""
        ascending = footprints.row_order()
        seen = ascending[sums[ascending, PEAK] > 0.0]
        self._covered.append(footprints.sorted_rows())
        self._seen.append(footprints.index[seen])
        self._sums.append(sums[seen])
        shown = np.zeros(len(footprints), np.bool_)
        for lists in measured:
            shown[lists.members] = True
        few = footprints.only(shown)
        places = np.cumsum(shown, dtype=np.int32) + np.int32(self._count - 1)
        self.lists += [lists.renumbered(places) for lists in measured]
        self._measured.append(few)
        self._count += len(few)

    def measured(self) -> Footprints:
        """Return the footprints in the measured tiles, nearest first."""
        return Footprints.joined(self._measured)

    def scores(
        self, measured: Footprints, sensitivities: NDArray[np.float64], hidden: NDArray[np.int64]
    ) -> ViewScores:
        """Return the scores of the view.

        The sensitivities, the widest array, stay in the order of the footprints, nearest first.
        """
        return ViewScores(
            np.concatenate(self._covered),
            hidden,
            np.concatenate(self._seen),
            np.concatenate(self._sums),
            measured.sorted_rows(),
            measured.row_order(),
            sensitivities,
        )


def score_on_device(
    view: tuple[Camera, int], splats: Splats, scene: CudaScene, config: ScoreConfig
) -> ViewScores:
    """Score one view on a CUDA device; see `score_view`."""
    camera, phase = view
    drawn = scene.view(camera, near_plane=config.near_plane)
    footprints, sums = drawn.footprints, drawn.weights(config.top_k, config.least_weight)
    found, no_blocks = _Found(), np.empty(0, np.int64)
    found.add(footprints, sums, [])
    if phase < 0:
        return found.scores(found.measured(), np.zeros((0, COLUMNS), np.float64), no_blocks)
    tiles = sampled_tiles(camera.width, camera.height, config.sensitivity_every, phase)
    moments = drawn.moments(tiles)
    columns = view_sensitivities(splats, camera, footprints, drawn.colours, moments)
    return found.scores(footprints, columns, no_blocks)
