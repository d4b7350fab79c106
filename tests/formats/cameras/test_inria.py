from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import CogsplatError, FormatError, LimitError, StorageError
from cogsplat.formats.cameras.camera_files import read_cameras
from cogsplat.formats.cameras.inria import read_cameras_json, write_cameras_json
from cogsplat.formats.storage.limits import Limits

# A camera that stands at (1, 2, 3) and looks along the world's +x, with the world's z up: its own
# x (right) is the world's -y, its y (down) is -z, its z (forward) is +x.
ENTRY: dict[str, Any] = {
    "id": 0,
    "img_name": "a.png",
    "width": 640,
    "height": 480,
    "position": [1.0, 2.0, 3.0],
    "rotation": [[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]],
    "fx": 500,
    "fy": 510.5,
}


def saved(tmp_path: Path, value: object) -> Path:
    path = tmp_path / "cameras.json"
    path.write_text(value if isinstance(value, str) else json.dumps(value), "utf-8")
    return path


def changed(**keys: object) -> list[dict[str, Any]]:
    """Return a good entry and a second one with these keys; None leaves a key out."""
    second = {**ENTRY, **keys}
    return [ENTRY, {key: value for key, value in second.items() if value is not None}]


def refused(tmp_path: Path, value: object) -> CogsplatError:
    path = saved(tmp_path, value)
    with pytest.raises(CogsplatError) as caught:
        read_cameras(path)
    assert str(path) in caught.value.message
    return caught.value


def cameras(count: int) -> list[Camera]:
    rng = np.random.default_rng(3)
    return [
        Camera(
            width=int(rng.integers(1, 5000)),
            height=int(rng.integers(1, 5000)),
            fx=rng.uniform(1, 2000),
            fy=rng.uniform(1, 2000),
            cx=rng.uniform(-10, 3000),
            cy=rng.uniform(-10, 3000),
            rotation=Rotation.random(random_state=k).as_matrix(),
            translation=rng.normal(scale=10.0 ** rng.integers(-3, 6), size=3),
            name=f"{k} é.png",
        )
        for k in range(count)
    ]


def test_world_to_camera(tmp_path: Path) -> None:
    (camera,) = read_cameras(saved(tmp_path, [ENTRY]))
    np.testing.assert_allclose(camera.position, [1, 2, 3], atol=1e-15)
    # Five ahead, two to the right, one down.
    point = np.array([6.0, 0.0, 2.0])
    np.testing.assert_allclose(camera.rotation @ point + camera.translation, [2, 1, 5])
    assert (camera.width, camera.height, camera.fx, camera.fy) == (640, 480, 500.0, 510.5)
    assert (camera.cx, camera.cy, camera.name) == (320.0, 240.0, "a.png")


def test_optional_keys(tmp_path: Path) -> None:
    entry = {**ENTRY, "cx": 300, "cy": 200.5, "width": 641.0, "extra": {"a": [1]}}
    del entry["img_name"], entry["id"]
    (camera,) = read_cameras(saved(tmp_path, [entry]))
    assert (camera.cx, camera.cy, camera.width, camera.name) == (300.0, 200.5, 641, "")


def test_keeps_the_order_of_the_file(tmp_path: Path) -> None:
    entries = [{**ENTRY, "img_name": name} for name in "cab"]
    assert [camera.name for camera in read_cameras(saved(tmp_path, entries))] == ["c", "a", "b"]


def test_written_cameras_come_back_exactly(tmp_path: Path) -> None:
    expected = cameras(50)
    path = tmp_path / "cameras.json"
    write_cameras_json(expected, path)
    actual = read_cameras(path)
    assert len(actual) == len(expected)
    for a, b in zip(actual, expected, strict=True):
        for name in ("width", "height", "fx", "fy", "cx", "cy", "name"):
            assert getattr(a, name) == getattr(b, name)
        np.testing.assert_array_equal(a.rotation, b.rotation)
        np.testing.assert_array_equal(a.translation, b.translation)
    first = path.read_bytes()
    write_cameras_json(actual, path, force=True)
    assert path.read_bytes() == first


def test_written_cameras_are_what_others_expect(tmp_path: Path) -> None:
    path = tmp_path / "cameras.json"
    write_cameras_json(cameras(2), path)
    for entry, camera in zip(json.loads(path.read_bytes()), cameras(2), strict=True):
        assert set(ENTRY) <= set(entry)
        np.testing.assert_allclose(entry["position"], camera.position)
        np.testing.assert_array_equal(np.array(entry["rotation"]).T, camera.rotation)
        for ours in ("cx", "cy", "translation"):
            del entry[ours]
        (read,) = read_cameras(saved(tmp_path, [entry]))
        np.testing.assert_allclose(read.translation, camera.translation, rtol=1e-12, atol=1e-9)


def test_a_rounded_rotation_comes_back_exactly_too(tmp_path: Path) -> None:
    (camera,) = read_cameras(
        saved(tmp_path, [{**ENTRY, "rotation": np.round(cameras(1)[0].rotation, 4).tolist()}])
    )
    path = tmp_path / "again.json"
    write_cameras_json([camera], path)
    (again,) = read_cameras(path)
    np.testing.assert_array_equal(again.translation, camera.translation)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("[", "Expecting value"),
        ("[1, 2", "no , or ] at byte 5"),
        ("[" * 200_000, "recursion"),
        ("[NaN]", "NaN"),
        ('[{"width": -Infinity}]', "-Infinity"),
        ("[" + "9" * 5000 + "]", "digits"),
    ],
)
def test_text_that_is_no_json(tmp_path: Path, text: str, said: str) -> None:
    error = refused(tmp_path, text)
    assert error.code == "bad-cameras-json"
    assert said in error.message


def test_bytes_that_are_no_text(tmp_path: Path) -> None:
    path = tmp_path / "cameras.json"
    path.write_bytes(b"[\xff\xfe]")
    with pytest.raises(FormatError) as caught:
        read_cameras_json(path)
    assert caught.value.code == "bad-cameras-json"


def test_json_that_is_no_array(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="is an object") as caught:
        read_cameras_json(saved(tmp_path, {"frames": []}))
    assert caught.value.code == "bad-cameras-json"


@pytest.mark.parametrize(
    ("keys", "said"),
    [
        ({"width": None}, "'width'"),
        ({"rotation": None}, "'rotation'"),
        ({"position": None}, "'position'"),
        ({"fx": None}, "'fx'"),
        ({"fy": "500"}, "'fy': is \"500\""),
        ({"fx": True}, "'fx': is true"),
        ({"fx": 10**400}, "'fx'"),
        ({"cx": [1]}, "'cx': is an array of 1"),
        ({"cy": {}}, "'cy': is an object"),
        ({"height": 1.5}, "'height': is 1.5"),
        ({"position": [1, 2]}, "'position': is an array of 2"),
        ({"position": [1, 2, "3"]}, "'position'"),
        ({"position": 7}, "'position': is 7"),
        ({"rotation": [1, 0, 0, 0, 1, 0, 0, 0, 1]}, "'rotation': is an array of 9"),
        ({"rotation": [[1, 0, 0], [0, 1, 0], [0, 1]]}, "'rotation': is an array of 2"),
        ({"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, [1]]]}, "'rotation'"),
        ({"translation": [0, 0, 0]}, "'translation'"),
        ({"img_name": 3}, "'img_name': is 3"),
    ],
)
def test_names_entry_and_key(tmp_path: Path, keys: dict[str, object], said: str) -> None:
    error = refused(tmp_path, changed(**keys))
    assert error.code == "bad-cameras-json"
    assert "entry 1" in error.message
    assert said in error.message
    assert "expected" in error.message


def test_an_entry_that_is_no_object(tmp_path: Path) -> None:
    error = refused(tmp_path, [ENTRY, None])
    assert (error.code, "entry 1: is null" in error.message) == ("bad-cameras-json", True)


@pytest.mark.parametrize(
    "keys",
    [
        {"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 2]]},
        {"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]},
        {"rotation": [[0] * 3] * 3},
        {"rotation": [[1e200] * 3] * 3},
        {"rotation": [[1e300] * 3] * 3, "position": [1e300] * 3},
        {"width": 0},
        {"height": 70_000},
        {"fx": 0},
        {"fy": -5},
    ],
)
def test_cameras_that_are_none(tmp_path: Path, keys: dict[str, object]) -> None:
    error = refused(tmp_path, changed(**keys))
    assert error.code == "bad-camera"
    assert "entry 1" in error.message


@pytest.mark.parametrize("number", ["1e999", "-1e999"])
def test_numbers_beyond_doubles(tmp_path: Path, number: str) -> None:
    text = json.dumps([ENTRY]).replace("510.5", number)
    assert refused(tmp_path, text).code == "bad-cameras-json"


def test_no_cameras(tmp_path: Path) -> None:
    assert refused(tmp_path, []).code == "no-cameras"


def test_limits(tmp_path: Path) -> None:
    path = saved(tmp_path, [ENTRY, ENTRY])
    with pytest.raises(LimitError) as caught:
        read_cameras(path, limits=Limits(cameras=1))
    assert caught.value.code == "too-many-cameras"


@pytest.mark.parametrize(
    ("data", "said"),
    [(b"", "b''"), (b"ply\n", "b'ply")],
)
def test_files_that_hold_no_cameras(tmp_path: Path, data: bytes, said: str) -> None:
    path = tmp_path / "cameras.json"
    path.write_bytes(data)
    with pytest.raises(FormatError) as caught:
        read_cameras(path)
    assert caught.value.code == "unknown-cameras"
    assert said in caught.value.message


def test_a_byte_order_mark(tmp_path: Path) -> None:
    path = tmp_path / "cameras.json"
    path.write_bytes(b"\xef\xbb\xbf\n " + json.dumps([ENTRY]).encode())
    assert len(read_cameras(path)) == 1


def test_storage_failures(tmp_path: Path) -> None:
    with pytest.raises(StorageError) as caught:
        read_cameras(tmp_path / "none.json")
    assert caught.value.code == "not-found"
    write_cameras_json(cameras(1), tmp_path / "a.json")
    with pytest.raises(StorageError) as caught:
        write_cameras_json(cameras(1), tmp_path / "a.json")
    assert caught.value.code == "exists"


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner),
    max_leaves=10,
)


@settings(
    max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.sampled_from([*ENTRY, "cx", "translation"]), json_values)
def test_any_value_of_any_key_reads_or_is_refused(tmp_path: Path, key: str, value: object) -> None:
    try:
        read_cameras(saved(tmp_path, [{**ENTRY, key: value}]))
    except CogsplatError:
        return
