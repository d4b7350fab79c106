"""Camera traces: poses over time."""

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

# Traces of SGSS (Zhu et al., MMSys 2025): 40 poses of 2 s each; the first two poses in 20 s.
_ORBITAL_POSES: Final = 40
_ORBITAL_SECONDS: Final = 2.0
_DOLLY_SECONDS: Final = 20.0


@dataclass(frozen=True, eq=False)
class Trace:
    """Camera path with times; poses in between are interpolated.

    Parameters
    ----------
    cameras : sequence of Camera
        Key poses, at least one, all with the same picture size.
    times : (n,) float64
        Time of each key pose, s, ascending from 0.
    """

    cameras: Sequence[Camera]
    times: F64

    @property
    def seconds(self) -> float:
        """Duration, s."""
        return float(self.times[-1])

    def camera_at(self, seconds: float) -> Camera:
        """Interpolate the camera at a time; the first before the trace, the last after it."""
        after = int(np.searchsorted(self.times, seconds, side="right"))
        if after == 0 or after == len(self.times):
            return self.cameras[min(after, len(self.times) - 1)]
        share = (seconds - self.times[after - 1]) / (self.times[after] - self.times[after - 1])
        return _interpolate(self.cameras[after - 1], self.cameras[after], float(share))


def _interpolate(one: Camera, other: Camera, share: float) -> Camera:
    """Interpolate positions linearly and rotations spherically (slerp)."""
    first, second = from_matrices(np.stack([one.rotation, other.rotation]).astype(np.float64))
    cosine = float((first * second).sum())
    second, cosine = (second, cosine) if cosine >= 0.0 else (-second, -cosine)
    angle = float(np.arccos(min(cosine, 1.0)))
    if angle < 1e-6:
        quat = (1.0 - share) * first + share * second
    else:
        quat = np.sin((1.0 - share) * angle) * first + np.sin(share * angle) * second
    quat /= np.sqrt((quat * quat).sum())
    rotation = matrices(quat[None])[0]
    position = (1.0 - share) * one.position + share * other.position
    return replace(one, rotation=rotation, translation=-(rotation * position).sum(axis=1))


def orbital_trace(cameras: Sequence[Camera]) -> Trace:
    """Return the orbital trace of SGSS: 40 poses sampled evenly from the cameras, 2 s each.

    With fewer cameras, all are used and the duration stays the same.
    """
    chosen = sample_evenly(cameras, _ORBITAL_POSES)
    seconds = _ORBITAL_SECONDS * (_ORBITAL_POSES - 1) / max(len(chosen) - 1, 1)
    return Trace(chosen, seconds * np.arange(len(chosen), dtype=np.float64))


def dolly_trace(cameras: Sequence[Camera]) -> Trace:
    """Return the dolly trace of SGSS: from the first camera to the second in 20 s."""
    return Trace(cameras[:2], _DOLLY_SECONDS * np.arange(min(len(cameras), 2), dtype=np.float64))


def recorded_trace(cameras: Sequence[Camera], interval: float) -> Trace:
    """Return the trace through recorded cameras, one every `interval` seconds."""
    return Trace(cameras, interval * np.arange(len(cameras), dtype=np.float64))
