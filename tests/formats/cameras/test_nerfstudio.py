from __future__ import annotations

import contextlib
import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image
from scipy.spatial.transform import Rotation

from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import (
    CogsplatError,
    CogsplatWarning,
    DataError,
    FormatError,
    LimitError,
    UnsupportedError,
)
from cogsplat.formats.cameras.camera_files import read_cameras
from cogsplat.formats.cameras.colmap import find_model, read_colmap
from cogsplat.formats.cameras.nerfstudio import read_transforms
from cogsplat.formats.storage.images import picture_size
from cogsplat.formats.storage.limits import Limits

Json = dict[str, Any]
SHARED = Path(__file__).parents[4] / "shared" / "data"
needs_shared = pytest.mark.skipif(not SHARED.is_dir(), reason="the real scenes are not here")

# A camera at (1, 2, 3) that looks along the world's +x, with the world's z up. OpenGL's camera has
# x right (the world's -y), y up (z), z backwards (-x): the columns.
POSE = [[0.0, 0.0, -1.0, 1.0], [-1.0, 0.0, 0.0, 2.0], [0.0, 1.0, 0.0, 3.0], [0.0, 0.0, 0.0, 1.0]]
INTRINSICS: Json = {"w": 640, "h": 480, "fl_x": 500, "fl_y": 510.5, "cx": 321, "cy": 239.5}
# As ns-process-data writes it: COLMAP's y and z change places, and one sign.
APPLIED = [[1.0, 0, 0, 0], [0, 0, 1.0, 0], [0, -1.0, 0, 0]]


def saved(tmp_path: Path, value: object) -> Path:
    path = tmp_path / "transforms.json"
    path.write_text(value if isinstance(value, str) else json.dumps(value), "utf-8")
    return path


def document(*frames: Json, **keys: object) -> Json:
    frames = frames or ({"file_path": "images/a.png", "transform_matrix": POSE},)
    return {**INTRINSICS, **keys, "frames": list(frames)}


def refused(tmp_path: Path, value: object) -> CogsplatError:
    path = saved(tmp_path, value)
    with pytest.raises(CogsplatError) as caught:
        read_transforms(path)
    assert str(path) in caught.value.message
    assert "expected" in caught.value.message
    return caught.value


def assert_same(actual: list[Camera], expected: list[Camera], atol: float = 1e-9) -> None:
    assert len(actual) == len(expected)
    for a, b in zip(actual, expected, strict=True):
        np.testing.assert_allclose(a.rotation, b.rotation, atol=atol)
        np.testing.assert_allclose(a.translation, b.translation, atol=atol)
        for name in ("width", "height", "fx", "fy", "cx", "cy"):
            assert getattr(a, name) == pytest.approx(getattr(b, name)), name


def test_world_to_camera(tmp_path: Path) -> None:
    (camera,) = read_cameras(saved(tmp_path, document()))
    np.testing.assert_allclose(camera.position, [1, 2, 3], atol=1e-15)
    # Five ahead, two to the right, one down.
    point = np.array([6.0, 0.0, 2.0])
    np.testing.assert_allclose(camera.rotation @ point + camera.translation, [2, 1, 5])
    assert (camera.width, camera.height, camera.fx, camera.fy) == (640, 480, 500.0, 510.5)
    assert (camera.cx, camera.cy, camera.name) == (321.0, 239.5, "images/a.png")


def test_intrinsics_of_frames_go_first(tmp_path: Path) -> None:
    own = {"transform_matrix": POSE[:3], "w": 100, "h": 50.0, "fl_x": 9, "cx": 1, "cy": 2}
    first, second = read_cameras(saved(tmp_path, document(own, {"transform_matrix": POSE})))
    assert (first.width, first.height, first.fx, first.fy) == (100, 50, 9.0, 510.5)
    assert (first.cx, first.cy, first.name) == (1.0, 2.0, "")
    assert (second.width, second.fx) == (640, 500.0)


def test_angles_and_default_values(tmp_path: Path) -> None:
    frame = {"transform_matrix": POSE}
    angle = {"w": 800, "h": 600, "camera_angle_x": 0.6911112070083618}
    (camera,) = read_transforms(saved(tmp_path, {**angle, "frames": [frame]}))
    # The NeRF synthetic scenes' known focal length at 800 pixels.
    assert camera.fx == pytest.approx(1111.1110311937682)
    assert camera.fy == camera.fx
    assert (camera.cx, camera.cy) == (400.0, 300.0)
    both = {**angle, "camera_angle_y": math.pi / 2, "frames": [{**frame, "fl_x": 77}]}
    (camera,) = read_transforms(saved(tmp_path, both))
    assert (camera.fx, camera.fy) == (77.0, pytest.approx(300.0))


def picture(kind: str, width: int, height: int) -> bytes:
    out = io.BytesIO()
    exif = Image.Exif()
    exif[0x010E] = "x" * 3000
    options = {"exif": exif} if kind == "JPEG" else {}
    Image.new("RGB", (width, height)).save(out, kind, **options)
    return out.getvalue()


def test_sizes_come_from_images(tmp_path: Path) -> None:
    (tmp_path / "train").mkdir()
    (tmp_path / "train" / "r_0.png").write_bytes(picture("PNG", 80, 60))
    (tmp_path / "train" / "r_1.jpg").write_bytes(picture("JPEG", 81, 61))
    frames = [
        {"file_path": name, "transform_matrix": POSE}
        for name in ("./train/r_0", "train/r_0.png", "./train/r_1")
    ]
    value = {"camera_angle_x": 1.0, "frames": frames}
    (tmp_path / "transforms_train.json").write_text(json.dumps(value))
    cameras = read_cameras(tmp_path)
    assert [(c.width, c.height) for c in cameras] == [(80, 60), (80, 60), (81, 61)]
    assert cameras[2].fx == pytest.approx(40.5 / math.tan(0.5))
    cases = ("none", "../train/r_0", "/etc/hostname", "train", "", "a\0b")
    for name in cases:
        value["frames"] = [{"file_path": name, "transform_matrix": POSE}]
        assert refused(tmp_path, value).code == "bad-transforms-json"
    (tmp_path / "other.png").write_bytes(b"GIF89a")
    value["frames"] = [{"file_path": "other.png", "transform_matrix": POSE}]
    assert refused(tmp_path, value).code == "bad-transforms-json"


def test_sizes_of_pictures() -> None:
    for kind in ("PNG", "JPEG"):
        data = picture(kind, 37, 21)
        assert picture_size(data) == (37, 21)
        cut = [picture_size(data[:length]) for length in range(40)]
        assert set(cut) <= {None, (37, 21)}
    assert picture_size(b"") is None
    assert picture_size(b"\xff\xd8\xff\xe0\x00\x00" * 9) is None


def test_a_colmap_folder_goes_before_the_json_in_it(tmp_path: Path) -> None:
    saved(tmp_path, document())
    assert len(read_cameras(tmp_path)) == 1
    (tmp_path / "sparse" / "0").mkdir(parents=True)
    for name in ("cameras.txt", "images.txt"):
        (tmp_path / "sparse" / "0" / name).write_text("# nothing\n")
    with pytest.raises(CogsplatError):
        read_cameras(tmp_path)


def applied(camera: Camera, matrix: np.ndarray, scale: float) -> Json:
    """Write a camera as ns-process-data does: OpenGL's axes, then the world moved."""
    pose = np.eye(4)
    pose[:3, :3] = camera.rotation.T @ np.diag([1, -1, -1])
    pose[:3, 3] = camera.position
    whole = np.eye(4)
    whole[:3] = matrix
    pose = whole @ pose
    pose[:3, 3] *= scale
    keys = {"w": camera.width, "h": camera.height, "fl_x": camera.fx, "fl_y": camera.fy}
    centre = {"cx": camera.cx, "cy": camera.cy}
    return {"file_path": camera.name, "transform_matrix": pose.tolist(), **keys, **centre}


def test_what_was_applied_can_be_undone(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    cameras = [
        Camera(64, 48, 50, 51, 32, 24, r.as_matrix(), rng.normal(size=3), f"{k}")
        for k, r in enumerate(Rotation.random(10, random_state=1))
    ]
    matrix = np.array(APPLIED)
    matrix[:, 3] = 1, -2, 0.5
    frames = [applied(camera, matrix, 0.25) for camera in cameras]
    value = {"frames": frames, "applied_transform": matrix.tolist(), "applied_scale": 0.25}
    path = saved(tmp_path, value)
    assert_same(read_transforms(path, original_frame=True), cameras)
    turned = read_transforms(path)
    expected = (np.stack([c.position for c in cameras]) @ matrix[:, :3].T + matrix[:, 3]) * 0.25
    np.testing.assert_allclose([c.position for c in turned], expected, atol=1e-12)
    plain = saved(tmp_path, {"frames": frames})
    assert_same(read_transforms(plain, original_frame=True), turned)


def test_distortion_is_ignored_with_a_warning(tmp_path: Path) -> None:
    bent = {"transform_matrix": POSE, "k1": 0.1}
    value = document(bent, {"transform_matrix": POSE}, p1=0, k2=0.0)
    with pytest.warns(CogsplatWarning, match="1 of 2 cameras have lens distortion") as caught:
        cameras = read_transforms(saved(tmp_path, value))
    assert len(caught) == 1
    assert len(cameras) == 2


@pytest.mark.parametrize("key", ["camera_model", "is_fisheye"])
def test_lenses_that_are_no_pinholes(tmp_path: Path, key: str) -> None:
    value = {"camera_model": "OPENCV_FISHEYE", "is_fisheye": True}[key]
    for content in (document(**{key: value}), document({"transform_matrix": POSE, key: value})):
        error = refused(tmp_path, content)
        assert isinstance(error, UnsupportedError)
        assert error.code == "camera-model"


def changed(row: int, column: int, value: object) -> list[list[Any]]:
    pose: list[list[Any]] = [list(values) for values in POSE]
    pose[row][column] = value
    return pose


SCALED = (np.array(POSE) * [[2, 2, 2, 1]]).tolist()
MIRRORED = (np.array(POSE) * [[-1, 1, 1, 1]]).tolist()


@pytest.mark.parametrize(
    ("frame", "code", "said"),
    [
        ({}, "bad-transforms-json", "'transform_matrix' is missing"),
        ({"transform_matrix": 5}, "bad-transforms-json", "'transform_matrix' is 5"),
        ({"transform_matrix": POSE[:2]}, "bad-transforms-json", "array of 2"),
        ({"transform_matrix": [*POSE[:3], 5]}, "bad-transforms-json", "row 3"),
        ({"transform_matrix": changed(0, 0, "x")}, "bad-transforms-json", "row 0"),
        ({"transform_matrix": changed(0, 0, None)}, "bad-transforms-json", "row 0"),
        ({"transform_matrix": changed(3, 3, 2)}, "bad-transforms-json", "fourth row"),
        ({"transform_matrix": SCALED}, "bad-camera", "off orthonormal"),
        ({"transform_matrix": MIRRORED}, "bad-camera", "mirrored"),
        ({"transform_matrix": changed(0, 0, 1e300)}, "bad-camera", ""),
        ({"transform_matrix": POSE, "w": 0}, "bad-transforms-json", "'w' is 0"),
        ({"transform_matrix": POSE, "w": 1.5}, "bad-transforms-json", "'w' is 1.5"),
        ({"transform_matrix": POSE, "h": "480"}, "bad-transforms-json", "'h' is"),
        ({"transform_matrix": POSE, "fl_x": 0}, "bad-camera", "fx 0"),
        ({"transform_matrix": POSE, "fl_x": True}, "bad-transforms-json", "'fl_x' is true"),
        ({"transform_matrix": POSE, "camera_angle_y": 4}, "bad-transforms-json", "pi"),
        ({"transform_matrix": POSE, "file_path": 7}, "bad-transforms-json", "'file_path' is 7"),
        ({"transform_matrix": POSE, "k1": []}, "bad-transforms-json", "'k1'"),
    ],
)
def test_says_which_frame_and_what(tmp_path: Path, frame: Json, code: str, said: str) -> None:
    good = {"transform_matrix": POSE}
    error = refused(tmp_path, document(good, frame))
    assert error.code == code
    assert "frames 1" in error.message
    assert said in error.message


@pytest.mark.parametrize(
    ("value", "code"),
    [
        ("", "bad-transforms-json"),
        ("[]", "bad-transforms-json"),
        ("{", "bad-transforms-json"),
        ("{" * 100_000, "bad-transforms-json"),
        ("{}", "bad-transforms-json"),
        (json.dumps(document()).replace("-1.0", "NaN", 1), "bad-transforms-json"),
        ({"frames": {}}, "bad-transforms-json"),
        ({"frames": [5]}, "bad-transforms-json"),
        ({"frames": []}, "no-cameras"),
        ({"frames": [{"transform_matrix": POSE}]}, "bad-transforms-json"),
        ({"w": 5, "h": 5, "frames": [{"transform_matrix": POSE}]}, "bad-transforms-json"),
        (document(camera_model=5), "bad-transforms-json"),
    ],
)
def test_files_that_hold_no_cameras(tmp_path: Path, value: object, code: str) -> None:
    assert refused(tmp_path, value).code == code


@pytest.mark.parametrize(
    "keys",
    [
        {"applied_transform": [[1, 0, 0]]},
        {"applied_transform": [[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 0]]},
        {"applied_transform": [[-1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]},
        {"applied_scale": 0},
        {"applied_scale": "1"},
    ],
)
def test_what_cannot_be_undone(tmp_path: Path, keys: Json) -> None:
    path = saved(tmp_path, document(**keys))
    assert len(read_transforms(path)) == 1
    with pytest.raises(FormatError) as caught:
        read_transforms(path, original_frame=True)
    assert caught.value.code == "bad-transforms-json"


def test_limits(tmp_path: Path) -> None:
    frame = {"transform_matrix": POSE}
    path = saved(tmp_path, document(frame, frame))
    with pytest.raises(LimitError) as caught:
        read_transforms(path, limits=Limits(cameras=1))
    assert caught.value.code == "too-many-cameras"
    # Each value is short enough, and together they are not.
    more = {str(k): "x" * 400_000 for k in range(3)}
    assert refused(tmp_path, document(frame) | more).code == "json-too-long"


@settings(
    deadline=None, max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.data())
@pytest.mark.filterwarnings("ignore::cogsplat.codec.errors.CogsplatWarning")
def test_wild_files_raise_only_cogsplat_errors(tmp_path: Path, data: st.DataObject) -> None:
    value = document(applied_transform=APPLIED, k1=0.0, camera_model="OPENCV")
    wild = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3)
    key = data.draw(st.sampled_from([*value, "camera_angle_x", "applied_scale"]))
    value[key] = data.draw(wild | st.lists(wild, max_size=4))
    frame = {"transform_matrix": [list(row) for row in POSE]}
    frame["transform_matrix"][data.draw(st.integers(0, 3))] = data.draw(st.lists(wild, max_size=5))
    if isinstance(value["frames"], list):
        value["frames"].append(frame)
    with contextlib.suppress(CogsplatError):
        read_transforms(saved(tmp_path, value), original_frame=data.draw(st.booleans()))


def test_an_empty_list_of_cameras_is_no_format_error(tmp_path: Path) -> None:
    assert isinstance(refused(tmp_path, {"frames": []}), DataError)


@pytest.mark.shared
@needs_shared
def test_fox_through_a_transforms_json(tmp_path: Path) -> None:
    model = find_model(SHARED / "fox")
    assert model is not None
    cameras = read_colmap(model)
    frames = [applied(camera, np.array(APPLIED), 1.0) for camera in cameras]
    path = saved(tmp_path, {"frames": frames, "applied_transform": APPLIED})
    assert_same(read_transforms(path, original_frame=True), cameras)
