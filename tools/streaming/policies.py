"""Which unit a client wants next from a pose: by the file, by boxes, by what views show."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.geometry.frustum import NEAR
from cogsplat.codec.scheduling.chunk_ratios import PoseRatios, by_boxes, by_view_table
from cogsplat.codec.scheduling.poses import Pose
from cogsplat.codec.segments.view_table import ViewTable, share_codes, stored_directions

from .client import Priorities, Units

F64 = NDArray[np.float64]

# A chunk that a pose shows nothing of waits so many times as long as one of the usual share.
_LEAST_SHARE: Final = 0.02
# What keeps SGSS' distance from 0; the paper does not state its value (Zhu et al., MMSys 2025).
_EPSILON: Final = 1e-6


def file_order(units: Units) -> Priorities:
    """Return the order of the file, whatever the pose."""
    order = -np.arange(len(units), dtype=np.float64)
    return lambda _: order


def nearest_boxes(units: Units, boxes: F64) -> Priorities:
    """Return whole chunks by the distance of their boxes' middles from the eye."""
    middles = 0.5 * (boxes[:, :3] + boxes[:, 3:])

    def wanted(camera: Camera) -> F64:
        away = middles - camera.position
        return _of_units(units, -np.sqrt((away * away).sum(axis=1)))

    return wanted


def sgss(units: Units, boxes: F64, splats: F64) -> Priorities:
    """Return SGSS' priority: density times share of the picture over distance; unseen chunks last.

    Notes
    -----
    The share of the picture is that of the rectangle around a box's corners. SGSS' own test of
    visibility, by three projections, and its high and low priorities of requests are left out:
    what comes first is what counts here.
    """
    size = np.maximum(boxes[:, 3:] - boxes[:, :3], 1e-9)
    density = splats / size.prod(axis=1)

    def wanted(camera: Camera) -> F64:
        return _of_units(units, sgss_weights(boxes, density, camera)[0])

    return wanted


def sgss_weights(boxes: F64, density: F64, camera: Camera) -> tuple[F64, F64]:
    """Return density times share of the picture over distance of each box, and that share."""
    share, depth = seen_share(boxes, camera)
    return density * share / (np.maximum(depth, 0.0) + _EPSILON), share


def frustum(units: Units, boxes: F64, contribution: F64) -> Priorities:
    """Return the urgencies of docs/streaming.md, 5: by what boxes alone say."""
    return _urgent(units, by_boxes(boxes, contribution))


def by_views(units: Units, table: ViewTable, boxes: F64, contribution: F64) -> Priorities:
    """Return the urgencies of docs/streaming.md, 4: by what the viewpoints near a pose show.

    Parameters
    ----------
    units : Units
    table : ViewTable
    boxes : (c, 6) float64
    contribution : (c,) float64
        Of each chunk, as the file has it.
    """
    return _urgent(units, by_view_table(table, boxes, contribution))


def table_of(cameras: Sequence[Camera], contributions: F64) -> ViewTable:
    """Return the view table of some views, for a file that has none.

    Parameters
    ----------
    cameras : sequence of Camera
        At most 64.
    contributions : (V, c) float64
        Of each chunk to each view, px.
    """
    pixels = np.array([camera.width * camera.height for camera in cameras], np.float64)
    return ViewTable(
        np.stack([camera.position for camera in cameras]).astype(np.float32),
        stored_directions(np.stack([camera.rotation[2] for camera in cameras])),
        share_codes(contributions / pixels[:, None]),
    )


def by_pose(units: Units, contributions: Callable[[Camera], F64], contribution: F64) -> Priorities:
    """Return the same by what the pose itself shows, which no client can know."""
    return lambda camera: _put_off(units, contributions(camera), contribution)


def _urgent(units: Units, ratios: PoseRatios) -> Priorities:
    """Return what a byte of each unit is thought to gain (docs/streaming.md, 7)."""

    def wanted(camera: Camera) -> F64:
        found = ratios(Pose.of_camera(camera))
        of_units = np.where(units.chunk >= 0, found[np.maximum(units.chunk, 0)], 1.0)
        result: F64 = of_units / units.end
        return result

    return wanted


def _put_off(units: Units, shown: F64, contribution: F64) -> F64:
    """Return minus the place in the file, put off where a chunk shows less than usual."""
    total, usual = float(shown.sum()), contribution / max(float(contribution.sum()), 1e-300)
    if not total > 0.0:
        return -units.end.astype(np.float64)
    share = np.maximum(shown / total / np.maximum(usual, 1e-12), _LEAST_SHARE)
    of_units = np.where(units.chunk >= 0, share[np.maximum(units.chunk, 0)], 1.0)
    result: F64 = -(units.end / of_units)
    return result


def _of_units(units: Units, of_chunks: F64) -> F64:
    """Return each chunk's priority for its units; codebooks come with what needs them."""
    priorities = np.where(units.chunk >= 0, of_chunks[np.maximum(units.chunk, 0)], -np.inf)
    # Among equals, such as the segments of one chunk, the order of the file.
    rank = np.argsort(np.lexsort((np.arange(len(units)), -priorities)), kind="stable")
    return -rank.astype(np.float64)


def seen_share(boxes: F64, camera: Camera) -> tuple[F64, F64]:
    """Return the share of a picture that each box takes, and the depth of its middle."""
    corners = np.stack(
        [boxes[:, [3 * (i & 1), 1 + 3 * (i >> 1 & 1), 2 + 3 * (i >> 2)]] for i in range(8)], axis=1
    )
    local = corners @ camera.rotation.T + camera.translation
    depth = (0.5 * (boxes[:, :3] + boxes[:, 3:])) @ camera.rotation[2] + camera.translation[2]
    before = local[:, :, 2].max(axis=1) > NEAR
    z = np.maximum(local[:, :, 2], NEAR)
    share = before.astype(np.float64)
    for axis, focal, middle, size in (
        (0, camera.fx, camera.cx, camera.width),
        (1, camera.fy, camera.cy, camera.height),
    ):
        across = (focal * local[:, :, axis] / z + middle) / size
        low = np.clip(across.min(axis=1), 0.0, 1.0)
        high = np.clip(across.max(axis=1), 0.0, 1.0)
        share *= high - low
    return share, depth
