"""Up direction of a scene: from its cameras, or from its splats."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera

from .subsample import Subsample
from .surfaces import Surfaces
from .up_evidence import UpEvidence

F64 = NDArray[np.float64]

# Mean square of the cameras' right axes along the second direction below which all cameras have
# nearly the same heading (about 6° apart). Their right axes then say nothing of the pitch.
_LEAST_SPREAD: Final = 0.01
# Share of the spread of the right axes out of the horizontal plane, relative to that within it,
# above which the cameras roll too much to agree on a horizontal plane.
_MOST_ROLL: Final = 0.4
# Sine of the angle out of the horizontal plane from which on a camera's weight falls, and rounds of
# iterative reweighting.
_OUTLIER_SINE: Final = 0.03
_ROUNDS: Final = 10
# Length of the mean up axis below which the cameras point up in all directions.
_LEAST_MEAN: Final = 0.2

# Log likelihood ratio to the usual up from which on another direction is up. In 103 scenes with the
# right usual up, the ratio of the best other direction is at most 6.0, and 4.7 in all but two.
_LEAST_RATIO: Final = 6.5
# The same of a direction with large level surfaces, and its least level score: of rooms whose usual
# up is the normal of a wall, ratios are 5.9 and above.
_LEAST_LEVEL_RATIO, _LEAST_LEVEL = 5.0, 1.0
# Cosine of the angle to the usual up within which a direction is the same up, measured better.
_SAME_UP: Final = math.cos(math.radians(8.0))
# Cosine of the angle between the usual up and its refinement above which the usual up is kept.
_EXACT: Final = math.cos(math.radians(1.0))


def up_from_cameras(cameras: Sequence[Camera], usual: F64) -> F64:
    """Return the up direction that cameras agree on.

    People hold cameras level: up is orthogonal to their right axes. Where the right axes do not
    show it, up is the mean of the cameras' up axes.

    Parameters
    ----------
    cameras : sequence of Camera
        At least one.
    usual : (3,) float64
        Unit vector against gravity by the axes of the format, for cameras that contradict each
        other.

    Returns
    -------
    (3,) float64
        Unit vector in the frame of the cameras.
    """
    rights = np.array([camera.rotation[0] for camera in cameras])
    mean = -np.mean([camera.rotation[1] for camera in cameras], axis=0)
    length = float(np.linalg.norm(mean))
    fallback = mean / length if length >= _LEAST_MEAN else usual
    values = np.linalg.eigvalsh(rights.T @ rights)
    if values[0] > _MOST_ROLL * values[1]:
        return fallback
    weights = np.ones(len(rights))
    for _ in range(_ROUNDS):
        values, vectors = np.linalg.eigh((rights * weights[:, None]).T @ rights / weights.sum())
        found: F64 = vectors[:, 0]
        weights = 1.0 / np.maximum(np.abs(rights @ found), _OUTLIER_SINE)
    if values[1] < _LEAST_SPREAD:
        # One heading: the mean up axis, made orthogonal to the right axis that all share.
        level = fallback - (fallback @ vectors[:, 2]) * vectors[:, 2]
        size = float(np.linalg.norm(level))
        return level / size if size > math.sqrt(_LEAST_SPREAD) else fallback
    towards = float(found @ fallback)
    return found if towards >= 0.0 else -found


def up_from_splats(scene: Subsample, core: F64, usual: F64) -> F64:
    """Return the up direction that a scene's splats show.

    `usual` stays unless the evidence for another direction is far stronger.

    Parameters
    ----------
    scene : Subsample
        Scene.
    core : (6,) float64
        Bounding box without stray splats, scene units.
    usual : (3,) float64
        Unit vector against gravity by the axes of the format.

    Returns
    -------
    (3,) float64
        Unit vector in the frame of the means.
    """
    surfaces = Surfaces.of(scene, core)
    if surfaces is None or surfaces.is_sheet():
        return usual
    evidence = UpEvidence.of(surfaces)
    candidates = evidence.candidates(usual)
    scores, levels = evidence.scores(candidates)
    ratios = scores - scores[0]
    best = int(np.where(candidates @ usual > _SAME_UP, -np.inf, ratios).argmax())
    least = _LEAST_LEVEL_RATIO if levels[best] >= _LEAST_LEVEL else _LEAST_RATIO
    up = candidates[best] if ratios[best] > least else usual
    if up is usual:
        planes = surfaces.normals_of_planes()
        is_sharp = any(abs(float(normal @ usual)) > _SAME_UP for normal in planes)
    else:
        is_sharp = bool(levels[best] >= _LEAST_LEVEL)
    refined = surfaces.refine(up) if is_sharp else up
    return refined if float(refined @ up) < _EXACT or up is not usual else usual
