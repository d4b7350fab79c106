from __future__ import annotations

import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from tracing import start_tracing

from cogsplat.codec.errors import CogsplatError, LimitError, StorageError, TruncatedError
from cogsplat.formats.cameras import colmap, colmap_records
from cogsplat.formats.cameras.camera_files import read_cameras
from cogsplat.formats.storage.limits import Limits

SHARED = Path(__file__).parents[4] / "shared" / "data"
needs_shared = pytest.mark.skipif(not SHARED.is_dir(), reason="the real scenes are not here")

Lens = tuple[int, int, int, int, list[float]]
Image = tuple[int, list[float], list[float], int, str, int]

NUMBERS = {"SIMPLE_PINHOLE": 0, "PINHOLE": 1, "SIMPLE_RADIAL": 2, "RADIAL": 3, "OPENCV": 4}
NAMES = {number: name for name, number in NUMBERS.items()}

LENSES: list[Lens] = [
    (7, NUMBERS["PINHOLE"], 640, 480, [500.0, 510.0, 320.5, 239.0]),
    (2, NUMBERS["SIMPLE_PINHOLE"], 100, 50, [80.0, 50.0, 25.0]),
]
ROTATION = Rotation.random(random_state=4)


def quaternion(rotation: Rotation) -> list[float]:
    x, y, z, w = rotation.as_quat()
    return [float(v) for v in (w, x, y, z)]


IMAGES: list[Image] = [
    (30, quaternion(ROTATION), [0.5, -1.0, 2.0], 7, "b one.png", 3),
    (10, [2.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0], 2, "c.png", 0),
    (20, [0.0, 0.0, 0.0, -1.0], [0.0, 0.0, 0.0], 7, "a.png", 1),
]


def cameras_bin(lenses: list[Lens] = LENSES) -> bytes:
    data = struct.pack("<Q", len(lenses))
    for number, model, width, height, values in lenses:
        data += struct.pack("<iiQQ", number, model, width, height)
        data += struct.pack(f"<{len(values)}d", *values)
    return data


def images_bin(images: list[Image] = IMAGES) -> bytes:
    data = struct.pack("<Q", len(images))
    for number, q, t, lens, name, points in images:
        data += struct.pack("<i7di", number, *q, *t, lens) + name.encode() + b"\0"
        data += struct.pack("<Q", points) + struct.pack("<ddq", 1.5, 2.5, -1) * points
    return data


def cameras_txt(lenses: list[Lens] = LENSES) -> bytes:
    lines = ["# Camera list", "#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]", ""]
    for number, model, width, height, values in lenses:
        lines.append(f"{number} {NAMES[model]} {width} {height} {' '.join(map(repr, values))}")
    return "\n".join(lines).encode() + b"\n"


def images_txt(images: list[Image] = IMAGES) -> bytes:
    lines = ["# Image list with two lines of data per image:", "#   ..."]
    for number, q, t, lens, name, points in images:
        lines.append(f"{number} {' '.join(map(repr, [*q, *t]))} {lens} {name}")
        lines.append(" ".join(["1.5 2.5 -1"] * points))
    return "\n".join(lines).encode() + b"\n"


def model(folder: Path, cameras: bytes, images: bytes, suffix: str = ".bin") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / f"cameras{suffix}").write_bytes(cameras)
    (folder / f"images{suffix}").write_bytes(images)
    return folder


def refused(folder: Path) -> CogsplatError:
    with pytest.raises(CogsplatError) as caught:
        read_cameras(folder)
    assert str(folder) in caught.value.message
    # What `Camera` says of its values is its own.
    assert "expected" in caught.value.message or caught.value.code == "bad-camera"
    return caught.value


@pytest.mark.parametrize("suffix", [".bin", ".txt"])
@pytest.mark.parametrize("place", [".", "sparse/0", "sparse"])
def test_reads_a_model_wherever_it_lies(tmp_path: Path, suffix: str, place: str) -> None:
    if suffix == ".bin":
        model(tmp_path / place, cameras_bin(), images_bin())
    else:
        model(tmp_path / place, cameras_txt(), images_txt(), suffix)
    a, b, c = read_cameras(tmp_path)
    assert [camera.name for camera in (a, b, c)] == ["a.png", "b one.png", "c.png"]
    assert (b.width, b.height, b.fx, b.fy, b.cx, b.cy) == (640, 480, 500.0, 510.0, 320.5, 239.0)
    assert (c.width, c.height, c.fx, c.fy, c.cx, c.cy) == (100, 50, 80.0, 80.0, 50.0, 25.0)
    np.testing.assert_allclose(a.rotation, np.diag([-1.0, -1.0, 1.0]), atol=1e-15)
    np.testing.assert_allclose(b.rotation, ROTATION.as_matrix(), atol=1e-14)
    np.testing.assert_array_equal(b.translation, [0.5, -1.0, 2.0])
    np.testing.assert_array_equal(c.rotation, np.eye(3))
    np.testing.assert_array_equal(c.position, [0.0, 0.0, -1.0])


def test_binary_goes_before_text(tmp_path: Path) -> None:
    model(tmp_path, cameras_txt(), images_txt(IMAGES[:1]), ".txt")
    model(tmp_path, cameras_bin(), images_bin())
    assert len(read_cameras(tmp_path)) == 3


def test_names_that_occur_twice_go_by_number(tmp_path: Path) -> None:
    images = [(number, *IMAGES[1][1:]) for number in (5, 3, 4)]
    images = [(n, q, [float(n), 0, 0], lens, name, p) for n, q, _, lens, name, p in images]
    model(tmp_path, cameras_bin(), images_bin(images))
    assert [camera.translation[0] for camera in read_cameras(tmp_path)] == [3, 4, 5]


@pytest.mark.parametrize("suffix", [".bin", ".txt"])
@pytest.mark.parametrize(
    ("name", "values", "fy"),
    [
        ("SIMPLE_RADIAL", [90.0, 50.0, 25.0, 0.0], 90.0),
        ("RADIAL", [90.0, 50.0, 25.0, 0.0, 0.0], 90.0),
        ("OPENCV", [90.0, 95.0, 50.0, 25.0, 0.0, 0.0, 0.0, 0.0], 95.0),
    ],
)
def test_lenses_with_distortion_are_read_where_it_is_zero(
    tmp_path: Path, suffix: str, name: str, values: list[float], fy: float
) -> None:
    def folder(parameters: list[float]) -> Path:
        lenses = [(7, NUMBERS[name], 100, 50, parameters)]
        if suffix == ".bin":
            return model(tmp_path, cameras_bin(lenses), images_bin(IMAGES[:1]))
        return model(tmp_path, cameras_txt(lenses), images_txt(IMAGES[:1]), suffix)

    (camera,) = read_cameras(folder(values))
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (90.0, fy, 50.0, 25.0)
    for bent in (0.01, float("nan")):
        error = refused(folder([*values[:-1], bent]))
        assert error.code == "camera-model"
        assert name in error.message
        assert "undistort" in error.message


def test_models_that_are_not_pinholes_are_named(tmp_path: Path) -> None:
    for number, name in ((5, "OPENCV_FISHEYE"), (99, "number 99"), (-1, "number -1")):
        lenses = [(7, number, 100, 50, [1.0] * 8)]
        error = refused(model(tmp_path, cameras_bin(lenses), images_bin()))
        assert error.code == "camera-model"
        assert name in error.message
    text = b"7 FULL_OPENCV 100 50 " + b"1 " * 12
    error = refused(model(tmp_path / "t", text, images_txt(), ".txt"))
    assert (error.code, "FULL_OPENCV" in error.message) == ("camera-model", True)


def with_count(data: bytes, count: int) -> bytes:
    return struct.pack("<Q", count) + data[8:]


@pytest.mark.parametrize("count", [3, 2**31, 2**64 - 1])
def test_counts_beyond_the_file_allocate_nothing(tmp_path: Path, count: int) -> None:
    one = images_bin([IMAGES[1]])
    points = one[:-8] + struct.pack("<Q", count)
    for number, (cameras, images) in enumerate(
        [
            (with_count(cameras_bin(), count), images_bin()),
            (cameras_bin(), with_count(images_bin(IMAGES[:2]), count)),
            (cameras_bin(), points),
        ]
    ):
        folder = model(tmp_path / str(number), cameras, images)
        start_tracing()
        try:
            error = refused(folder)
            assert tracemalloc.get_traced_memory()[1] < 1 << 20
        finally:
            tracemalloc.stop()
        assert isinstance(error, TruncatedError)
        assert error.code == "colmap-truncated"


def test_every_truncation_is_noticed(tmp_path: Path) -> None:
    for whole, other in ((cameras_bin(), "cameras"), (images_bin(), "images")):
        for length in range(len(whole)):
            model(tmp_path, cameras_bin(), images_bin())
            (tmp_path / f"{other}.bin").write_bytes(whole[:length])
            assert refused(tmp_path).code == "colmap-truncated"


def test_trailing_bytes(tmp_path: Path) -> None:
    for cameras, images in (
        (cameras_bin() + b"\0", images_bin()),
        (cameras_bin(), images_bin() + b"\0"),
    ):
        error = refused(model(tmp_path, cameras, images))
        assert error.code == "colmap-trailing-bytes"


def test_a_name_without_end(tmp_path: Path) -> None:
    images: list[Image] = [(1, *IMAGES[0][1:4], "x" * 9000, 0)]
    assert refused(model(tmp_path, cameras_bin(), images_bin(images))).code == "colmap-malformed"


@pytest.mark.parametrize(
    ("code", "lenses", "images"),
    [
        ("colmap-duplicate-camera", [LENSES[0], LENSES[0]], IMAGES),
        ("colmap-missing-camera", LENSES[:1], IMAGES),
        ("no-cameras", LENSES, []),
        ("bad-camera", [(7, 1, 640, 480, [0.0, 510.0, 320.5, 239.0])], IMAGES[:1]),
        ("bad-camera", [(7, 1, 640, 480, [float("nan"), 510.0, 320.5, 239.0])], IMAGES[:1]),
        ("bad-camera", [(7, 1, 0, 480, [500.0, 510.0, 320.5, 239.0])], IMAGES[:1]),
        ("bad-camera", [(7, 1, 2**63, 480, [500.0, 510.0, 320.5, 239.0])], IMAGES[:1]),
        ("bad-camera", LENSES, [(1, [0.0] * 4, [0.0] * 3, 7, "a", 0)]),
        ("bad-camera", LENSES, [(1, [1e300] * 4, [0.0] * 3, 7, "a", 0)]),
        ("bad-camera", LENSES, [(1, [float("nan")] * 4, [0.0] * 3, 7, "a", 0)]),
        ("bad-camera", LENSES, [(1, [1.0, 0, 0, 0], [float("inf"), 0, 0], 7, "a", 0)]),
    ],
)
@pytest.mark.parametrize("suffix", [".bin", ".txt"])
def test_refuses(
    tmp_path: Path, code: str, lenses: list[Lens], images: list[Image], suffix: str
) -> None:
    if suffix == ".bin":
        model(tmp_path, cameras_bin(lenses), images_bin(images))
    else:
        model(tmp_path, cameras_txt(lenses), images_txt(images), suffix)
    assert refused(tmp_path).code == code


@pytest.mark.parametrize(
    ("cameras", "images"),
    [
        (b"7 PINHOLE 640\n", b""),
        (b"7 PINHOLE 640 480 1 1 1\n", b""),
        (b"7 PINHOLE 640 480 1 1 1 1 1\n", b""),
        (b"seven PINHOLE 640 480 1 1 1 1\n", b""),
        (b"7 PINHOLE 640.5 480 1 1 1 1\n", b""),
        (b"7 PINHOLE 640 480 1 1 1 \xff\n", b""),
        (b"7 PINHOLE 640 480 1 1 1 1\n", b"1 1 0 0 0 0 0 0 7\n"),
        (b"7 PINHOLE 640 480 1 1 1 1\n", b"1 1 0 0 0 0 0 zero 7 a.png\n"),
        (b"7 PINHOLE 640 480 1 1 1 1\n", b"1 1 0 0 0 0 0 0 7.5 a.png\n"),
        (b"9" * 5000 + b" PINHOLE 640 480 1 1 1 1\n", b""),
    ],
)
def test_damaged_text_is_named_by_line(tmp_path: Path, cameras: bytes, images: bytes) -> None:
    error = refused(model(tmp_path, cameras, images, ".txt"))
    assert error.code == "colmap-malformed"
    assert "line 1" in error.message


def test_long_lines_of_points_are_passed_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(colmap, "MAX_LINE_BYTES", 128)
    monkeypatch.setattr(colmap_records, "MAX_LINE_BYTES", 128)
    images = [(k, *IMAGES[0][1:5], 50 * k) for k in range(5)]
    folder = model(tmp_path, cameras_txt(), images_txt(images).rstrip(), ".txt")
    assert len(read_cameras(folder)) == 5


@pytest.mark.parametrize("suffix", [".bin", ".txt"])
def test_limits(tmp_path: Path, suffix: str) -> None:
    if suffix == ".bin":
        model(tmp_path, cameras_bin(), images_bin())
    else:
        model(tmp_path, cameras_txt(), images_txt(), suffix)
    with pytest.raises(LimitError) as caught:
        read_cameras(tmp_path, limits=Limits(cameras=2))
    assert caught.value.code == "too-many-cameras"


def test_folders_that_hold_no_model(tmp_path: Path) -> None:
    assert refused(tmp_path).code == "unknown-cameras"
    (tmp_path / "cameras.bin").write_bytes(cameras_bin())
    (tmp_path / "images.txt").write_bytes(images_txt())
    assert refused(tmp_path).code == "unknown-cameras"
    with pytest.raises(StorageError) as caught:
        read_cameras(tmp_path / "none")
    assert caught.value.code == "not-found"


@settings(
    max_examples=200, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    suffix=st.sampled_from([".bin", ".txt"]),
    edits=st.lists(
        st.tuples(st.booleans(), st.floats(0, 1), st.integers(0, 255)), min_size=1, max_size=4
    ),
)
def test_damage_only_ever_raises_our_errors(
    tmp_path: Path, suffix: str, edits: list[tuple[bool, float, int]]
) -> None:
    binary = suffix == ".bin"
    files = [
        bytearray(cameras_bin() if binary else cameras_txt()),
        bytearray(images_bin() if binary else images_txt()),
    ]
    for which, place, value in edits:
        files[which][int(place * (len(files[which]) - 1))] = value
    folder = model(tmp_path / suffix[1:], bytes(files[0]), bytes(files[1]), suffix)
    try:
        read_cameras(folder)
    except CogsplatError:
        return


@pytest.mark.shared
@needs_shared
def test_fox_has_the_same_poses_in_both_formats() -> None:
    theirs = read_cameras(SHARED / "fox" / "cameras.json")
    ours = read_cameras(SHARED / "fox")
    assert [camera.name for camera in ours] == [camera.name for camera in theirs]
    for a, b in zip(ours, theirs, strict=True):
        assert (a.width, a.height, a.fx, a.fy, a.cx, a.cy) == (
            b.width, b.height, b.fx, b.fy, b.cx, b.cy,
        )  # fmt: skip
        np.testing.assert_allclose(a.rotation, b.rotation, rtol=0, atol=1e-14)
        np.testing.assert_allclose(a.translation, b.translation, rtol=0, atol=1e-13)
