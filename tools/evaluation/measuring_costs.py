"""What measuring a scene costs, in the unit of `codec.encode.stage_costs`.

Progress of the whole work needs to know before: seconds of processor time of SSIM and PSNR were
measured with pictures of 480x360 pixels, those of renders stand in that module.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from cogsplat.codec.cameras import Camera
from cogsplat.codec.progress import StageCost

# PSNR and SSIM of a pixel.
_LIKENESS: Final = 8.5e-7
# Views away from the path that `view_sets.roam` makes of each camera.
_ROAMING: Final = 2


def comparison_costs(splats: int, cameras: Sequence[Camera]) -> list[StageCost]:
    """Return what the stages of `view_quality.compare` cost.

    Parameters
    ----------
    splats : int
        Of the reference.
    cameras : sequence of Camera
        At least one.
    """
    once = versions_cost(splats, cameras, 1, renders=2) / (1 + _ROAMING)
    return [StageCost("held-out", once), StageCost("roam", _ROAMING * once)]


def versions_cost(
    splats: int, cameras: Sequence[Camera], versions: int, *, renders: int = 1
) -> float:
    """Return what it costs to measure versions of a scene as `Evaluator.measure` does.

    Parameters
    ----------
    splats : int
        Of the largest.
    cameras : sequence of Camera
        Test views, roaming views not among them; at least one.
    versions : int
    renders : int
        Of each view of each version.
    """
    pixels = sum(camera.width * camera.height for camera in cameras)
    return versions * (1 + _ROAMING) * (renders * _drawn(splats, cameras) + _LIKENESS * pixels)


def references_cost(splats: int, cameras: Sequence[Camera]) -> float:
    """Return what it costs to draw the views that versions are compared in, the roaming ones too.

    Parameters
    ----------
    splats : int
    cameras : sequence of Camera
        Test views, roaming views not among them; at least one.
    """
    return (1 + _ROAMING) * _drawn(splats, cameras)


def objects_cost(splats: int, cameras: Sequence[Camera], versions: int) -> float:
    """Return what it costs to measure versions of a scene object by object.

    Parameters
    ----------
    splats : int
        Of the reference.
    cameras : sequence of Camera
        At least one.
    versions : int
    """
    # The reference, and the labels of three objects in one picture.
    return (versions + 2) * _drawn(splats, cameras)


def _drawn(splats: int, cameras: Sequence[Camera]) -> float:
    from cogsplat.codec.encode.stage_costs import render_cost

    return render_cost(splats, cameras)
