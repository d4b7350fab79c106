"""Estimated costs of measuring quality, in the unit of `codec.encode.stage_costs`.

The overall progress bar needs the costs in advance. The costs of SSIM and PSNR are seconds of
processor time, measured on images of 480x360 pixels; `codec.encode.stage_costs` has those of
renders.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from cogsplat.codec.cameras import Camera
from cogsplat.codec.progress import StageCost
from cogsplat.codec.views.view_sets import CLOSE_VIEWS

# Cost of PSNR and SSIM per pixel.
_METRICS_COST: Final = 8.5e-7
# Roaming views per camera that `roam_views.roam` makes.
_ROAMING_VIEWS: Final = 2


def comparison_costs(
    splats: int, cameras: Sequence[Camera], *, close: bool = True
) -> list[StageCost]:
    """Return the costs of the stages of `view_quality.compare`.

    Parameters
    ----------
    splats : int
        Number of splats of the reference.
    cameras : sequence of Camera
        Test views, at least one.
    close : bool
        Whether close views are measured as well.
    """
    once = versions_cost(splats, cameras, 1, renders=2) / (1 + _ROAMING_VIEWS)
    costs = [StageCost("test", once)]
    if close:
        costs.append(StageCost("close", min(1.0, CLOSE_VIEWS / len(cameras)) * once))
    return [*costs, StageCost("roam", _ROAMING_VIEWS * once)]


def versions_cost(
    splats: int, cameras: Sequence[Camera], versions: int, *, renders: int = 1
) -> float:
    """Return the cost of measuring versions of a scene in test views and roaming views.

    Parameters
    ----------
    splats : int
        Number of splats of the largest version.
    cameras : sequence of Camera
        Test views, at least one; the cost of roaming views is added here.
    versions : int
        Number of versions.
    renders : int
        Number of renders per version and view.
    """
    pixels = sum(camera.width * camera.height for camera in cameras)
    per_version = renders * _render_cost(splats, cameras) + _METRICS_COST * pixels
    return versions * (1 + _ROAMING_VIEWS) * per_version


def references_cost(splats: int, cameras: Sequence[Camera]) -> float:
    """Return the cost of rendering the reference in test views and roaming views.

    Parameters
    ----------
    splats : int
        Number of splats of the reference.
    cameras : sequence of Camera
        Test views, at least one; the cost of roaming views is added here.
    """
    return (1 + _ROAMING_VIEWS) * _render_cost(splats, cameras)


def objects_cost(splats: int, cameras: Sequence[Camera], versions: int) -> float:
    """Return the cost of measuring versions of a scene object by object.

    Parameters
    ----------
    splats : int
        Number of splats of the reference.
    cameras : sequence of Camera
        Test views, at least one.
    versions : int
        Number of versions.
    """
    # Two more renders: the reference, and the labels (of up to three objects per render).
    return (versions + 2) * _render_cost(splats, cameras)


def _render_cost(splats: int, cameras: Sequence[Camera]) -> float:
    """Return the cost of rendering each view once, in the unit of `stage_costs`."""
    from cogsplat.codec.encode.stage_costs import render_cost

    return render_cost(splats, cameras)
