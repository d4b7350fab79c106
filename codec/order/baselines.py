"""Baseline orders from programs and papers, computed from a splat's own values.

Each function returns priorities, (N,) float64: splats of higher priority come first.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.splats import Splats

F64 = NDArray[np.float64]

# SGSS (Zhu et al. 2025), importance score: the exponent of the volume.
_SGSS_POWER = 0.1


def sort_descending(priority: NDArray[np.floating]) -> NDArray[np.int64]:
    """Return rows by descending priority: (N,) int64, ties in file order, NaN last."""
    return np.argsort(-priority, kind="stable").astype(np.int64)


def antimatter(splats: Splats) -> F64:
    """Return the priority of antimatter15/splat: ln of volume times opacity, exp(Σs)·σ(o)."""
    return scale(splats) + _log_opacity(splats)


def sgss(splats: Splats) -> F64:
    """Return the priority of SGSS: ln of σ(o)·(Πexp(s) / S₉₀)^0.1 (Zhu et al. 2025).

    S₉₀, the scene's 90th percentile of the volume, is a constant factor and omitted.
    """
    return _log_opacity(splats) + _SGSS_POWER * scale(splats)


def opacity(splats: Splats) -> F64:
    """Return the opacity logits."""
    return splats.opacities.astype(np.float64)


def scale(splats: Splats) -> F64:
    """Return the logarithm of the volume, Σs."""
    volume: F64 = splats.scales.astype(np.float64).sum(axis=1)
    return volume


def nearness(splats: Splats) -> F64:
    """Return the negated distance of each mean from the origin, scene units."""
    squares: F64 = np.square(splats.means.astype(np.float64)).sum(axis=1)
    return -np.sqrt(squares)


def _log_opacity(splats: Splats) -> F64:
    """Return the logarithm of each opacity, ln σ(o)."""
    logs: F64 = -np.logaddexp(0.0, -splats.opacities.astype(np.float64))
    return logs
