"""Axis-aligned boxes around splats and their footprints, for chunks and scenes."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.splats import Splats

from .rotations import matrices, unit

CUT_SIGMA: Final = 3.33
"""Standard deviations at which the opacity of an opaque splat falls to 1/255: sqrt(2·ln 255)."""


def box(splats: Splats) -> NDArray[np.float64]:
    """Return the box around all splats, each up to where its density falls to 1/255.

    Parameters
    ----------
    splats : Splats
        At least one row, all finite.

    Returns
    -------
    (6,) float64
        Minimum then maximum corner, scene units.
    """
    turned = matrices(unit(splats.quats))
    # exp of a log scale above 80 leaves float32; nothing drawn is that large.
    deviations = np.exp(np.minimum(splats.scales.astype(np.float64), 80.0))
    reach = CUT_SIGMA * np.sqrt(np.square(turned * deviations[:, None, :]).sum(axis=2))
    means = splats.means.astype(np.float64)
    return np.concatenate([(means - reach).min(axis=0), (means + reach).max(axis=0)])
