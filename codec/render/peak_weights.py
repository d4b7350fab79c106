"""Peak weights: the largest blending weight of each splat in one small picture."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.compiling import called_with
from cogsplat.codec.geometry.frustum import ALPHA_MIN, NEAR
from cogsplat.codec.splats import Splats

from .blending import ALPHA_MAX, TRANSMITTANCE_MIN, falloff, footprint_in_tile
from .jit import kernel
from .projection import HALF_HEIGHT, HALF_WIDTH, project

F32 = NDArray[np.float32]

_ALPHA_MIN = np.float32(ALPHA_MIN)
_ZERO = np.float32(0.0)
_ONE = np.float32(1.0)


@called_with("float32[:, ::1], int32[:, ::1], int64, int64, float32[::1]")
@kernel
def _peaks(ellipse: F32, rows: NDArray[np.int32], width: int, height: int, peaks: F32) -> None:
    """Blend footprints nearest first over a picture, and store the largest weight of each.

    This kernel has no tiles. In a picture of a few thousand pixels most splats reach only a few
    pixels, and tile lists would cost more than they save. The rasteriser skips a splat that lowers
    the transmittance below the limit; this kernel counts it, because an opaque surface is visible.

    Parameters
    ----------
    ellipse, rows
        Arrays of `Footprints`.
    width, height : int
        Image size, px.
    peaks : (M,) float32
        Output: largest blending weight of each footprint.
    """
    live = np.ones((height, width), np.float32)
    unfinished = width * height
    for i in range(len(ellipse)):
        narrow, shear, flat, opacity, centre_x, centre_y = footprint_in_tile(ellipse[i], 0, 0)
        peak = _ZERO
        for y in range(rows[i, 0], rows[i, 1]):
            dy = np.float32(y) - centre_y
            share = dy / ellipse[i, HALF_HEIGHT]
            if not share * share < _ONE:
                continue
            row_x = centre_x + shear * dy
            reach = ellipse[i, HALF_WIDTH] * math.sqrt(_ONE - share * share)
            # Clamped as floats: a huge splat would overflow the integers.
            first = math.ceil(max(row_x - reach, _ZERO))
            last = math.floor(min(row_x + reach, np.float32(width - 1)))
            row_exponent = -flat * dy * dy
            for x in range(first, last + 1):
                before = live[y, x]
                if before < TRANSMITTANCE_MIN:
                    continue
                u = narrow * (np.float32(x) - row_x)
                alpha = min(ALPHA_MAX, opacity * falloff(row_exponent - u * u))
                if alpha < _ALPHA_MIN:
                    continue
                after = before * (_ONE - alpha)
                live[y, x] = after
                peak = max(peak, before * alpha)
                unfinished -= int(after < TRANSMITTANCE_MIN)
        peaks[i] = peak
        if unfinished == 0:
            break


def peak_weights(
    splats: Splats, camera: Camera, near_plane: float = NEAR
) -> tuple[NDArray[np.int32], F32]:
    """Return the splats that reach a camera's picture, with the largest weight of each.

    Parameters
    ----------
    splats : Splats
        Scene, drawn with the kernel and anti-aliasing of ``splats.info``. Splats that cannot be
        drawn are ignored.
    camera : Camera
        Camera in the frame of the means; its picture should be small.
    near_plane : float
        Camera-space depth up to which nothing is drawn, scene units.

    Returns
    -------
    index : (M,) int32
        Rows of the scene, nearest first.
    peaks : (M,) float32
        Largest T·alpha in a pixel; 0 for hidden splats.
    """
    footprints = project(splats, camera, near_plane=near_plane)
    peaks = np.zeros(len(footprints), np.float32)
    _peaks(footprints.ellipse, footprints.rows, camera.width, camera.height, peaks)
    return footprints.index, peaks
