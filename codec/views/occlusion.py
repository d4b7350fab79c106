"""Occlusion: how far one sees from a point of a scene before splats block the view."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.compiling import called_with
from cogsplat.codec.geometry.bounds import CUT_SIGMA
from cogsplat.codec.geometry.frustum import ALPHA_MIN
from cogsplat.codec.geometry.rotations import matrices, unit
from cogsplat.codec.render.blending import ALPHA_MAX
from cogsplat.codec.render.jit import inner_kernel, kernel
from cogsplat.codec.splats import Splats
from cogsplat.codec.threads import ordered_map, thread_count

from .low_discrepancy import even_directions
from .subsample import MAX_LOG_SCALE

F64 = NDArray[np.float64]

_ALPHA_MAX: Final = float(ALPHA_MAX)

# A ray is blocked where the transmittance falls to one half: at this optical depth.
_BLOCKED: Final = math.log(2.0)
# Intervals of equal length that a ray's optical depth is summed in.
_STEPS: Final = 64
# Standard deviations are at least this share of a splat's largest one: no division by zero.
_THINNEST: Final = 1e-4
_RAYS_AT_ONCE: Final = 16


@inner_kernel
def _crossing(
    whiten: F64, opacity: float, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float
) -> tuple[float, float]:
    """Return where along a ray a splat is densest, and the optical depth that it adds.

    The ray begins at o, relative to the splat's centre, and goes along the unit vector d. The whole
    splat counts at its densest point: -ln(1 - alpha), as in a pixel that the ray belongs to.
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


@called_with(
    "float64[:, ::1], float64[:, :, ::1], float64[::1], float64[::1], float64[:, ::1], "
    "float64[:, ::1], float64[::1], float64[::1], float64[::1]"
)
@kernel
def _free_lengths(
    means: F64,
    whiten: F64,
    opacities_unit: F64,
    radii: F64,
    origins: F64,
    directions: F64,
    lengths: F64,
    starts: F64,
    found: F64,
) -> None:
    """Fill `found` with the length of each ray before it is blocked; see `Occluders`."""
    depth = np.empty(_STEPS, np.float64)
    for ray in range(len(origins)):
        depth[:] = 0.0
        length, start = lengths[ray], starts[ray]
        dx, dy, dz = directions[ray, 0], directions[ray, 1], directions[ray, 2]
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
        found[ray] = length
        for step in range(_STEPS):
            total += depth[step]
            if total >= _BLOCKED:
                found[ray] = length * step / _STEPS
                break


@called_with(
    "float64[:, ::1], float64[:, :, ::1], float64[::1], float64[::1], float64[:, ::1], "
    "float64[::1], float64[:, ::1], float64[::1]"
)
@kernel
def _occlusion(
    means: F64,
    whiten: F64,
    opacities_unit: F64,
    radii: F64,
    points: F64,
    reaches: F64,
    directions: F64,
    shares: F64,
) -> None:
    """Fill `shares` with the share of rays from each point that are blocked; see `Occluders`."""
    depth = np.empty(len(directions), np.float64)
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
            # Where the point lies outside the sphere of the splat's radius, `least` is the squared
            # length of the tangent from the point. Rays that meet the sphere lead towards it, and
            # the foot of the perpendicular from its centre is at least a tangent's length away.
            least = square - radius * radius
            for k in range(len(directions)):
                dx, dy, dz = directions[k, 0], directions[k, 1], directions[k, 2]
                along = -(ox * dx + oy * dy + oz * dz)
                if least > 0.0 and (along < 0.0 or along * along < least):
                    continue
                at, added = _crossing(whiten[i], opacities_unit[i], ox, oy, oz, dx, dy, dz)
                if added > 0.0 and at > 0.0 and at < reach:
                    depth[k] += added
        blocked = 0
        for k in range(len(directions)):
            blocked += int(depth[k] >= _BLOCKED)
        shares[point] = blocked / len(directions)


class Occluders:
    """Splats as what blocks the view along rays.

    A ray is blocked where the transmittance along it, the product of 1 - alpha over the splats that
    it crosses, falls to one half.

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
        # Takes an offset in scene units to the splat's axes, in its standard deviations.
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

    def free_lengths(self, origins: F64, directions: F64, lengths: F64, starts: F64) -> F64:
        """Return how far each ray goes before it is blocked.

        Parameters
        ----------
        origins, directions : (R, 3) float64
            Scene units; unit vectors.
        lengths : (R,) float64
            Where each ray ends, scene units.
        starts : (R,) float64
            Splats crossed nearer than this do not count, scene units.

        Returns
        -------
        (R,) float64
            Scene units, in steps of a 64th of the length; the length where nothing blocks the ray.
        """
        found = np.empty(len(origins), np.float64)
        # Contiguous copies: the kernel is compiled for one kind of array.
        origins, directions = (np.array(rays, order="C") for rays in (origins, directions))

        def trace(part: slice) -> None:
            _free_lengths(
                *self._arrays,
                origins[part],
                directions[part],
                lengths[part],
                starts[part],
                found[part],
            )

        self._in_parts(trace, len(origins))
        return found

    def occlusion(self, points: F64, reaches: F64, num_directions: int = 32) -> F64:
        """Return the share of all directions in which the view from each point is blocked.

        Parameters
        ----------
        points : (P, 3) float64
            Scene units.
        reaches : (P,) float64
            Length of the rays, scene units; may be infinite.
        num_directions : int
            How many rays, spread evenly over the sphere.

        Returns
        -------
        (P,) float64
            0 in the open, 1 where splats are all around.
        """
        shares = np.empty(len(points), np.float64)
        directions = even_directions(num_directions)

        def trace(part: slice) -> None:
            _occlusion(*self._arrays, points[part], reaches[part], directions, shares[part])

        self._in_parts(trace, len(points))
        return shares

    def _in_parts(self, work: Callable[[slice], None], count: int) -> None:
        """Call `work` for slices that together cover `count` rows, and wait for all."""
        parts = (slice(i, i + _RAYS_AT_ONCE) for i in range(0, count, _RAYS_AT_ONCE))
        for _ in ordered_map(work, parts, self._threads):
            pass
