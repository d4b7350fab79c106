"""Quantisation steps of equal λ from splat energies alone: one constant cost per attribute."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.streams.records import Attribute

from .costs import (
    MEAN_COST,
    OPACITY_COST,
    ROTATION_COST,
    SCALE_COST,
    SCALE_FACTOR_COST,
    SH0_COST,
)

F64 = NDArray[np.float64]

SHN_COST: Final = 0.0796
"""Mean of Y² over directions, 1/4π: squared error of colour per squared error of a coefficient."""

_COSTS: Final[Mapping[Attribute, float]] = MappingProxyType(
    {
        Attribute.SCALES: SCALE_COST,
        Attribute.QUATS: ROTATION_COST,
        Attribute.OPACITIES: OPACITY_COST,
        Attribute.SCALE_FACTOR: SCALE_FACTOR_COST,
        Attribute.SH0: SH0_COST,
        Attribute.SHN: SHN_COST,
    }
)


@dataclass(frozen=True, eq=False)
class EnergyCosts:
    """Error costs proportional to energy, by splat or codebook row.

    Parameters
    ----------
    lagrangian : float
        λ of `allocation.lagrangian`.
    energy : (n,) float64
        Energy of each splat or codebook row, positive.
    """

    lagrangian: float
    energy: F64

    def take(self, rows: NDArray[np.integer] | NDArray[np.bool_]) -> EnergyCosts:
        """Return the costs of a selection of the splats or codebook rows."""
        return EnergyCosts(self.lagrangian, self.energy[rows])

    def step(self, attribute: Attribute) -> float:
        """Return the common step of an attribute for all rows: √(λ / mean cost).

        Parameters
        ----------
        attribute : Attribute
            Attribute other than the means, whose cost also depends on sizes (`mean_step`).
        """
        return float(np.sqrt(self.lagrangian / (_COSTS[attribute] * self.energy.mean())))

    def mean_step(self, scales: NDArray[np.float32]) -> float:
        """Return the common step of the means for all rows, scene units.

        Parameters
        ----------
        scales : (n, 3) float32
            Log scales; the means of smaller splats cost more.
        """
        # exp(-2·mean log): the same shift changes more of a small splat's pixels.
        inverse_size = np.exp(-2 * np.clip(scales.astype(np.float64).mean(axis=1), -40, 40))
        return float(np.sqrt(self.lagrangian / (MEAN_COST * (self.energy * inverse_size).mean())))
