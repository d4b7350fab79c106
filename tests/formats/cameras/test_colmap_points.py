from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from cogsplat.codec.errors import CogsplatError, LimitError, TruncatedError
from cogsplat.formats.cameras import colmap_points, colmap_records
from cogsplat.formats.cameras.colmap_points import find_points, read_points
from cogsplat.formats.storage.limits import Limits

SHARED = Path(__file__).parents[4] / "shared" / "data"
needs_shared = pytest.mark.skipif(not SHARED.is_dir(), reason="the real scenes are not here")

Point = tuple[int, list[float], list[int], float, int]

POINTS: list[Point] = [
    (7, [0.5, -1.25, 3.0], [255, 0, 17], 0.7, 3),
    (2, [1e-3, 2.0, -40.0], [1, 2, 3], 1.5, 0),
    (9, [0.0, 0.0, 0.0], [128, 128, 128], 0.1, 2),
]


def points_bin(points: list[Point] = POINTS) -> bytes:
    data = struct.pack("<Q", len(points))
    for number, place, colour, error, seen in points:
        data += struct.pack("<Q3d3BdQ", number, *place, *colour, error, seen)
        data += struct.pack("<ii", 4, 5) * seen
    return data


def points_txt(points: list[Point] = POINTS) -> bytes:
    lines = ["# 3D point list with one line of data per point:", ""]
    for number, place, colour, error, seen in points:
        values = [number, *map(repr, place), *colour, error, *([4, 5] * seen)]
        lines.append(" ".join(map(str, values)))
    return "\n".join(lines).encode() + b"\n"


def written(folder: Path, data: bytes, suffix: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"points3D{suffix}"
    path.write_bytes(data)
    return path


def refused(path: Path, limits: Limits | None = None) -> CogsplatError:
    with pytest.raises(CogsplatError) as caught:
        read_points(path, limits=limits)
    assert str(path) in caught.value.message
    assert "expected" in caught.value.message
    return caught.value


@pytest.mark.parametrize("suffix", [".bin", ".txt"])
def test_reads_places_and_colours_in_file_order(tmp_path: Path, suffix: str) -> None:
    data = points_bin() if suffix == ".bin" else points_txt()
    found = read_points(written(tmp_path, data, suffix))
    np.testing.assert_array_equal(found.positions, [place for _, place, *_ in POINTS])
    np.testing.assert_array_equal(found.colours, [colour for _, _, colour, *_ in POINTS])
    assert (found.positions.dtype, found.colours.dtype) == (np.float64, np.uint8)


def test_points_are_found_beside_a_model_alone(tmp_path: Path) -> None:
    text = written(tmp_path / "sparse/0", points_txt(), ".txt")
    assert find_points(tmp_path) is None
    for stem in ("cameras", "images"):
        (tmp_path / "sparse/0" / f"{stem}.txt").write_bytes(b"")
    assert find_points(tmp_path) == text
    assert find_points(tmp_path / "sparse/0") == text
    assert find_points(text) is None
    binary = written(tmp_path / "sparse/0", points_bin(), ".bin")
    assert find_points(tmp_path) == binary


def test_every_truncation_is_noticed(tmp_path: Path) -> None:
    whole = points_bin()
    for length in range(len(whole)):
        error = refused(written(tmp_path, whole[:length], ".bin"))
        assert isinstance(error, TruncatedError)
        assert error.code == "colmap-truncated"
    assert refused(written(tmp_path, whole + b"\0", ".bin")).code == "colmap-trailing-bytes"


@pytest.mark.parametrize(
    "line",
    [
        b"7 1 2 3 4 5 6",
        b"7 1 2 3 4 5 256 0.1",
        b"7 1 2 3 4 5 -1 0.1",
        b"7 1 2 3 4 5.5 6 0.1",
        b"7 1 two 3 4 5 6 0.1",
        b"7",
    ],
)
def test_damaged_text_is_named_by_line(tmp_path: Path, line: bytes) -> None:
    error = refused(written(tmp_path, b"# points\n" + line + b"\n", ".txt"))
    assert error.code == "colmap-malformed"
    assert "line 2" in error.message


def test_long_tracks_are_passed_over(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (colmap_points, colmap_records):
        monkeypatch.setattr(module, "MAX_LINE_BYTES", 96)
    points = [(*POINTS[0][:4], 100 * k) for k in range(4)]
    assert len(read_points(written(tmp_path, points_txt(points).rstrip(), ".txt")).colours) == 4


@pytest.mark.parametrize("suffix", [".bin", ".txt"])
def test_refuses(tmp_path: Path, suffix: str) -> None:
    write = points_bin if suffix == ".bin" else points_txt
    assert refused(written(tmp_path, write([]), suffix)).code == "no-points"
    infinite = [*POINTS, (5, [0.0, float("inf"), 0.0], [1, 2, 3], 0.0, 0)]
    error = refused(written(tmp_path, write(infinite), suffix))
    assert error.code == "bad-point"
    assert "record 3" in error.message
    error = refused(written(tmp_path, write(), suffix), Limits(splats=2))
    assert isinstance(error, LimitError)
    assert error.code == "too-many-splats"


@pytest.mark.shared
@needs_shared
def test_points_of_a_capture_lie_where_its_splats_do() -> None:
    from cogsplat.formats.scenes.registry import read_scene

    path = find_points(SHARED / "fox")
    assert path is not None
    found = read_points(path)
    splats = read_scene(SHARED / "fox" / "scene.ply")
    middle = np.median(found.positions, axis=0) - np.median(splats.means, axis=0)
    assert np.linalg.norm(middle) < 0.5 * np.median(np.std(splats.means, axis=0))
