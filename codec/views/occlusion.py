"""What a camera would see of a scene, and what stands in the way: first looks, before scoring."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.geometry.bounds import CUT_SIGMA
from cogsplat.codec.geometry.frustum import ALPHA_MIN
from cogsplat.codec.geometry.rotations import matrices, unit
from cogsplat.codec.render.blending import ALPHA_MAX
from cogsplat.codec.render.jit import kernel
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import ordered_map, thread_count

from .subsample import MAX_LOG_SCALE

F64 = NDArray[np.float64]

_ALPHA_MAX: Final = float(ALPHA_MAX)

# A way is blocked where half of the light is gone.
_BLOCKED: Final = math.log(2.0)
_STEPS: Final = 64
# Splats are at least so thick, as a share of their largest deviation: no division by nothing.
_THINNEST: Final = 1e-4
_RAYS_AT_ONCE: Final = 16
_GOLDEN_ANGLE: Final = math.pi * (3.0 - math.sqrt(5.0))


def even_directions(count: int) -> F64:
    """Return (count, 3) unit vectors spread evenly: a Fibonacci lattice on the sphere."""
    k = np.arange(count)
    y = 1.0 - (2.0 * k + 1.0) / count
    ring = np.sqrt(1.0 - y * y)
    return np.stack([ring * np.cos(_GOLDEN_ANGLE * k), y, ring * np.sin(_GOLDEN_ANGLE * k)], axis=1)


@kernel
def _crossing(
    whiten: F64, opacity: float, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float
) -> tuple[float, float]:
    """Return where a way is deepest in a splat, and the optical depth it meets there.

    The way begins at o, relative to the splat's centre, and leads towards the unit vector d.
    """
    oo = dd = od = 0.0
    for k in range(3):
        o = whiten[k, 0] * ox + whiten[k, 1] * oy + whiten[k, 2] * oz
        d = whiten[k, 0] * dx + whiten[k, 1] * dy + whiten[k, 2] * dz
        oo += o * o
        od += o * d
        dd += d * d
    alpha = min(_ALPHA_MAX, opacity * math.exp(-0.5 * max(oo - od * od / dd, 0.0)))
    if not alpha >= ALPHA_MIN:
        return 0.0, 0.0
    return -od / dd, -math.log(1.0 - alpha)


@kernel
def _free_paths(
    means: F64,
    whiten: F64,
    opacities_unit: F64,
    radii: F64,
    origins: F64,
    towards: F64,
    lengths: F64,
    starts: F64,
    paths: F64,
) -> None:
    depth = np.empty(_STEPS, np.float64)
    for ray in range(len(origins)):
        depth[:] = 0.0
        length, start = lengths[ray], starts[ray]
        dx, dy, dz = towards[ray, 0], towards[ray, 1], towards[ray, 2]
        for i in range(len(means)):
            ox = origins[ray, 0] - means[i, 0]
            oy = origins[ray, 1] - means[i, 1]
            oz = origins[ray, 2] - means[i, 2]
            radius = radii[i]
            along = -(ox * dx + oy * dy + oz * dz)
            if along < -radius or along > length + radius:
                continue
            if ox * ox + oy * oy + oz * oz - along * along > radius * radius:
                continue
            at, added = _crossing(whiten[i], opacities_unit[i], ox, oy, oz, dx, dy, dz)
            if added > 0.0 and at > start and at < length:
                depth[int(at / length * _STEPS)] += added
        total = 0.0
        paths[ray] = length
        for step in range(_STEPS):
            total += depth[step]
            if total >= _BLOCKED:
                paths[ray] = length * step / _STEPS
                break


@kernel
def _enclosed(
    means: F64,
    whiten: F64,
    opacities_unit: F64,
    radii: F64,
    points: F64,
    reaches: F64,
    towards: F64,
    shares: F64,
) -> None:
    depth = np.empty(len(towards), np.float64)
    for point in range(len(points)):
        depth[:] = 0.0
        reach = reaches[point]
        for i in range(len(means)):
            ox = points[point, 0] - means[i, 0]
            oy = points[point, 1] - means[i, 1]
            oz = points[point, 2] - means[i, 2]
            radius = radii[i]
            square = ox * ox + oy * oy + oz * oz
            if square > (reach + radius) * (reach + radius):
                continue
            # Above 0 where the point lies outside the splat's sphere; then ways that meet it keep
            # at least so much (squared) along them, and lead towards it.
            least = square - radius * radius
            for k in range(len(towards)):
                dx, dy, dz = towards[k, 0], towards[k, 1], towards[k, 2]
                along = -(ox * dx + oy * dy + oz * dz)
                if least > 0.0 and (along < 0.0 or along * along < least):
                    continue
                at, added = _crossing(whiten[i], opacities_unit[i], ox, oy, oz, dx, dy, dz)
                if added > 0.0 and at > 0.0 and at < reach:
                    depth[k] += added
        blocked = 0
        for k in range(len(towards)):
            blocked += int(depth[k] >= _BLOCKED)
        shares[point] = blocked / len(towards)


class Matter:
    """Splats as what stands in the way.

    Parameters
    ----------
    splats : Splats
        All finite.
    threads : int
        0 for every core this process may use. The answers do not depend on it.
    """

    def __init__(self, splats: Splats, threads: int = 0) -> None:
        log_scales = np.clip(splats.scales.astype(np.float64), -MAX_LOG_SCALE, MAX_LOG_SCALE)
        deviations = np.exp(log_scales)
        largest = deviations.max(axis=1)
        deviations = np.maximum(deviations, _THINNEST * largest[:, None])
        # From the world's axes to the splat's, in its deviations.
        axes = matrices(unit(splats.quats)).transpose(0, 2, 1)
        with np.errstate(over="ignore"):
            opacities_unit = 1.0 / (1.0 + np.exp(-splats.opacities.astype(np.float64)))
        self._arrays: tuple[F64, F64, F64, F64] = (
            splats.means.astype(np.float64),
            np.ascontiguousarray(axes / deviations[:, :, None]),
            opacities_unit,
            CUT_SIGMA * largest,
        )
        self._threads = thread_count(threads)

    def free_paths(self, origins: F64, towards: F64, lengths: F64, starts: F64) -> F64:
        """Return how far each way leads before half of the light is gone.

        Parameters
        ----------
        origins, towards : (R, 3) float64
            Scene units; unit vectors.
        lengths : (R,) float64
            Where each way ends, scene units.
        starts : (R,) float64
            Splats met nearer than this do not count, scene units.

        Returns
        -------
        (R,) float64
            In steps of a 64th of the length; the length where nothing stands in the way.
        """
        paths = np.empty(len(origins), np.float64)

        def walk(part: slice) -> None:
            _free_paths(
                *self._arrays,
                origins[part],
                towards[part],
                lengths[part],
                starts[part],
                paths[part],
            )

        self._in_parts(walk, len(origins))
        return paths

    def enclosed(self, points: F64, reaches: F64, num_directions: int = 32) -> F64:
        """Return the share of directions in which half of the light is gone within reach.

        Parameters
        ----------
        points : (P, 3) float64
            Scene units.
        reaches : (P,) float64
            How far to look, scene units; may be infinite.
        num_directions : int
            Spread evenly over the sphere.

        Returns
        -------
        (P,) float64
            0 in the open, 1 where there is matter all around.
        """
        shares = np.empty(len(points), np.float64)
        towards = even_directions(num_directions)

        def turn(part: slice) -> None:
            _enclosed(*self._arrays, points[part], reaches[part], towards, shares[part])

        self._in_parts(turn, len(points))
        return shares

    def _in_parts(self, work: Callable[[slice], None], count: int) -> None:
        parts = (slice(i, i + _RAYS_AT_ONCE) for i in range(0, count, _RAYS_AT_ONCE))
        for _ in ordered_map(work, parts, self._threads):
            pass
