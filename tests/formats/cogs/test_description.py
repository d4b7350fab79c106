"""Descriptions: bytes and JSON forth and back, and what is refused of either."""

import io
import json
from dataclasses import replace
from pathlib import Path

import msgpack
import numpy as np
import pytest
from pictures import picture
from PIL import Image

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import CogsplatError, DataError, FormatError, LimitError
from cogsplat.codec.geometry.transforms import transform
from cogsplat.formats.cogs.description import (
    Annotation,
    CameraPath,
    Description,
    Georeference,
    PathStop,
    Picture,
)
from cogsplat.formats.cogs.description_json import (
    from_json,
    read_description,
    read_picture_file,
    to_json,
)
from cogsplat.formats.cogs.description_segment import (
    check_picture,
    pack_description,
    pack_segments,
    unpack_description,
)
from cogsplat.formats.cogs.moved_description import move_description
from cogsplat.formats.cogs.picture_header import picture_header


def camera(name="Door", target=(0.0, 0.0, 3.0)):
    """Return a view with a target."""
    return Camera(
        640, 480, 500.0, 501.0, 320.0, 240.0, np.eye(3), np.array([0.0, 0.0, 4.0]), name,
        None if target is None else np.array(target),
    )  # fmt: skip


def whole():
    """Return a description with every key."""
    return Description(
        title="Jardín 🌳",
        text="two\n\tlines",
        licence="CC-BY-4.0",
        credits="The maintainers",
        date="2026-05-31T10:20:30.5+02:00",
        metres_per_unit=0.25,
        unit="ft",
        background=(0.0, 0.5, 1.0),
        views=(camera(), camera("", None)),
        path=CameraPath((PathStop(0.0, camera()), PathStop(2.5, camera())), loop=True),
        annotations=(
            Annotation(np.array([1.0, 2.0, 3.0]), "Door", "Built 1904.", camera()),
            Annotation(np.zeros(3), "Tree"),
        ),
        georeference=Georeference("EPSG:4978", np.diag([2.0, 2.0, 2.0, 1.0])),
        poster=Picture("image/jpeg", 6, 3, data=picture()),
        sky=Picture("image/webp", 6, 3, rotation=np.eye(3), data=picture("WEBP")),
    )


def code_of(call):
    with pytest.raises(CogsplatError) as caught:
        call()
    return caught.value.code


def test_a_description_comes_back():
    payload = pack_description(whole())
    found = unpack_description(payload, "here")
    assert to_json(found) == to_json(whole())
    assert pack_description(found) == payload
    assert found.views[0].name == "Door"
    assert found.views[0].target.tolist() == [0.0, 0.0, 3.0]
    assert found.poster.data is None


def test_an_empty_description_takes_no_segment():
    assert Description().is_empty
    assert pack_segments(Description()) == pack_segments(None) == []
    assert not Description(title="").is_empty


@pytest.mark.parametrize(
    "changes",
    [
        {"title": "x" * 256},
        {"text": "\x1b[31m"},
        {"text": "one\rtwo"},
        {"date": "31 May"},
        {"unit": "yd"},
        {"metres_per_unit": float("inf")},
        {"background": (0.0, 0.0, 1.5)},
        {"views": (camera("x" * 256),)},
        {"path": CameraPath((PathStop(0.0, camera()),))},
        {"path": CameraPath((PathStop(0.0, camera()), PathStop(0.0, camera())))},
        {"georeference": Georeference("EPSG:4978", np.zeros((4, 4)))},
        {"poster": Picture("image/png", 6, 3)},
        {"sky": Picture("image/webp", 6, 6)},
    ],
    ids=lambda changes: next(iter(changes)),
)
def test_what_readers_refuse_is_not_written(changes):
    assert code_of(lambda: pack_description(replace(whole(), **changes))) == "bad-description"


def test_pictures_are_checked_before_they_are_written():
    entry = Picture("image/jpeg", 6, 3)
    for wrong in (None, picture(size=(7, 3)), picture("WEBP"), picture()[:-1], b""):
        described = Description(poster=replace(entry, data=wrong))
        assert code_of(lambda described=described: pack_segments(described)) == "bad-description"


def test_ten_megabytes_of_text_are_refused():
    huge = "x" * 10_000_000
    assert code_of(lambda: pack_description(Description(text=huge))) == "bad-description"
    assert code_of(lambda: unpack_description(msgpack.packb({"text": huge}), "")) == "root-value"


def test_values_count_against_the_limit():
    payload = pack_description(whole())
    assert code_of(lambda: unpack_description(payload, "here", 1000)) == "decoded-size"
    with pytest.raises(LimitError):
        unpack_description(payload, "here", 1000)


def test_markup_stays_as_it_is():
    text = '<img src=x onerror="alert(1)"> & </script>'
    found = unpack_description(pack_description(Description(title=text)), "here")
    assert found.title == text


@pytest.mark.parametrize(
    "data",
    [
        picture(),
        picture(size=(300, 200)),
        picture(progressive=True),
        picture("WEBP"),
        picture("WEBP", lossless=True),
        picture("WEBP", exif=b"Exif\0\0" + bytes(40)),
    ],
    ids=["jpeg", "large", "progressive", "lossy", "lossless", "extended"],
)
def test_headers_say_what_pillow_says_and_no_prefix_passes(data):
    with Image.open(io.BytesIO(data)) as image:
        expected = (f"image/{image.format.lower()}", *image.size)
    assert picture_header(data, "here") == expected
    for length in range(len(data)):
        assert code_of(lambda length=length: picture_header(data[:length], "")) == "picture-header"
    check_picture(Picture(*expected), data, "here")
    other = Picture(expected[0], expected[1] + 1, expected[2])
    assert code_of(lambda: check_picture(other, data, "here")) == "picture-header"


def test_animations_and_other_formats_are_refused():
    frames = [Image.new("RGB", (4, 2), (i, 0, 0)) for i in (0, 200)]
    moving = io.BytesIO()
    frames[0].save(moving, "WEBP", save_all=True, append_images=frames[1:])
    cmyk = io.BytesIO()
    Image.new("CMYK", (4, 2)).save(cmyk, "JPEG")
    for data in (moving.getvalue(), cmyk.getvalue(), picture("PNG"), b"<svg/>"):
        assert code_of(lambda data=data: picture_header(data, "here")) == "picture-header"


def write(path: Path, value: object) -> Path:
    path.write_text(json.dumps(value), encoding="utf-8")
    return path


def test_json_comes_back_with_pictures_as_files(tmp_path):
    (tmp_path / "p.jpg").write_bytes(picture())
    (tmp_path / "s.webp").write_bytes(picture("WEBP"))
    value = to_json(whole())
    value["poster"] = "p.jpg"
    value["sky"] = {"file": "s.webp", "rotation": value["sky"]["rotation"]}
    found = read_description(write(tmp_path / "d.json", value))
    assert to_json(found) == to_json(whole())
    assert (found.poster.data, found.sky.data) == (picture(), picture("WEBP"))


def test_json_may_have_whole_numbers_and_other_line_ends(tmp_path):
    value = {"metres_per_unit": 1, "background": [0, 1, 0], "text": "one\r\ntwo"}
    found = read_description(write(tmp_path / "d.json", value))
    assert (found.metres_per_unit, found.background) == (1.0, (0.0, 1.0, 0.0))
    assert found.text == "one\ntwo"


@pytest.mark.parametrize(
    "value",
    [
        {"titel": "Garden"},
        {"annotations": [{"place": [0, 0, 0], "title": "", "text": "", "colour": 1}]},
        {"title": 1},
        {"title": None},
        {"views": {}},
        {"metres_per_unit": 10**400},
        {"poster": {"file": 3}},
        {"poster": {"type": "image/jpeg", "width": 1.5, "height": 2}},
        {"background": [[[[[[[[[[0]]]]]]]]]]},
        [],
    ],
)
def test_json_that_is_no_description_is_refused(tmp_path, value):
    path = write(tmp_path / "d.json", value)
    assert code_of(lambda: read_description(path)) == "bad-description-file"


def test_pictures_that_are_none_are_refused(tmp_path):
    (tmp_path / "p.jpg").write_bytes(picture("PNG"))
    assert code_of(lambda: read_picture_file(tmp_path / "p.jpg")) == "bad-description"
    assert code_of(lambda: read_picture_file(tmp_path / "none.jpg")) == "not-found"
    with pytest.raises(DataError):
        from_json({"poster": "p.jpg"}, tmp_path / "d.json")
    with pytest.raises(FormatError):
        from_json({"sky": {"file": 1}}, tmp_path / "d.json")


def test_a_moved_description_shows_the_same(random_scene):
    turn = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    shift, scale = (1.0, -2.0, 3.0), 2.0
    scene = replace(random_scene, info=replace(random_scene.info, origin=(10.0, 20.0, 30.0)))
    moved = transform(scene, scale, turn, shift)
    before, after = whole(), move_description(whole(), "RDF", scale, turn, shift)

    def seen(view, point):
        at = view.rotation @ point + view.translation
        return at[:2] / at[2]

    def world(splats, row):
        return splats.means[row].astype(np.float64) + np.array(splats.info.origin)

    for row in range(3):
        old, new = scene.means[row].astype(float), moved.means[row].astype(float)
        for first, second in [
            (before.views[0], after.views[0]),
            (before.path.stops[1].camera, after.path.stops[1].camera),
            (before.annotations[0].view, after.annotations[0].view),
        ]:
            assert seen(first, old) == pytest.approx(seen(second, new), rel=1e-5)
        on_earth = [
            given.georeference.transform @ [*world(splats, row), 1.0]
            for given, splats in ((before, scene), (after, moved))
        ]
        assert on_earth[0] == pytest.approx(on_earth[1], rel=1e-5)
    assert after.metres_per_unit == 0.125
    assert after.annotations[0].place == pytest.approx(scale * turn @ [1, 2, 3] + shift)
    assert after.views[0].target == pytest.approx(scale * turn @ [0, 0, 3] + shift)
    # The sky shows the same in a direction that turned with the scene.
    assert after.sky.rotation @ turn @ [1, 2, 3] == pytest.approx([1, 2, 3])
    pack_description(after)


def test_a_sky_without_rotation_follows_the_axes():
    plain = Description(sky=Picture("image/webp", 6, 3))
    turn = np.diag([-1.0, 1.0, -1.0])
    after = move_description(plain, "LUF", 1.0, turn, (0.0, 0.0, 0.0))
    # x left, y up, z front: the front of the sky turns to the back.
    assert (after.sky.rotation @ [0.0, 0.0, -1.0]).tolist() == [0.0, 0.0, 1.0]
    assert (after.sky.rotation @ [0.0, 1.0, 0.0]).tolist() == [0.0, -1.0, 0.0]
    still = move_description(plain, "LUF", 2.0, None, (1.0, 0.0, 0.0))
    assert still.sky.rotation is None
    with pytest.warns(UserWarning, match="the sky is left out"):
        assert move_description(plain, "RUF", 1.0, turn, (0.0, 0.0, 0.0)).sky is None


@pytest.fixture
def random_scene():
    from random_splats import random_splats

    return random_splats(3, 0)
