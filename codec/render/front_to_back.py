"""Footprints of a large scene from front to back, without what nearer splats hide."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.splats import Splats

from .blend_weights import open_tiles
from .blending import PIXELS
from .projection import Footprints, project
from .splat_blocks import (
    BLOCK_SPLATS,
    BOTTOM,
    EDGE,
    LEFT,
    OUTSIDE,
    RIGHT,
    TOP,
    SplatBlocks,
    block_views,
)
from .tiles import TILE

# Splats in the blocks of the first slab of depth, and in those of any. The larger number bounds the
# memory of a view, and keeps its arrays below 32 MiB, up to which glibc uses the memory of freed
# arrays again (mallopt(3), M_MMAP_THRESHOLD): with the arrays of a whole view, the kernel cleared
# new pages for 28 % of the time of scoring ten million splats.
_FIRST: Final = 1 << 16
_LARGEST: Final = 1 << 18


class FrontToBack:
    """Walk through a scene in slabs of depth, nearest first.

    Blocks whose pixels have all ended are left out: their splats change no pixel.

    Parameters
    ----------
    splats : Splats
        Scene, drawn with the kernel of ``splats.info``.
    blocks : SplatBlocks or None
        Blocks of the scene; None for one slab of all splats.
    camera : Camera
        Camera in the frame of the means.
    near_plane : float
        Camera-space depth up to which nothing is drawn, scene units.
    hides : bool
        Whether nearer splats hide others. False for one slab of all blocks in view.

    Attributes
    ----------
    transmittances : (T, 256) float32 or None
        Transmittance of each pixel behind the slabs so far; the caller updates it by
        `add_weights`. None for one slab.
    is_open : (T,) bool
        Tiles with a pixel that has not ended.
    hidden : (h,) int64
        After the walk, blocks that were left out. All their splats that can be drawn have a
        footprint in the picture.
    """

    def __init__(
        self,
        splats: Splats,
        blocks: SplatBlocks | None,
        camera: Camera,
        *,
        near_plane: float,
        hides: bool,
    ) -> None:
        self._splats = splats
        self._blocks = blocks
        self._camera = camera
        self._near_plane = near_plane
        self._tiles_x, tiles_y = -(-camera.width // TILE), -(-camera.height // TILE)
        self.is_open: NDArray[np.bool_] = np.ones(self._tiles_x * tiles_y, np.bool_)
        self.hidden = np.empty(0, np.int64)
        self.transmittances: NDArray[np.float32] | None = None
        if hides and blocks is not None:
            self.transmittances = np.empty((len(self.is_open), PIXELS), np.float32)
            open_tiles(camera.width, camera.height, self.transmittances)

    def slabs(self) -> Iterator[Footprints]:
        """Yield the footprints of each slab, each further away than the last."""
        if self._blocks is None:
            yield project(self._splats, self._camera, near_plane=self._near_plane)
            return
        blocks = self._blocks
        views = block_views(blocks, self._splats, self._camera, near_plane=self._near_plane)
        in_view = np.flatnonzero(views.kinds != OUTSIDE)
        if self.transmittances is None:
            yield self._project(in_view, (0.0, math.inf))
            return
        coming = in_view[np.argsort(views.nearest[in_view], kind="stable")]
        nearest = views.nearest[coming]
        hidden: list[NDArray[np.int64]] = []
        begun = coming[:0]
        first, size, depth, found = 0, _FIRST // BLOCK_SPLATS, 0.0, False
        while first < len(coming):
            last = min(first + size, len(coming))
            end = float(nearest[last]) if last < len(coming) else math.inf
            new = coming[first:last]
            shown = (views.kinds[new] == EDGE) | self._reaches_open(views.pixels[new])
            hidden.append(new[~shown])
            begun = np.concatenate((begun, new[shown]))
            if end > depth and len(begun):
                footprints = self._project(begun, (depth, end))
                if len(footprints):
                    yield footprints
                    found = True
                    self.is_open = np.asarray((self.transmittances > 0.0).any(axis=1))
                depth = end
            begun = begun[views.furthest[begun] >= end]
            first, size = last, min(2 * size, _LARGEST // BLOCK_SPLATS)
        if not found:
            # No footprint at all is a slab as well.
            yield self._project(begun[:0], (0.0, math.inf))
        self.hidden = np.concatenate(hidden) if hidden else begun

    def _project(self, blocks: NDArray[np.int64], depths: tuple[float, float]) -> Footprints:
        """Return the footprints of some blocks in a half-open range of depths."""
        assert self._blocks is not None
        return project(
            self._splats,
            self._camera,
            near_plane=self._near_plane,
            rows=self._blocks.rows_of(blocks),
            depths=depths,
        )

    def _reaches_open(self, pixels: NDArray[np.int32]) -> NDArray[np.bool_]:
        """Return a mask of the rows of `BlockViews.pixels` that reach an open pixel."""
        assert self.transmittances is not None
        tiles = (self.transmittances > 0.0).reshape(-1, self._tiles_x, TILE, TILE)
        is_open = tiles.swapaxes(1, 2).reshape(-1, self._tiles_x * TILE)
        counts = np.zeros((is_open.shape[0] + 1, is_open.shape[1] + 1), np.int32)
        is_open.cumsum(axis=0, dtype=np.int32).cumsum(axis=1, out=counts[1:, 1:])
        left, right, top, bottom = (pixels[:, k] for k in (LEFT, RIGHT, TOP, BOTTOM))
        found: NDArray[np.bool_] = (
            counts[bottom, right] - counts[top, right] - counts[bottom, left] + counts[top, left]
        ) > 0
        return found
