"""`SceneInfo` as PLY comments: our own keys, and a foreign comment for anti-aliasing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Final

import numpy as np

from cogsplat.codec.capture import MAX_VIEWPOINTS
from cogsplat.codec.errors import DataError, FormatError
from cogsplat.codec.splats import SceneInfo

_COMMENT = "cogsplat"
_LARGEST: Final = float(np.finfo(np.float32).max)
_AXES = ({"R", "L"}, {"U", "D"}, {"F", "B"})

# Comment of Brush, gsplat and splat-transform in scenes trained with Mip-Splatting's filter.
_MIP_COMMENT: Final = "SplatRenderMode: mip"


def scene_comments(info: SceneInfo) -> list[str]:
    """Return one PLY comment for each value that differs from a default `SceneInfo`.

    Anti-aliasing gets two comments: our own key, and ``SplatRenderMode: mip`` for other programs.

    Raises
    ------
    DataError
        ``bad-scene-info``: `parse_scene_info` would reject a value.
    """
    default = SceneInfo()
    comments = []
    if info.origin != default.origin:
        comments.append(f"{_COMMENT} origin {' '.join(repr(float(v)) for v in info.origin)}")
    if info.axes != default.axes:
        comments.append(f"{_COMMENT} axes {info.axes}")
    if info.colour_space != default.colour_space:
        comments.append(f"{_COMMENT} colour_space {info.colour_space}")
    if info.kernel_px != default.kernel_px:
        comments.append(f"{_COMMENT} kernel_px {float(info.kernel_px)!r}")
    if info.antialiased != default.antialiased:
        comments.append(f"{_COMMENT} antialiased {str(bool(info.antialiased)).lower()}")
        comments.append(_MIP_COMMENT)
    comments += [
        f"{_COMMENT} capture {' '.join(repr(float(number)) for number in viewpoint)}"
        for viewpoint in info.capture
    ]
    try:
        parse_scene_info(comments, "scene info")
    except FormatError as error:
        raise DataError("bad-scene-info", error.message) from error
    return comments


def parse_scene_info(comments: Sequence[str], where: str) -> SceneInfo:
    """Parse the `SceneInfo` of a PLY's comments.

    Comments ``cogsplat KEY VALUE`` set the values; unknown keys are skipped. A comment
    ``SplatRenderMode: mip`` also marks the scene as anti-aliased.

    Parameters
    ----------
    comments : sequence of str
        Text of each comment, without the word ``comment``.
    where : str
        Name of the file for messages.

    Raises
    ------
    FormatError
        ``ply-bad-comment``: a known key has an invalid value.
    """
    default = SceneInfo()
    origin, axes, colour_space = default.origin, default.axes, default.colour_space
    kernel_px, antialiased, marked = default.kernel_px, default.antialiased, False
    capture: list[tuple[float, float, float, float]] = []
    for comment in comments:
        match comment.split(" "):
            case ["cogsplat", "origin", x, y, z] if _finite(x, y, z):
                origin = (float(x), float(y), float(z))
            case ["cogsplat", "axes", name] if _is_axes(name):
                axes = name
            case ["cogsplat", "colour_space", ("srgb" | "linear") as name]:
                colour_space = name
            case ["cogsplat", "kernel_px", value] if _finite(value) and float(value) >= 0:
                kernel_px = float(value)
            case ["cogsplat", "antialiased", ("true" | "false") as value]:
                antialiased = value == "true"
            case ["cogsplat", "capture", x, y, z, focal] if (
                _is_viewpoint(x, y, z, focal) and len(capture) < MAX_VIEWPOINTS
            ):
                capture.append((float(x), float(y), float(z), float(focal)))
            case _ if comment.strip() == _MIP_COMMENT:
                marked = True
            case [
                "cogsplat",
                (
                    "origin" | "axes" | "colour_space" | "kernel_px" | "antialiased" | "capture"
                ) as key,
                *_,
            ]:
                raise FormatError(
                    "ply-bad-comment",
                    f"{where}: {comment[:80]!r}, expected a valid value of {key}",
                )
    return SceneInfo(origin, axes, colour_space, kernel_px, antialiased or marked, tuple(capture))


def _finite(*words: str) -> bool:
    """Return whether all words are finite numbers."""
    try:
        return all(math.isfinite(float(word)) for word in words)
    except ValueError:
        return False


def _is_viewpoint(x: str, y: str, z: str, focal: str) -> bool:
    """Return whether words are a position and a focal length above 0, all finite as float32."""
    words = (x, y, z, focal)
    if not (_finite(*words) and max(abs(float(word)) for word in words) <= _LARGEST):
        return False
    return bool(np.float32(focal) > 0)


def _is_axes(name: str) -> bool:
    """Return whether a name has one letter for each of right/left, up/down, front/back."""
    return len(name) == 3 and all(len(pair & set(name)) == 1 for pair in _AXES)
