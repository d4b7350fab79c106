"""Small files that ask for much: refused, and before anything of it is allocated."""

import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path

import hostile_files as hostile
import numpy as np
import pytest
from tracing import start_tracing

from cogsplat.codec.errors import CogsplatError, LimitError
from cogsplat.formats.cameras.camera_files import read_cameras
from cogsplat.formats.cameras.nerfstudio import read_transforms
from cogsplat.formats.scenes.registry import read_scene
from cogsplat.formats.storage.limits import Limits

MIB = 1 << 20
Maker = Callable[[Path], Path]


def cost(read: Callable[[Path], object], path: Path) -> tuple[CogsplatError | None, int]:
    """Return the refusal, and the peak of memory that reading took."""
    start_tracing()
    try:
        read(path)
    except CogsplatError as error:
        return error, tracemalloc.get_traced_memory()[1]
    else:
        return None, tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


SCENES: dict[str, tuple[Maker, str]] = {
    "an entry of a ZIP named by all images": (
        lambda folder: hostile.sog_of_one_entry(folder, side=16, count=9, inflated=32 * MIB),
        "sog-zip-ratio",
    ),
    "an entry of a ZIP that reaches into the next": (
        hostile.sog_of_overlapping_entries,
        "sog-zip",
    ),
    "a ZIP directory without end": (
        lambda folder: hostile.sog_of_many_entries(folder, entries=30_000),
        "sog-zip-directory",
    ),
    "millions of splats in an image of one colour": (
        lambda folder: hostile.sog_of_one_entry(
            folder, side=2048, count=4_000_000, inflated=3 * MIB
        ),
        "decoded-size",
    ),
    "primitives that share their accessors": (
        lambda folder: hostile.gltf_of_shared_accessors(folder, splats=10_000, primitives=200),
        "gltf-too-many-instances",
    ),
    "primitives that share most of their accessors": (
        lambda folder: hostile.gltf_of_shared_accessors(
            folder, splats=10_000, primitives=16, degree=3
        ),
        "decoded-size",
    ),
    "empty arrays in a .gltf": (
        lambda folder: hostile.gltf_of_empty_arrays(folder, arrays=500_000),
        "json-too-long",
    ),
    "zeros in gzip": (
        lambda folder: hostile.spz_of_zeros(folder, version=3, splats=150_000),
        "decoded-size",
    ),
    "zeros in zstd": (
        lambda folder: hostile.spz_of_zeros(folder, version=4, splats=200_000),
        "decoded-size",
    ),
    "zeros in zstd behind padding": (
        lambda folder: hostile.spz_of_zeros(folder, version=4, splats=500_000, padding=MIB - 8),
        "decoded-size",
    ),
    "a list for every byte": (
        lambda folder: hostile.ply_of_empty_lists(folder, lists=1 << 18),
        "ply-too-many-lists",
    ),
}


@pytest.mark.parametrize(("make", "code"), SCENES.values(), ids=SCENES.keys())
def test_scenes(tmp_path: Path, make: Maker, code: str) -> None:
    path = make(tmp_path)
    error, peak = cost(read_scene, path)
    assert error is not None
    assert error.code == code
    assert peak < 8 * MIB + 3 * path.stat().st_size


CAMERAS: dict[str, tuple[Maker, str]] = {
    "empty arrays in an entry": (
        lambda folder: hostile.cameras_json_of_empty_arrays(folder, size=5 * MIB),
        "json-too-long",
    ),
    "a name without end": (
        lambda folder: hostile.colmap_with_long_line(folder, size=MIB),
        "colmap-malformed",
    ),
}


@pytest.mark.parametrize(("make", "code"), CAMERAS.values(), ids=CAMERAS.keys())
def test_cameras(tmp_path: Path, make: Maker, code: str) -> None:
    error, peak = cost(read_cameras, make(tmp_path))
    assert error is not None
    assert error.code == code
    assert peak < 64 * MIB


@pytest.mark.parametrize(
    "make",
    [
        lambda folder: hostile.cameras_json_of_many(folder, cameras=11),
        lambda folder: hostile.colmap(folder, images=11),
        lambda folder: hostile.transforms_json_of_one_picture(folder, frames=11),
    ],
    ids=["cameras.json", "COLMAP", "transforms.json"],
)
def test_more_cameras_than_allowed(tmp_path: Path, make: Maker) -> None:
    path = make(tmp_path)
    assert len(read_cameras(path, limits=Limits(cameras=11))) == 11
    with pytest.raises(LimitError) as caught:
        read_cameras(path, limits=Limits(cameras=10))
    assert caught.value.code == "too-many-cameras"


def test_a_model_of_a_hundred_thousand_cameras_is_refused_by_its_count(tmp_path: Path) -> None:
    error, peak = cost(read_cameras, hostile.colmap(tmp_path, images=100_001))
    assert error is not None
    assert error.code == "too-many-cameras"
    assert peak < MIB


def test_cameras_that_share_a_picture_read_it_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = hostile.transforms_json_of_one_picture(tmp_path, frames=20)
    opened = []
    real = Path.open

    def count(self: Path, *args: object) -> object:
        opened.append(self.name)
        return real(self, *args)  # type: ignore[arg-type]

    monkeypatch.setattr(Path, "open", count)
    assert len(read_transforms(path)) == 20
    assert opened.count("p.png") == 1


@pytest.mark.parametrize(
    "node",
    [
        {"matrix": [1e308] * 16},
        {"matrix": [*([0] * 15), 1e300]},
        {"matrix": [1e300, 0, 0, 0, 0, 1e300, 0, 0, 0, 0, 1e300, 0, 0, 0, 0, 1]},
        {"matrix": [5e-324, 0, 0, 0, 0, 5e-324, 0, 0, 0, 0, 5e-324, 0, 0, 0, 0, 1]},
        {"scale": [-1e-110] * 3},
        {"scale": [1e-110, -1e-110, 1e-110]},
        {"scale": [1e150] * 3},
        {"scale": [0] * 3},
        {"scale": [1e-300, 1, 1]},
        {"translation": [1e39, 0, 0]},
        {"rotation": [1e200, 0, 0, 1e200]},
        {"rotation": [1e-200, 0, 0, 1e-200]},
    ],
)
def test_nodes_that_leave_the_range_of_numbers(tmp_path: Path, node: dict[str, object]) -> None:
    error, _ = cost(read_scene, hostile.gltf_with_node(tmp_path, node))
    assert error is not None
    assert error.code in ("gltf-bad-transform", "gltf-shear", "gltf-bad-json")


def test_a_small_node_that_mirrors(tmp_path: Path) -> None:
    """Where the determinant underflows, a mirror is one all the same."""
    small = read_scene(hostile.gltf_with_node(tmp_path, {"scale": [-1e-30] * 3}))
    plain = read_scene(hostile.gltf_with_node(tmp_path, {"scale": [-1.0] * 3}))
    np.testing.assert_allclose(small.means, plain.means * np.float32(1e-30), rtol=1e-6)
    np.testing.assert_array_equal(small.quats, plain.quats)


def test_limits_are_the_callers(tmp_path: Path) -> None:
    path = hostile.spz_of_zeros(tmp_path, version=3, splats=1000)
    assert len(read_scene(path)) == 1000
    for limits, code in (
        (Limits(splats=999), "too-many-splats"),
        (Limits(decoded_bytes=100_000), "decoded-size"),
        (Limits(small_bytes=0, foreign_expansion=1), "decoded-size"),
    ):
        with pytest.raises(LimitError) as caught:
            read_scene(path, limits=limits)
        assert (caught.value.code, caught.value.exit_code) == (code, 5)
    large = hostile.spz_of_zeros(tmp_path, version=4, splats=200_000)
    assert len(read_scene(large, limits=Limits(foreign_expansion=1 << 20))) == 200_000


def test_an_honest_bundle_deflated_by_others(tmp_path: Path) -> None:
    """A ZIP whose images are deflated, as `zip` does it, is a scene all the same."""
    path = hostile.sog_of_one_entry(tmp_path, side=16, count=9, inflated=16)
    with zipfile.ZipFile(path) as archive:
        assert len(archive.namelist()) == 2
    assert len(read_scene(path)) == 9
