import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cogsplat.codec.errors import DataError
from cogsplat.codec.views.view_text import parse_up, parse_view, unit_up, view_text

# The tests of the viewer read the same table.
TABLE = json.loads((Path(__file__).parents[2] / "view_text.json").read_text("utf-8"))


@pytest.mark.parametrize("case", TABLE["poses"], ids=lambda case: case["text"])
def test_poses_are_read_and_written(case):
    view, up = parse_view(case["text"]), parse_up(case["up"])
    assert [*view.position, *view.target] == [*case["position"], *case["target"]]
    assert (view.fov_deg, view.roll_deg) == (case["fov"], case["roll"])
    camera = view.camera(up, 640, 480)
    np.testing.assert_allclose(camera.rotation.ravel(), case["rotation"], atol=1e-11)
    np.testing.assert_allclose(camera.position, case["position"], atol=1e-9)
    assert view_text(camera, up) == case["written"]
    # The target is in the middle of the picture, whose height is the field of view.
    seen = camera.rotation @ np.array(case["target"]) + camera.translation
    np.testing.assert_allclose(seen[:2] / seen[2], 0, atol=1e-9)
    assert np.degrees(2 * np.arctan(240 / camera.fy)) == pytest.approx(case["fov"])
    assert np.degrees(2 * np.arctan(240 / camera.fx)) == pytest.approx(case["fov"])


@pytest.mark.parametrize("text", TABLE["refused"])
def test_other_texts_are_no_poses(text):
    with pytest.raises(DataError, match="expected") as caught:
        parse_view(text)
    assert caught.value.code == "bad-view-text"


@pytest.mark.parametrize("case", TABLE["ups"], ids=lambda case: case["text"])
def test_up_is_read(case):
    np.testing.assert_allclose(parse_up(case["text"]), case["up"], atol=1e-12)


@pytest.mark.parametrize("text", TABLE["refused_ups"])
def test_other_texts_are_no_up(text):
    with pytest.raises(DataError, match="expected") as caught:
        parse_up(text)
    assert caught.value.code == "bad-view-text"


@pytest.mark.parametrize("up", [[0, 0], [0, 0, 0], [0, np.nan, 1], [[0, 0, 1]]])
def test_arrays_that_are_no_up_are_refused(up):
    with pytest.raises(DataError, match="expected") as caught:
        unit_up(up)
    assert caught.value.code == "bad-view-text"
    assert unit_up((0, 0, -3)).tolist() == [0, 0, -1]


def test_the_target_of_a_text_lies_ahead_at_the_depth_of_the_camera_s():
    camera = parse_view("1,2,3,4,5,6,50").camera(parse_up("+z"))
    aside = camera.position + 2.0 * camera.rotation[2] + 0.5 * camera.rotation[0]
    found = parse_view(view_text(camera, parse_up("+z"), aside))
    np.testing.assert_allclose(found.target, camera.position + 2.0 * camera.rotation[2], atol=1e-6)
    with pytest.raises(ValueError, match="without a target"):
        view_text(replace(camera, target=None), parse_up("+z"))


def test_rounding_errors_of_a_pose_are_no_coordinates():
    up = parse_up("-y")
    camera = parse_view("0,0,-4,0,0,0,45").camera(up)
    moved = replace(camera, translation=camera.translation + np.array([5e-17, -2e-16, 0.0]))
    assert view_text(moved, up) == "0,0,-4,0,0,0,45"
    near = replace(camera, translation=camera.translation + np.array([-1e-9, 0.0, 0.0]))
    assert view_text(near, up).startswith("0.000000001,0,-4,")
