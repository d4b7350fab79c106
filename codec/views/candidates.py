"""Candidate views for planning: poses with the splats that a small picture from there shows."""

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

# Peak weight up to which a splat counts as not seen.
_FAINT: Final = 0.02
USUAL_PITCH_DEG: Final = 15.0
"""Usual pitch of a viewer's camera, degrees downwards: about level, slightly down."""

# Weight of a view whose pitch differs from the usual one by 90°.
_MIN_PITCH_WEIGHT: Final = 0.1


@dataclass(frozen=True, eq=False)
class Candidate:
    """A candidate view: a pose and the splats seen from it.

    Parameters
    ----------
    pose : Pose
        Pose of the view.
    index : (n,) int32
        Rows of the subsample that are seen.
    peaks : (n,) float32
        Peak weight of each seen splat in a pixel.
    exposure : (n,) float32
        Visibility of each seen splat, 0 to 1: its peak weight, reduced if the splat is too small
        to be resolved or the view is steep.
    """

    pose: Pose
    index: NDArray[np.int32]
    peaks: NDArray[np.float32]
    exposure: NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class CandidateInputs:
    """Inputs of `draw_candidate` that all candidates share.

    Parameters
    ----------
    scene : Subsample
        Scene to draw.
    detail : float
        Typical ratio of a splat's size to its distance in a picture of the scene.
    lens : Lens
        Size and field of view of the small picture.
    down : (3,) float64
        Unit vector; zeros if no direction is known to be down.
    near_plane : float
        Camera-space depth up to which nothing is drawn, scene units.
    """

    scene: Subsample
    detail: float
    lens: Lens
    down: F64
    near_plane: float


def draw_candidate(pose: Pose, inputs: CandidateInputs) -> Candidate:
    """Draw a small picture from a pose and return the splats that it shows.

    `Executor.map` may call this function in another process.
    """
    splats, sizes = inputs.scene.splats, inputs.scene.sizes
    camera = pose.camera(inputs.lens, inputs.down)
    index, peaks = peak_weights(splats, camera, inputs.near_plane)
    clear = peaks > _FAINT
    index, peaks = index[clear], peaks[clear]
    means = splats.means[index].astype(np.float64)
    distances = np.linalg.norm(means - pose.position, axis=1) / pose.zoom
    # Splats too far away to be resolved share pixels.
    resolved = np.minimum(1.0, sizes[index] / (distances * inputs.detail)) ** 2
    level = math.cos(math.radians(pitch_deg(pose, inputs.down) - USUAL_PITCH_DEG)) ** 2
    weight = _MIN_PITCH_WEIGHT + (1.0 - _MIN_PITCH_WEIGHT) * level
    return Candidate(pose, index, peaks, (weight * peaks * resolved).astype(np.float32))


def pitch_deg(pose: Pose, down: F64) -> float:
    """Return a pose's pitch, degrees downwards; 0 if `down` is zeros (unknown)."""
    return math.degrees(math.asin(min(1.0, max(-1.0, float(pose.forward @ down)))))
