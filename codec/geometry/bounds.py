"""Axis-aligned bounding boxes of splats."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.splats import Splats

from .rotations import matrices, unit

CUT_SIGMA: Final = 3.33
"""Standard deviations at which the opacity of an opaque splat falls to 1/255: sqrt(2·ln 255)."""


def box(splats: Splats) -> NDArray[np.float64]:
    """Return the bounding box of all splats, each extended by `CUT_SIGMA` standard deviations.

    Opacities are ignored.

    Parameters
    ----------
    splats : Splats
        Splats with finite values only; at least one.

    Returns
    -------
    (6,) float64
        Minimum then maximum corner, scene units.
    """
    turned = matrices(unit(splats.quats))
    # exp of a log scale above 80 overflows float32; no drawn splat is that large.
    deviations = np.exp(np.minimum(splats.scales.astype(np.float64), 80.0))
    reach = CUT_SIGMA * np.sqrt(np.square(turned * deviations[:, None, :]).sum(axis=2))
    means = splats.means.astype(np.float64)
    return np.concatenate([(means - reach).min(axis=0), (means + reach).max(axis=0)])
