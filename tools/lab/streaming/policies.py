"""Which unit a client wants next from a pose: by the file, by boxes, by what views show."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.codec.segments.view_shares import ViewTable, encode_shares, quantise_directions
from cogsplat.tools.lab.scheduling.chunk_ratios import PoseRatios, by_sgss, over_usual
from cogsplat.tools.lab.scheduling.poses import Pose
from cogsplat.tools.lab.scheduling.scheduler import urgencies

from .client import Priorities, Units

F64 = NDArray[np.float64]


def file_order(units: Units) -> Priorities:
    """Return the order of the file, whatever the pose."""
    order = 1.0 / units.end.astype(np.float64)
    return lambda _: order


def nearest_boxes(units: Units, boxes: F64) -> Priorities:
    """Return whole chunks by the distance of their boxes' middles from the eye."""
    middles = 0.5 * (boxes[:, :3] + boxes[:, 3:])

    def wanted(camera: Camera) -> F64:
        away = middles - camera.position
        return _of_units(units, -np.sqrt((away * away).sum(axis=1)))

    return wanted


def sgss(units: Units, boxes: F64, splats: F64) -> Priorities:
    """Return whole chunks by SGSS' priority (docs/streaming.md, 6), those not visible last."""
    priorities = by_sgss(boxes, splats)
    return lambda camera: _of_units(units, priorities(Pose.of_camera(camera)))


def by_ratios(units: Units, ratios: PoseRatios) -> Priorities:
    """Return the urgencies of docs/streaming.md, 7."""
    return lambda camera: urgencies(ratios(Pose.of_camera(camera)), units.chunk, units.end)


def table_of(cameras: Sequence[Camera], contributions: F64) -> ViewTable:
    """Return the view table of some views, for a file that has none.

    Parameters
    ----------
    cameras : sequence of Camera
        At most 64.
    contributions : (V, c) float64
        Contribution of each chunk to each view, px: the shares of `chunk_contributions` times the
        pixels of the view.
    """
    pixels = np.array([camera.width * camera.height for camera in cameras], np.float64)
    return ViewTable(
        np.stack([camera.position for camera in cameras]).astype(np.float32),
        quantise_directions(np.stack([camera.rotation[2] for camera in cameras])),
        encode_shares(contributions / pixels[:, None]),
    )


def by_pose(units: Units, contributions: Callable[[Camera], F64], contribution: F64) -> Priorities:
    """Return the same by what the pose itself shows, which no client can know."""

    def wanted(camera: Camera) -> F64:
        ratios = over_usual(contributions(camera), contribution)
        return urgencies(ratios, units.chunk, units.end)

    return wanted


def _of_units(units: Units, of_chunks: F64) -> F64:
    """Return each chunk's priority for its units; codebooks come with what needs them."""
    priorities = np.where(units.chunk >= 0, of_chunks[np.maximum(units.chunk, 0)], -np.inf)
    # Among equals, such as the segments of one chunk, the order of the file.
    rank = np.argsort(np.lexsort((np.arange(len(units)), -priorities)), kind="stable")
    result: F64 = 1.0 / (1.0 + rank.astype(np.float64))
    return result
