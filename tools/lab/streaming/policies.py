"""Fetch policies: functions from a camera to the urgency of each unit."""

from __future__ import annotations

from collections.abc import Callable, Collection

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.cameras import Camera
from cogsplat.tools.lab.scheduling.chunk_ratios import (
    MIN_RATIO,
    sgss_priorities,
    visibility_ratios,
)
from cogsplat.tools.lab.scheduling.poses import Pose
from cogsplat.tools.lab.scheduling.scene_rows import SceneRows
from cogsplat.tools.lab.scheduling.scheduler import urgencies

from .client import Priorities, Units

F64 = NDArray[np.float64]

ClientRatios = Callable[[Pose, Collection[int]], F64]
"""Function from a pose and the units present to the visibility ratio of each row, (r,) float64."""


def file_order(units: Units) -> Priorities:
    """Return the policy that fetches in the order of the file."""
    order = 1.0 / units.end.astype(np.float64)
    return lambda _, __: order


def nearest_chunks(units: Units, boxes: F64) -> Priorities:
    """Return the policy that fetches complete chunks by the distance of their box centres.

    Parameters
    ----------
    units : Units
    boxes : (r, 6) float64
        Boxes of chunks and pages.
    """
    centres = 0.5 * (boxes[:, :3] + boxes[:, 3:])

    def priorities(camera: Camera, _: Collection[int]) -> F64:
        offsets = centres - camera.position
        return _unit_priorities(units, -np.sqrt((offsets * offsets).sum(axis=1)))

    return priorities


def sgss_chunks(units: Units, boxes: F64, splats: F64) -> Priorities:
    """Return the policy that fetches complete chunks by SGSS' priority (docs/streaming.md, 6)."""
    chunk_priorities = sgss_priorities(boxes, splats)
    return lambda camera, _: _unit_priorities(units, chunk_priorities(Pose.from_camera(camera)))


def by_urgency(units: Units, ratios: ClientRatios) -> Priorities:
    """Return the policy that fetches by the urgency of docs/streaming.md, 7."""

    def priorities(camera: Camera, present: Collection[int]) -> F64:
        return urgencies(
            ratios(Pose.from_camera(camera), present), units.row, units.gain / units.size_bytes
        )

    return priorities


def by_true_contribution(
    units: Units, contributions: Callable[[Camera], F64], rows: SceneRows
) -> Priorities:
    """Return the oracle policy: urgencies from the true contributions to the current view.

    Parameters
    ----------
    units : Units
    contributions : callable
        Function from a camera to the contribution of each chunk, (c,) float64.
    rows : SceneRows
        Chunks and pages of the file, with their stored contributions.
    """
    # Contributions are measured again only for another camera, not for each page.
    last: list[tuple[Camera, F64]] = []

    def priorities(camera: Camera, _: Collection[int]) -> F64:
        if not last or last[0][0] is not camera:
            last[:] = [(camera, _true_ratios(contributions(camera), rows))]
        return urgencies(last[0][1], units.row, units.gain / units.size_bytes)

    return priorities


def _true_ratios(visibility: F64, rows: SceneRows) -> F64:
    """Return the ratios of rows for the true visibility of each chunk in a picture."""
    contribution = rows.contribution[: len(visibility)]
    ratios = visibility_ratios(visibility, contribution)
    # A page has the share of its chunks in the picture over their share of the contribution.
    sums, shares = rows.with_sums(contribution), rows.with_sums(ratios * contribution)
    found = np.where(sums > 0.0, shares / np.where(sums > 0.0, sums, 1.0), 1.0)
    found[: len(ratios)] = ratios
    return np.maximum(found, MIN_RATIO)


def _unit_priorities(units: Units, chunk_priorities: F64) -> F64:
    """Rank units by the priority of their chunk; codebooks come as dependencies."""
    priorities = np.where(units.row >= 0, chunk_priorities[np.maximum(units.row, 0)], -np.inf)
    # Ties, such as the segments of one chunk, keep the order of the file.
    rank = np.argsort(np.lexsort((np.arange(len(units)), -priorities)), kind="stable")
    result: F64 = 1.0 / (1.0 + rank.astype(np.float64))
    return result
