"""A few cameras stand for all of a room, and not for all of a long street."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.capture import capture_of_cameras
from cogsplat.codec.encode.config import EncodeConfig
from cogsplat.codec.splats import Splats
from cogsplat.codec.views.capture_choice import choose_capture
from cogsplat.tools.lab.synthetic.terrace import synth, synth_cameras

CAMERAS = 66


def street(step: float) -> tuple[Splats, list[Camera]]:
    """Return parts of a scene side by side, each with one camera at the same place in it."""
    splats, camera = synth(40, sh_degree=0), synth_cameras(1, 40, 30)[0]
    shifts = np.arange(CAMERAS)[:, None] * np.array([step, 0.0, 0.0])
    means = np.concatenate([splats.means + shift.astype(np.float32) for shift in shifts])
    cameras = [
        replace(camera, translation=camera.translation - camera.rotation @ shift)
        for shift in shifts
    ]
    return replace(splats.take(np.tile(np.arange(40), CAMERAS)), means=means), cameras


def test_close_cameras_stand_for_each_other() -> None:
    splats, cameras = street(0.01)
    assert choose_capture(splats, cameras) == capture_of_cameras(cameras)
    assert len(choose_capture(splats, cameras)) == 32


@pytest.mark.parametrize("count", [CAMERAS, 33])
def test_distant_cameras_do_not(count: int) -> None:
    splats, cameras = street(100.0)
    assert choose_capture(splats, cameras[:count]) == ()
    # All of a few cameras are stored.
    assert len(choose_capture(splats, cameras[:32])) == 32


def test_scenes_without_splats_or_cameras() -> None:
    splats, cameras = street(100.0)
    assert len(choose_capture(splats.take(np.zeros(0, np.int64)), cameras)) == 32
    assert choose_capture(splats, []) == ()


def test_a_file_of_a_street_is_drawn_as_usual(tmp_path: Path) -> None:
    config = EncodeConfig(compensate=False, order="contribution", threads=1)
    for step, count in ((0.01, 32), (100.0, 0)):
        splats, cameras = street(step)
        out = tmp_path / f"{count}.cogs"
        cogsplat.encode(splats, out, cameras=cameras, config=config, preset="fast")
        assert len(cogsplat.decode(out).info.capture) == count
