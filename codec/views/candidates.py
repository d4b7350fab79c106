"""Candidates for planned views: what a view from a pose would show of the scene."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.render.peak_weights import peak_weights

from .pose import Lens, Pose
from .subsample import Subsample

F64 = NDArray[np.float64]

# A splat whose peak weight is at most this is not seen.
_FAINT: Final = 0.02
LEVEL_DEG: Final = 15.0
"""How steeply visitors look down, typically: about level, and rather down than up."""

# What a view at right angles to that counts.
_LEAST_LEVEL: Final = 0.1


@dataclass(frozen=True, eq=False)
class Candidate:
    """What a view from one pose would show.

    Parameters
    ----------
    pose : Pose
    index : (n,) int32
        Rows of the subsample that are seen.
    peaks : (n,) float32
        Peak weight of each in a pixel.
    exposure : (n,) float32
        How well each is shown: its peak weight, but less where it is too small to be resolved and
        where the view is steep. 0 to 1.
    """

    pose: Pose
    index: NDArray[np.int32]
    peaks: NDArray[np.float32]
    exposure: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class CandidateDrawing:
    """What drawing a candidate takes.

    Parameters
    ----------
    scene : Subsample
    detail : float
        Size over distance that is typical of the scene's splats in a picture.
    lens : Lens
        Of the small picture.
    down : (3,) float64
    near_plane : float
        Scene units.
    """

    scene: Subsample
    detail: float
    lens: Lens
    down: F64
    near_plane: float


def draw_candidate(pose: Pose, drawing: CandidateDrawing) -> Candidate:
    """Draw one small picture and measure what it shows; `Executor.map` calls it in any process."""
    splats, sizes = drawing.scene.splats, drawing.scene.sizes
    camera = pose.camera(drawing.lens, drawing.down)
    index, peaks = peak_weights(splats, camera, drawing.near_plane)
    clear = peaks > _FAINT
    index, peaks = index[clear], peaks[clear]
    means = splats.means[index].astype(np.float64)
    distances = np.linalg.norm(means - pose.position, axis=1) / pose.zoom
    # Splats that are too far away to be resolved share pixels.
    resolved = np.minimum(1.0, sizes[index] / (distances * drawing.detail)) ** 2
    level = math.cos(math.radians(pitch_deg(pose, drawing.down) - LEVEL_DEG)) ** 2
    share = _LEAST_LEVEL + (1.0 - _LEAST_LEVEL) * level
    return Candidate(pose, index, peaks, (share * peaks * resolved).astype(np.float32))


def pitch_deg(pose: Pose, down: F64) -> float:
    """Return by what angle a pose looks down, degrees; 0 where no direction is known to be down."""
    return math.degrees(math.asin(min(1.0, max(-1.0, float(pose.forward @ down)))))
