"""Small pictures of a subsample, by which candidates for the first view are judged."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.geometry.frustum import NEAR
from cogsplat.codec.geometry.sh import C0, COLOUR_OFFSET
from cogsplat.codec.render.peak_weights import peak_weights

from .subsample import Subsample

F64 = NDArray[np.float64]

# Longer side of a small picture, px.
_SIDE_PX: Final = 64
# Focal length of a picture of 120 degrees, in widths.
_WIDE_FOCAL: Final = 0.29
# Peak blending weight from which on a splat's visibility is 1.
_VISIBLE_PEAK: Final = 0.3
# Radius in the full picture from which on a splat's detail is resolved, px.
_RESOLVED_PX: Final = 4.0
# Share of the picture's longer side above which a splat's diameter is large: near and blurred.
_LARGE_SHARE: Final = 0.25
# Sharpness of a picture that large splats fill.
_BLURRED: Final = 0.2
# Share of the width and of the height that is the middle of the picture.
_MIDDLE: Final = 0.3


@dataclass(frozen=True, eq=False)
class SmallPicture:
    """Splats that a small picture of a view shows, and the picture's sharpness and colours.

    Parameters
    ----------
    index : (n,) int32
        Rows of the subsample in the picture.
    visibility : (n,) float64
        Visibility of each of these splats, 0 to 1: its peak blending weight over 0.3.
    resolved : (n,) float64
        Visibility, reduced for splats whose radius is below 4 px in the full picture.
    sharpness : float
        1 for a picture of small splats; falls to 0.2 as large near splats fill it.
    middle_depth : float
        Median depth of the splats in the middle of the picture, scene units.
    light : float
        Mean brightness, 0 to 1.
    contrast : float
        Standard deviation of the differences between colour channels.
    """

    index: NDArray[np.int32]
    visibility: F64
    resolved: F64
    sharpness: float
    middle_depth: float
    light: float
    contrast: float

    def raise_visibility(self, visibility: F64) -> None:
        """Raise the visibility of the subsample's splats, in place, to this picture's."""
        visibility[self.index] = np.maximum(visibility[self.index], self.visibility)

    @classmethod
    def draw(cls, scene: Subsample, camera: Camera, *, wide: bool = False) -> SmallPicture:
        """Draw a small picture of a subsample; a wide one shows 120 degrees in fewer pixels."""
        small = _shrink(camera)
        if wide:
            side = _SIDE_PX // 2
            small = replace(
                small, width=side, height=side, fx=_WIDE_FOCAL * side, fy=_WIDE_FOCAL * side,
                cx=0.5 * side, cy=0.5 * side,
            )  # fmt: skip
        index, peaks = peak_weights(scene.splats, small, NEAR)
        visibility = np.minimum(1.0, peaks.astype(np.float64) / _VISIBLE_PEAK)
        means = scene.splats.means[index].astype(np.float64)
        seen = means @ small.rotation.T + small.translation
        depths = np.maximum(seen[:, 2], NEAR)
        radii = scene.sizes[index] * small.fy / depths
        areas = np.pi * np.square(radii) * peaks
        large = 2.0 * radii > _LARGE_SHARE * max(small.width, small.height)
        filled = float(np.sum(areas, where=large)) / (small.width * small.height)
        sharpness = 1.0 - (1.0 - _BLURRED) * min(1.0, filled)
        offsets = np.abs(seen[:, :2]) * [small.fx, small.fy] / depths[:, None]
        middle = (offsets < 0.5 * _MIDDLE * np.array([small.width, small.height])).all(axis=1)
        weights = peaks.astype(np.float64) * np.minimum(1.0, areas)
        if not weights[middle].any():
            middle = np.ones(len(index), np.bool_)
        depth = 1.0
        if weights[middle].any():
            (depth,) = weighted_quantiles(depths[middle], weights[middle], (0.5,))
        colours = np.clip(COLOUR_OFFSET + C0 * scene.splats.sh0[index].astype(np.float64), 0.0, 1.0)
        mean = weights @ colours / max(float(weights.sum()), 1e-12)
        # Differences of channels: faces differ in colour, highlights in brightness alone.
        chroma = np.diff(colours - mean, axis=1)
        spread = weights @ np.square(chroma) / max(float(weights.sum()), 1e-12)
        contrast = math.sqrt(float(spread.sum()))
        resolved = visibility * np.minimum(
            1.0, scene.sizes[index] * camera.fy / depths / _RESOLVED_PX
        )
        return cls(index, visibility, resolved, sharpness, depth, float(mean.mean()), contrast)


def _shrink(camera: Camera) -> Camera:
    """Return a camera of the same view with a picture whose longer side is 64 px."""
    scale = _SIDE_PX / max(camera.width, camera.height)
    width, height = max(1, round(camera.width * scale)), max(1, round(camera.height * scale))
    return camera.resized(width, height)


def weighted_quantiles(values: F64, weights: F64, shares: Sequence[float]) -> list[float]:
    """Return weighted quantiles: the smallest value at which the weights reach each share."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    rows = [
        min(int(np.searchsorted(total, share * total[-1])), len(values) - 1) for share in shares
    ]
    return [float(values[order[row]]) for row in rows]
