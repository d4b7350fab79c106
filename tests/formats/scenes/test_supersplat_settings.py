"""Settings of the SuperSplat viewer: read into descriptions and written again."""

import json
from pathlib import Path

import numpy as np
import pytest

from cogsplat.codec.errors import CogsplatError, CogsplatWarning
from cogsplat.formats.cogs.description import Description
from cogsplat.formats.scenes.supersplat_settings import (
    is_settings,
    parse_settings,
    write_settings,
)

UP = np.array([0.0, -1.0, 0.0])


def pose(position, target=(0, 0, 0), fov=60):
    return {"position": list(position), "target": list(target), "fov": fov}


def settings(**changes):
    """Return viewer settings of version 2 of SuperSplat, with some changed."""
    track = {
        "name": "fly",
        "duration": 4,
        "frameRate": 30,
        "loopMode": "none",
        "interpolation": "spline",
        "smoothness": 1,
        "keyframes": {
            "times": [30, 90],
            "values": {
                "position": [0, 1, 3, 1, 1, 3],
                "target": [0, 0, 0, 0, 0, 0],
                "fov": [60, 50],
            },
        },
    }
    annotation = {
        "position": [1, 2, 3],
        "title": "<b>Door</b>",
        "text": "t",
        "extras": None,
        "camera": {"initial": pose((0, 1, 3))},
    }
    value = {
        "version": 2,
        "tonemapping": "aces",
        "background": {"color": [0.1, 0.2, 1.5]},
        "cameras": [{"initial": pose((0, 1, 3))}],
        "animTracks": [track],
        "annotations": [annotation],
    }
    return {**value, **changes}


def read(value, axes="RDF", up=UP):
    return parse_settings(value, "settings.json", axes, up)


def test_settings_become_a_description():
    found = read(settings())
    described = found.description
    assert described.background == (0.1, 0.2, 1.0)
    # The viewer turns scenes by 180 degrees about z.
    assert found.first_view.position == pytest.approx([0.0, -1.0, 3.0])
    assert found.first_view.target == pytest.approx([0.0, 0.0, 0.0])
    (annotation,) = described.annotations
    assert annotation.place.tolist() == [-1.0, -2.0, 3.0]
    assert (annotation.title, annotation.text) == ("<b>Door</b>", "t")
    assert annotation.view.position == pytest.approx([0.0, -1.0, 3.0])
    assert [stop.time for stop in described.path.stops] == [0.0, 2.0]
    assert described.path.stops[1].camera.position == pytest.approx([-1.0, -1.0, 3.0])
    assert not described.path.loop


def test_axes_of_the_scene_decide():
    # x left, y up, z front: y and x of the viewer are theirs.
    found = read(settings(), "LUF", np.array([0.0, 1.0, 0.0]))
    assert found.first_view.position == pytest.approx([0.0, 1.0, 3.0])
    assert found.description.annotations[0].place.tolist() == [1.0, 2.0, 3.0]


def test_a_loop_returns_to_its_first_view():
    value = settings()
    value["animTracks"][0]["loopMode"] = "repeat"
    path = read(value).description.path
    assert path.loop
    assert [stop.time for stop in path.stops] == [0.0, 2.0, 4.0]
    assert path.stops[2].camera is path.stops[0].camera


@pytest.mark.parametrize("axes", ["RDF", "LUF", "RUB"])
def test_settings_come_back(tmp_path, axes):
    up = UP if axes == "RDF" else -UP
    first = read(settings(), axes, up)
    out = tmp_path / "settings.json"
    size = write_settings(out, first.description, first.first_view, axes, up)
    assert size == out.stat().st_size
    written = json.loads(out.read_text(encoding="utf-8"))
    assert is_settings(written)
    again = read(written, axes, up)
    for one, other in [
        (first.first_view, again.first_view),
        (first.description.annotations[0].view, again.description.annotations[0].view),
        (first.description.path.stops[1].camera, again.description.path.stops[1].camera),
    ]:
        assert one.rotation == pytest.approx(other.rotation, abs=1e-5)
        assert one.position == pytest.approx(other.position, abs=1e-5)
        assert one.fy == pytest.approx(other.fy, rel=1e-5)
    assert again.description.background == first.description.background
    assert again.description.annotations[0].place == pytest.approx(
        first.description.annotations[0].place
    )


def test_what_settings_cannot_hold_is_named(tmp_path):
    with pytest.warns(CogsplatWarning, match="without title, licence"):
        write_settings(
            tmp_path / "s.json", Description(title="Garden", licence="CC0-1.0"), None, "RDF", UP
        )
    with pytest.raises(CogsplatError) as caught:
        write_settings(tmp_path / "s.json", Description(), None, "RDF", UP)
    assert caught.value.code == "exists"


@pytest.mark.parametrize(
    "changes",
    [
        {"version": 1},
        {"background": {"color": [1, 2]}},
        {"cameras": [{"initial": pose((0, 0, 0))}]},
        {"cameras": [{"initial": pose((0, 0, 1), fov=180)}]},
        {"cameras": {}},
        {"annotations": [{"position": [0, 0, 0]}]},
        {"animTracks": [{**settings()["animTracks"][0], "frameRate": 0}]},
        {"animTracks": [{"keyframes": {"times": [1, 0], "values": {}}}]},
    ],
)
def test_other_settings_are_refused(changes):
    with pytest.raises(CogsplatError) as caught:
        read(settings(**changes))
    assert caught.value.code in ("bad-settings-file", "bad-view-text")
    assert "settings.json" in caught.value.message or caught.value.code == "bad-view-text"


CASES = json.loads(
    (Path(__file__).resolve().parents[3] / "tools/web/test/supersplat_cases.json").read_text(
        "utf-8"
    )
)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case["name"])
def test_settings_mean_what_they_mean_in_the_viewer(case):
    found = read(case["settings"], case["axes"], np.array(case["up"], dtype=float))
    expected, described = case["expected"], found.description
    assert described.background == tuple(expected["background"])
    assert (found.first_view is None) == (expected["start"] is None)
    if found.first_view is not None:
        assert found.first_view.position == pytest.approx(expected["start"]["position"])
        assert found.first_view.target == pytest.approx(expected["start"]["target"])
    path = described.path
    assert (None if path is None else path.loop) == expected["loop"]
    stops = [] if path is None else path.stops
    assert [stop.time for stop in stops] == [stop["time"] for stop in expected["stops"]]
    for stop, wanted in zip(stops, expected["stops"], strict=True):
        assert stop.camera.position == pytest.approx(wanted["position"])
    places = [one.place.tolist() for one in described.annotations]
    assert places == expected["places"]
    assert [one.title for one in described.annotations] == expected["titles"]
