"""Occlusion: free length of rays through a scene, up to the splats that block the view."""

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
from cogsplat.codec.trained_arrays import opacities_from_logits

from .low_discrepancy import even_directions
from .subsample import MAX_LOG_SCALE

F64 = NDArray[np.float64]

_ALPHA_MAX: Final = float(ALPHA_MAX)

# Optical depth at which a ray is blocked: its transmittance is one half.
_BLOCKED: Final = math.log(2.0)
# Number of equal intervals in which a ray's optical depth is summed.
_STEPS: Final = 64
# Lower bound of a splat's standard deviations, relative to its largest, against division by zero.
_THINNEST: Final = 1e-4
_RAYS_AT_ONCE: Final = 16


@inner_kernel
def _crossing(
    whiten: F64, opacity: float, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float
) -> tuple[float, float]:
    """Return the distance along a ray at which a splat is densest, and its optical depth.

    The ray starts at o, relative to the splat's centre, and has the unit direction d. The splat's
    whole optical depth, -ln(1 - alpha), counts at its densest point, as in a rendered pixel.
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
    """Write the free length of each ray into `found`; see `Occluders.free_lengths`.

    `whiten` holds a matrix per splat that maps offsets to standard deviations.
    """
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
    """Fill `shares` with the blocked share of rays from each point; see `Occluders.occlusion`."""
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
            # If the point lies outside the sphere of the splat's radius, `least` is the squared
            # length of the tangent from the point. A ray meets the sphere only if it points towards
            # it and the foot of the perpendicular is at least the tangent's length away.
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
    """Splats as occluders of rays.

    A ray is blocked where its transmittance, the product of 1 - alpha over the splats that it
    crosses, falls to one half.

    Parameters
    ----------
    splats : Splats
        Splats with finite values only.
    threads : int
        Number of threads; 0 for every core this process may use. Results do not depend on it.
    """

    def __init__(self, splats: Splats, threads: int = 0) -> None:
        log_scales = np.clip(splats.scales.astype(np.float64), -MAX_LOG_SCALE, MAX_LOG_SCALE)
        deviations = np.exp(log_scales)
        largest = deviations.max(axis=1)
        deviations = np.maximum(deviations, _THINNEST * largest[:, None])
        # Whitening: maps an offset in scene units to the splat's axes, in standard deviations.
        axes = matrices(unit(splats.quats)).transpose(0, 2, 1)
        self._arrays: tuple[F64, F64, F64, F64] = (
            splats.means.astype(np.float64),
            np.ascontiguousarray(axes / deviations[:, :, None]),
            opacities_from_logits(splats.opacities.astype(np.float64)),
            CUT_SIGMA * largest,
        )
        self._threads = thread_count(threads)

    def free_lengths(self, origins: F64, directions: F64, lengths: F64, starts: F64) -> F64:
        """Return the distance at which each ray is blocked.

        Parameters
        ----------
        origins : (R, 3) float64
            Start of each ray, scene units.
        directions : (R, 3) float64
            Direction of each ray, unit vectors.
        lengths : (R,) float64
            Length of each ray, scene units.
        starts : (R,) float64
            Distance up to which crossed splats are ignored, scene units.

        Returns
        -------
        (R,) float64
            Free length, scene units, in steps of 1/64 of the ray's length; the whole length if
            nothing blocks the ray.
        """
        found = np.empty(len(origins), np.float64)
        # Contiguous copies: the kernel is compiled for C-contiguous arrays.
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
        """Return the share of directions in which the view from each point is blocked.

        Parameters
        ----------
        points : (P, 3) float64
            Points to look from, scene units.
        reaches : (P,) float64
            Length of the rays from each point, scene units; may be infinite.
        num_directions : int
            Number of rays per point, spread evenly over the sphere.

        Returns
        -------
        (P,) float64
            0 if no direction is blocked, 1 if all are.
        """
        shares = np.empty(len(points), np.float64)
        directions = even_directions(num_directions)

        def trace(part: slice) -> None:
            _occlusion(*self._arrays, points[part], reaches[part], directions, shares[part])

        self._in_parts(trace, len(points))
        return shares

    def _in_parts(self, work: Callable[[slice], None], count: int) -> None:
        """Call `work` for slices that together cover `count` rows, and return when all are done."""
        parts = (slice(i, i + _RAYS_AT_ONCE) for i in range(0, count, _RAYS_AT_ONCE))
        for _ in ordered_map(work, parts, self._threads):
            pass
