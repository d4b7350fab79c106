"""Traces: where a visitor is at each moment, from cameras."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.geometry.rotations import from_matrices, matrices
from cogsplat.codec.views.view_sets import sample_evenly

F64 = NDArray[np.float64]

# SGSS' traces (Zhu et al., MMSys 2025): 40 poses of 2 s each; the first two poses in 20 s.
_ORBITAL_POSES: Final = 40
_ORBITAL_SECONDS: Final = 2.0
_DOLLY_SECONDS: Final = 20.0


@dataclass(frozen=True, eq=False)
class Trace:
    """Poses, and when they are reached; between them a visitor moves evenly.

    Parameters
    ----------
    cameras : sequence of Camera
        At least one, all of one size.
    times : (n,) float64
        Seconds, from 0, ascending.
    """

    cameras: Sequence[Camera]
    times: F64

    @property
    def seconds(self) -> float:
        """How long it takes."""
        return float(self.times[-1])

    def at(self, seconds: float) -> Camera:
        """Return the pose at a moment; the first before the trace, the last behind it."""
        after = int(np.searchsorted(self.times, seconds, side="right"))
        if after == 0 or after == len(self.times):
            return self.cameras[min(after, len(self.times) - 1)]
        share = (seconds - self.times[after - 1]) / (self.times[after] - self.times[after - 1])
        return _between(self.cameras[after - 1], self.cameras[after], float(share))


def _between(one: Camera, other: Camera, share: float) -> Camera:
    """Return a pose between two: positions in a line, rotations about one axis."""
    first, second = from_matrices(np.stack([one.rotation, other.rotation]).astype(np.float64))
    cosine = float((first * second).sum())
    second, cosine = (second, cosine) if cosine >= 0.0 else (-second, -cosine)
    angle = float(np.arccos(min(cosine, 1.0)))
    if angle < 1e-6:
        turned = (1.0 - share) * first + share * second
    else:
        turned = np.sin((1.0 - share) * angle) * first + np.sin(share * angle) * second
    turned /= np.sqrt((turned * turned).sum())
    rotation = matrices(turned[None])[0]
    position = (1.0 - share) * one.position + share * other.position
    return replace(one, rotation=rotation, translation=-(rotation * position).sum(axis=1))


def orbital(cameras: Sequence[Camera]) -> Trace:
    """Return SGSS' orbital trace: 40 poses, evenly chosen from the cameras, 2 s each.

    Of fewer cameras all are visited, in the same time.
    """
    chosen = sample_evenly(cameras, _ORBITAL_POSES)
    seconds = _ORBITAL_SECONDS * (_ORBITAL_POSES - 1) / max(len(chosen) - 1, 1)
    return Trace(chosen, seconds * np.arange(len(chosen), dtype=np.float64))


def dolly(cameras: Sequence[Camera]) -> Trace:
    """Return SGSS' dolly trace: from the first camera to the second in 20 s."""
    return Trace(cameras[:2], _DOLLY_SECONDS * np.arange(min(len(cameras), 2), dtype=np.float64))


def recorded(cameras: Sequence[Camera], seconds_each: float) -> Trace:
    """Return the trace of a recorded path, a pose every `seconds_each`."""
    return Trace(cameras, seconds_each * np.arange(len(cameras), dtype=np.float64))
