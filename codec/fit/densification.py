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

# How far the halves of a splat lie from its centre, in standard deviations of its longest axis.
_APART: Final = 0.5
# Growth ends after this share of the steps; all that follow train the splats that there are. It
# happens so many times.
_GROWING_SHARE: Final = 0.6
_TIMES: Final = 8
# σ of this is 0.9999: what is more opaque has halves as if it were so.
_LARGEST_LOGIT: Final = 9.2


def split(splats: Splats) -> Splats:
    """Cut splats in two across their longest axis.

    Parameters
    ----------
    splats : Splats
        N of them.

    Returns
    -------
    Splats
        2 N, first one half of each, then the other. Both together have the mean, the covariance
        and, along a ray through the centre of the splat, nearly the transmittance of it.
    """
    rows = np.arange(len(splats))
    longest = np.argmax(splats.scales, axis=1)
    sizes = np.exp(splats.scales[rows, longest].astype(np.float64))
    axes = rotations.matrices(rotations.unit(splats.quats))[rows, :, longest]
    offsets = (_APART * sizes)[:, None] * axes
    narrower = math.sqrt(1.0 - _APART * _APART)
    scales = splats.scales.copy()
    scales[rows, longest] += np.float32(math.log(narrower))
    # What light is left behind the splat is shared as an exponent: -ln(1 - σ) = ln(1 + exp(logit)).
    depths = np.log1p(np.exp(np.minimum(splats.opacities.astype(np.float64), _LARGEST_LOGIT)))
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
    """Lets the splats of a scene become more while it is trained.

    Kerbl et al. 2023, section 5.2, with two changes. A number of splats is aimed at in place of a
    threshold: those with the largest mean gradient by their centre in the picture are cut in two.
    And all are cut alike, along their longest axis, so that the picture stays nearly the same;
    opacities are never reset. Splats that are hardly seen go at the same time.

    Parameters
    ----------
    frozen : int
        Of the first so many splats none is cut and none goes.
    target : int
        Splats behind the frozen ones, in the end, at most.
    steps : int
        Of the whole training.
    least_opacity : float
        Splats below go.
    """

    def __init__(self, frozen: int, target: int, steps: int, least_opacity: float) -> None:
        self._frozen = frozen
        self._target = target
        self._least = math.log(least_opacity / (1.0 - least_opacity))
        every = max(1, int(_GROWING_SHARE * steps / _TIMES))
        self._moments = [every * (k + 1) for k in range(_TIMES) if every * (k + 1) < steps]
        self._sums = np.zeros(0)
        self._seen = np.zeros(0, np.int64)

    def note(self, rows: NDArray[np.integer], by_centres: F64, count: int) -> None:
        """Take in what one picture asks for.

        Parameters
        ----------
        rows : (M,) int
            Splats that the picture shows.
        by_centres : (M, 2) float64
            Derivative of the loss by their centres, 1/px (`ForwardPass.backward`).
        count : int
            Splats of the scene.
        """
        if len(self._sums) != count:
            self._sums, self._seen = np.zeros(count), np.zeros(count, np.int64)
        self._sums[rows] += np.linalg.norm(by_centres, axis=1)
        self._seen[rows] += 1

    def is_due(self, steps: int) -> bool:
        """Tell whether the scene grows after so many steps."""
        return steps in self._moments

    def densify(self, scene: Splats, adam: SplatAdam, steps: int) -> tuple[Splats, SplatAdam]:
        """Return the scene with more splats, and what is known of their gradients.

        Frozen splats stay in front; halves take over the moments of what was cut.
        """
        movable = np.arange(len(scene)) >= self._frozen
        kept = np.flatnonzero(~movable | (scene.opacities >= self._least))
        able = kept[kept >= self._frozen]
        cut = able[:0]
        if len(able):
            left = sum(moment >= steps for moment in self._moments)
            aim = math.ceil(len(able) * (self._target / len(able)) ** (1.0 / left))
            asked = self._sums[able] / np.maximum(self._seen[able], 1)
            more = min(max(min(aim, self._target) - len(able), 0), int((asked > 0.0).sum()))
            cut = np.sort(able[np.argsort(-asked, kind="stable")[:more]])
        whole = np.setdiff1d(kept, cut, assume_unique=True)
        two = split(scene.take(cut))
        values = {
            name: np.concatenate([getattr(scene, name)[whole], getattr(two, name)])
            for name in Gradients.names()
        }
        self._sums = np.zeros(0)
        return with_values(scene, values), adam.take(np.concatenate([whole, cut, cut]))
