"""Sets of given cameras: held out, left out, sampled, or reduced in size."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, TypeVar

from cogsplat.codec.cameras import Camera

from .low_discrepancy import STEP_1D

TEST_VIEWS: Final = 24
"""Test views at most, of planned and of given views."""

CLOSE_VIEWS: Final = 8
"""Close views at most in which quality is measured."""

CLOSE_SHARE: Final = 0.4
"""Distance of a close view from what it shows, as a share of the distance of its test view."""

_LEFT_OUT_EVERY: Final = 8
"""Interval of the cameras left out to measure quality in, as in Mip-NeRF 360."""

_FEW_CAMERAS: Final = range(16, 40)
"""Numbers of cameras of which every fourth is left out: a mean over three views is off by 2 dB.

Of 18 cameras around a made statue, every eighth showed 3.8 dB more than six further cameras, and
every fourth 2.4 dB more. Of 17 in a captured room, every eighth showed 1.8 dB less than 17 further
ones, and every fourth 0.7 dB less. Of fewer than 16, scoring needs the others.
"""

_LEAST_CAMERAS: Final = 9
"""Number of cameras below which none is left out."""

Item = TypeVar("Item")


def sample_evenly(cameras: Sequence[Item], count: int) -> list[Item]:
    """Choose cameras at about equal distances in a sequence, such as the order of capture.

    The sequence is cut into `count` stretches of about equal length, and one camera is taken from
    each: not always the first, but by a fixed low-discrepancy sequence. Where left and right views
    alternate, the first of each stretch could all be left ones.

    Parameters
    ----------
    cameras : sequence
        Cameras or camera numbers.
    count : int
        Number of cameras wanted, at least 1. A sequence that is not longer is returned whole.

    Returns
    -------
    list
        Different items of the sequence, in its order.
    """
    if len(cameras) <= count:
        return list(cameras)
    run = len(cameras) / count
    rows: list[int] = []
    for k in range(count):
        row = int((k + (k + 0.5) * STEP_1D % 1.0) * run)
        # Stretches of less than two cameras share some: none is taken twice.
        rows.append(max(row, rows[-1] + 1) if rows else row)
    return [cameras[row] for row in rows]


def at_width(cameras: Sequence[Camera], width: int | None) -> list[Camera]:
    """Return cameras whose pictures all have one width.

    Parameters
    ----------
    cameras : sequence of Camera
        Cameras of pictures of any size.
    width : int or None
        Width of the new pictures, px; each keeps what it shows. None keeps all sizes.

    Examples
    --------
    >>> import cogsplat
    >>> from cogsplat.codec.views.view_sets import at_width
    >>> {camera.width for camera in at_width(cogsplat.read_cameras("cameras.json"), 32)}
    {32}
    """
    if width is None:
        return list(cameras)
    return [camera.resized(width) for camera in cameras]


def hold_out(cameras: Sequence[Camera], every: int) -> tuple[list[Camera], list[Camera]]:
    """Split cameras into training views and held-out test views, as Mip-NeRF 360 does.

    Parameters
    ----------
    cameras : sequence of Camera
        Cameras in file order.
    every : int
        Cameras with ``index % every == 0`` are held out; 0 holds out none.

    Returns
    -------
    train, held : list of Camera

    Raises
    ------
    ValueError
        A negative `every`.

    Examples
    --------
    >>> from cogsplat.codec.views.view_sets import hold_out
    >>> hold_out(["a", "b", "c", "d", "e"], 2)
    (['b', 'd'], ['a', 'c', 'e'])
    """
    if every < 0:
        raise ValueError(f"every {every}, expected 0 (none) or more")
    if every == 0:
        return list(cameras), []
    train = [camera for index, camera in enumerate(cameras) if index % every]
    return train, list(cameras[::every])


def left_out_every(count: int) -> int:
    """Return the interval of the cameras that `leave_out` leaves out of `count`; 0 for none."""
    if count < _LEAST_CAMERAS:
        return 0
    return _LEFT_OUT_EVERY // 2 if count in _FEW_CAMERAS else _LEFT_OUT_EVERY


def leave_out(cameras: Sequence[Camera]) -> tuple[list[Camera], list[Camera]]:
    """Split given cameras into views to encode or train with and views to measure quality in.

    PSNR in scored or trained views overstates the PSNR in other views: by 0.5 dB with 43 cameras in
    one captured room, and by 10 dB with 18 cameras in two rooms.

    Parameters
    ----------
    cameras : sequence of Camera
        Cameras in file order.

    Returns
    -------
    used, left_out : list of Camera
        Every eighth camera is left out, as `hold_out` does; every fourth of 16 to 39; none of fewer
        than nine.
    """
    return hold_out(cameras, left_out_every(len(cameras)))
