"""Values of a scene that a format cannot store, and one warning per file that names them."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from typing import Final

from cogsplat.codec.errors import CogsplatWarning
from cogsplat.codec.splats import SceneInfo, Splats
from cogsplat.formats.storage.atomic import StrPath

_MOST_NAMED: Final = 6


def info_losses(info: SceneInfo, *, antialiased: bool = False) -> list[str]:
    """Return the values of `SceneInfo` that a format without fields for them loses, in words.

    Parameters
    ----------
    info : SceneInfo
        Of the scene to be written. Axes are the writer's own business.
    antialiased : bool
        Whether the format can say that a scene is anti-aliased.
    """
    default = SceneInfo()
    losses = []
    if info.origin != default.origin:
        losses.append(f"the origin {info.origin}")
    if info.colour_space != default.colour_space:
        losses.append(f"the colour space {info.colour_space}")
    if info.kernel_px != default.kernel_px:
        losses.append(f"the kernel of {info.kernel_px:g} px²")
    if info.antialiased and not antialiased:
        losses.append("the anti-aliasing flag")
    return losses


def extra_losses(splats: Splats) -> list[str]:
    """Return the extra attributes that a format without them loses, in words."""
    names = list(splats.extras)
    if not names:
        return []
    listed = ", ".join(names[:_MOST_NAMED])
    more = f" and {len(names) - _MOST_NAMED} more" if len(names) > _MOST_NAMED else ""
    return [f"the attributes {listed}{more}"]


def warn_of_losses(path: StrPath, name: str, losses: Sequence[str]) -> None:
    """Warn that `name` cannot hold `losses`, in one line; silent where there are none."""
    if losses:
        # The caller's caller is who asked for the file.
        warnings.warn(
            f"{os.fspath(path)}: {name} cannot hold {', '.join(losses)}",
            CogsplatWarning,
            stacklevel=3,
        )
