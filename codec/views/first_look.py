"""First look: how a viewer first shows a scene."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera


@dataclass(frozen=True, eq=False)
class FirstLook:
    """Up direction, first view and core box that a file stores for viewers (SPEC 4.2, 4.4).

    Parameters
    ----------
    up : (3,) float64, optional
        Unit vector against gravity in the frame of the means.
    view : Camera, optional
        Camera where a viewer starts, with the target that an orbit turns around.
    core_box : (6,) float64, optional
        Bounding box without stray splats: minimum corner, maximum corner; scene units.
    """

    up: NDArray[np.float64] | None = None
    view: Camera | None = None
    core_box: NDArray[np.float64] | None = None
