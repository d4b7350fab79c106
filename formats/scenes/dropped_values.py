"""Scene values that a foreign format cannot store, and the warning about a write that drops any."""

from __future__ import annotations

import os
import warnings
from collections.abc import Sequence
from typing import Final

from cogsplat.codec.errors import CogsplatWarning
from cogsplat.codec.splats import SceneInfo, Splats
from cogsplat.formats.storage.atomic import StrPath

_MAX_LISTED: Final = 6


def dropped_info(info: SceneInfo, *, antialiased: bool = False) -> list[str]:
    """List the values of `SceneInfo` that a format without metadata fields drops.

    Parameters
    ----------
    info : SceneInfo
        Metadata of the scene to write. Axes are ignored: each writer converts them.
    antialiased : bool
        Whether the format has a flag for anti-aliased scenes.

    Returns
    -------
    list of str
        One phrase for each dropped value, for `warn_dropped`.
    """
    default = SceneInfo()
    dropped = []
    if info.origin != default.origin:
        dropped.append(f"the origin {info.origin}")
    if info.colour_space != default.colour_space:
        dropped.append(f"the colour space {info.colour_space}")
    if info.kernel_px != default.kernel_px:
        dropped.append(f"the kernel of {info.kernel_px:g} px²")
    if info.antialiased and not antialiased:
        dropped.append("the anti-aliasing flag")
    if info.capture:
        dropped.append("the capture viewpoints, without which small pictures are drawn too thick")
    return dropped


def dropped_extras(splats: Splats) -> list[str]:
    """List the extra attributes that a format without extras drops.

    Returns
    -------
    list of str
        One phrase with the first attributes' names, for `warn_dropped`; empty without extras.
    """
    names = list(splats.extras)
    if not names:
        return []
    listed = ", ".join(names[:_MAX_LISTED])
    more = f" and {len(names) - _MAX_LISTED} more" if len(names) > _MAX_LISTED else ""
    return [f"the attributes {listed}{more}"]


def warn_dropped(path: StrPath, format_name: str, dropped: Sequence[str]) -> None:
    """Warn once that a format cannot hold some values; do nothing if `dropped` is empty.

    Parameters
    ----------
    path : path
        The written file, named in the warning.
    format_name : str
        Name of the format in the warning.
    dropped : sequence of str
        Phrases for the dropped values.
    """
    if dropped:
        # Level 3 attributes the warning to the caller of the format's write function.
        warnings.warn(
            f"{os.fspath(path)}: {format_name} cannot hold {', '.join(dropped)}",
            CogsplatWarning,
            stacklevel=3,
        )
