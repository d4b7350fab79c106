from dataclasses import replace

import oracle
import pytest

from cogsplat.codec.views.view_sets import hold_out, leave_out


def _named(count):
    return [replace(oracle.camera(angle=0.3 * k), name=str(k)) for k in range(count)]


def test_every_eighth_camera_is_held_out():
    train, held = hold_out(_named(50), 8)
    assert [camera.name for camera in held] == ["0", "8", "16", "24", "32", "40", "48"]
    assert len(train) == 43
    assert not {camera.name for camera in train} & {camera.name for camera in held}


def test_zero_holds_out_none_and_one_holds_out_all():
    cameras = _named(3)
    assert hold_out(cameras, 0) == (cameras, [])
    assert hold_out(cameras, 1) == ([], cameras)
    with pytest.raises(ValueError, match="expected 0"):
        hold_out(cameras, -1)


def test_every_eighth_camera_is_left_out_and_every_fourth_of_16_to_39():
    used, left_out = leave_out(list(range(40)))
    assert left_out == [0, 8, 16, 24, 32]
    assert sorted([*used, *left_out]) == list(range(40))
    assert leave_out(list(range(39)))[1] == list(range(0, 39, 4))
    assert leave_out(list(range(16)))[1] == [0, 4, 8, 12]
    assert leave_out(list(range(15)))[1] == leave_out(list(range(9)))[1] == [0, 8]
    assert leave_out(list(range(8))) == (list(range(8)), [])
    assert leave_out([]) == ([], [])
