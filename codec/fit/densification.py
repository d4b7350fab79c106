"""Splats that are split where the pictures of a scene need more detail."""

from __future__ import annotations

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.geometry import rotations
from cogsplat.codec.splats import Splats

from .differentiable_rendering import Gradients, with_values
from .splat_adam import SplatAdam

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]

# Distance of the two halves of a splat from its centre, in standard deviations of its longest axis.
_HALF_OFFSET: Final = 0.5
# Share of the training steps after which the number of splats no longer grows, and the number of
# times that it grows until then.
_GROWTH_SHARE: Final = 0.6
_GROWTH_COUNT: Final = 8
# Upper limit of the opacity logits of splats to split: an opacity of 0.9999.
_MAX_LOGIT: Final = 9.2


def split(splats: Splats) -> Splats:
    """Split each splat in two across its longest axis.

    Parameters
    ----------
    splats : Splats
        Scene of N splats.

    Returns
    -------
    Splats
        2 N splats: the first halves, then the second halves. Both halves together have the mean and
        the covariance of the splat, and nearly its transmittance along a ray through its centre.
    """
    rows = np.arange(len(splats))
    longest = np.argmax(splats.scales, axis=1)
    sizes = np.exp(splats.scales[rows, longest].astype(np.float64))
    axes = rotations.matrices(rotations.unit(splats.quats))[rows, :, longest]
    offsets = (_HALF_OFFSET * sizes)[:, None] * axes
    narrower = math.sqrt(1.0 - _HALF_OFFSET * _HALF_OFFSET)
    scales = splats.scales.copy()
    scales[rows, longest] += np.float32(math.log(narrower))
    # The optical depth of the splat is divided: -ln(1 - σ) = ln(1 + exp(logit)).
    depths = np.log1p(np.exp(np.minimum(splats.opacities.astype(np.float64), _MAX_LOGIT)))
    opacities = np.log(np.expm1(np.maximum(depths / (2.0 * narrower), 1e-12)))
    values = {
        name: np.concatenate([getattr(splats, name)] * 2)
        for name in Gradients.names()
        if name not in ("means", "scales", "opacities")
    }
    means = splats.means.astype(np.float64)
    values["means"] = np.concatenate([means + offsets, means - offsets]).astype(np.float32)
    values["scales"] = np.concatenate([scales] * 2)
    values["opacities"] = np.concatenate([opacities] * 2).astype(np.float32)
    return with_values(splats, values)


class Densification:
    """Schedule and statistics of splitting and pruning while a scene is trained.

    As in 3DGS (Kerbl et al. 2023, section 5.2), with two changes. Splats are split until a target
    count is reached, those with the largest mean image-space gradient first, without a threshold.
    All are split along their longest axis, which hardly changes pictures; opacities are never
    reset. Nearly transparent splats are pruned at the same time.

    Parameters
    ----------
    frozen : int
        Number of leading splats that stay as they are.
    target : int
        Maximum number of other splats at the end.
    steps : int
        Number of training steps.
    min_opacity : float
        Splats with a lower opacity are pruned.
    """

    def __init__(self, frozen: int, target: int, steps: int, min_opacity: float) -> None:
        self._frozen = frozen
        self._target = target
        self._min_logit = math.log(min_opacity / (1.0 - min_opacity))
        interval = max(1, int(_GROWTH_SHARE * steps / _GROWTH_COUNT))
        self._due_steps = [
            interval * (k + 1) for k in range(_GROWTH_COUNT) if interval * (k + 1) < steps
        ]
        self._gradient_sums = np.zeros(0)
        self._view_counts = np.zeros(0, np.int64)

    def accumulate(self, rows: NDArray[np.integer], by_centres: F64, count: int) -> None:
        """Add the image-space gradients of one view to the statistics.

        Parameters
        ----------
        rows : (M,) int
            Rows of the splats that the view shows.
        by_centres : (M, 2) float64
            Gradient of the loss w.r.t. their image-space centres, 1/px (`ForwardPass.backward`).
        count : int
            Number of splats of the scene.
        """
        if len(self._gradient_sums) != count:
            self._gradient_sums, self._view_counts = np.zeros(count), np.zeros(count, np.int64)
        self._gradient_sums[rows] += np.linalg.norm(by_centres, axis=1)
        self._view_counts[rows] += 1

    def is_due(self, steps: int) -> bool:
        """Return whether splats are to be split after a number of steps."""
        return steps in self._due_steps

    def densify(self, scene: Splats, adam: SplatAdam, steps: int) -> tuple[Splats, SplatAdam]:
        """Split and prune splats; return the new scene and its optimiser.

        Parameters
        ----------
        scene : Splats
            Scene in training.
        adam : SplatAdam
            Its optimiser. Both halves of a splat inherit its moments.
        steps : int
            Training steps made so far.

        Returns
        -------
        scene : Splats
            Frozen splats first, then the other unsplit ones, then the halves.
        adam : SplatAdam
            Optimiser of that scene.
        """
        trainable = np.arange(len(scene)) >= self._frozen
        kept = np.flatnonzero(~trainable | (scene.opacities >= self._min_logit))
        candidates = kept[kept >= self._frozen]
        to_split = candidates[:0]
        if len(candidates):
            remaining = sum(due >= steps for due in self._due_steps)
            growth = (self._target / len(candidates)) ** (1.0 / remaining)
            aim = min(math.ceil(len(candidates) * growth), self._target)
            counts = np.maximum(self._view_counts[candidates], 1)
            gradients = self._gradient_sums[candidates] / counts
            number = min(max(aim - len(candidates), 0), int((gradients > 0.0).sum()))
            to_split = np.sort(candidates[np.argsort(-gradients, kind="stable")[:number]])
        whole = np.setdiff1d(kept, to_split, assume_unique=True)
        halves = split(scene.take(to_split))
        values = {
            name: np.concatenate([getattr(scene, name)[whole], getattr(halves, name)])
            for name in Gradients.names()
        }
        self._gradient_sums = np.zeros(0)
        return with_values(scene, values), adam.select(np.concatenate([whole, to_split, to_split]))
