from __future__ import annotations

import math
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from cogsplat.codec.errors import CogsplatWarning, DataError, FormatError, StorageError
from cogsplat.codec.geometry.rotations import unit
from cogsplat.codec.geometry.sh import colours
from cogsplat.codec.geometry.transforms import convert_axes
from cogsplat.codec.splats import SceneInfo, Splats
from cogsplat.formats.scenes.registry import read_scene, write_scene
from cogsplat.formats.scenes.splat import read_splat, write_splat

ARRAYS = ("means", "scales", "quats", "opacities", "sh0", "shN")


def scene(count: int = 300, rest: int = 0) -> Splats:
    rng = np.random.default_rng(count)
    opacities = rng.normal(0, 4, count)
    opacities[: min(2, count)] = [math.inf, -math.inf][: min(2, count)]
    return Splats(
        means=rng.normal(0, 5, (count, 3)).astype(np.float32),
        scales=rng.normal(-3, 2, (count, 3)).astype(np.float32),
        quats=rng.normal(0, 2, (count, 4)).astype(np.float32),
        opacities=opacities.astype(np.float32),
        sh0=rng.uniform(-1.7, 1.7, (count, 3)).astype(np.float32),
        shN=rng.normal(0, 1, (count, rest, 3)).astype(np.float32),
    )


def alphas(splats: Splats) -> np.ndarray:
    with np.errstate(over="ignore"):
        return 1 / (1 + np.exp(-splats.opacities.astype(np.float64)))


def test_reads_what_the_format_says(tmp_path: Path) -> None:
    path = tmp_path / "a.splat"
    path.write_bytes(
        struct.pack("<3f3f4B4B", 1, -2, 3, 0.5, 1, 2, 0, 128, 255, 51, 128 + 64, 64, 192, 64)
        + struct.pack("<3f3f4B4B", 4, 5, 6, 0, 1e-40, 7, 1, 2, 3, 255, 0, 128, 128, 128)
        + struct.pack("<3f3f4B4B", 7, 8, 9, 1, 1, 1, 1, 2, 3, 0, 128, 128, 128, 128)
    )
    splats = read_splat(path)
    assert splats.info == SceneInfo()
    assert splats.sh_degree == 0
    np.testing.assert_array_equal(splats.means, [[1, -2, 3], [4, 5, 6], [7, 8, 9]])
    np.testing.assert_allclose(splats.scales[0], np.log([0.5, 1, 2]), rtol=1e-6)
    # A flat splat is a splat: half the smallest float32 stands for no thickness.
    np.testing.assert_allclose(splats.scales[1, 0], -150 * math.log(2))
    assert splats.invalid_rows().tolist() == [False] * 3
    np.testing.assert_array_equal(
        splats.quats, [[0.5, -0.5, 0.5, -0.5], [1, 0, 0, 0], [1, 0, 0, 0]]
    )
    np.testing.assert_allclose(splats.opacities, [math.log(0.2 / 0.8), math.inf, -math.inf])
    seen = colours(splats.sh0, splats.shN, np.eye(3))
    np.testing.assert_allclose(seen[0] * 255, [0, 128, 255], atol=1e-4)


def test_bad_numbers_pass_through(tmp_path: Path) -> None:
    path = tmp_path / "a.splat"
    path.write_bytes(
        struct.pack("<3f3f8B", math.nan, 0, 0, 1, 1, 1, *[200] * 8)
        + struct.pack("<3f3f8B", 0, 0, 0, 1, -1, 1, *[200] * 8)
        + struct.pack("<3f3f8B", 0, 0, 0, 1, 1, 1, *[200] * 8)
    )
    assert read_splat(path).invalid_rows().tolist() == [True, True, False]
    signalling = struct.pack("<I", 0x7F800001)
    path.write_bytes(signalling * 6 + bytes([200] * 8))
    assert read_splat(path).invalid_rows().tolist() == [True]


@pytest.mark.parametrize("count", [0, 1, 300, 40_000])
def test_written_within_the_steps_in_order(tmp_path: Path, count: int) -> None:
    splats = scene(count)
    write_splat(splats, tmp_path / "a.splat")
    assert (tmp_path / "a.splat").stat().st_size == 32 * count
    back = read_splat(tmp_path / "a.splat")
    weight = np.exp(splats.scales.astype(float).sum(axis=1)) * alphas(splats)
    expected = splats.take(np.argsort(-weight, kind="stable"))
    np.testing.assert_array_equal(back.means, expected.means)
    np.testing.assert_allclose(back.scales, expected.scales, atol=1e-5)
    np.testing.assert_allclose(back.sh0, expected.sh0, atol=0.5 / 255 / 0.282 * 1.001)
    np.testing.assert_allclose(alphas(back), alphas(expected), atol=0.5 / 255 * 1.001)
    one, other = unit(back.quats), unit(expected.quats)
    other *= np.sign((one * other).sum(axis=1, keepdims=True))
    # Half a step per component, and a whole one for w near 1, over a norm that is nearly 1.
    np.testing.assert_allclose(one, other, atol=1.5 / 128)


def test_colours_out_of_range_are_clipped(tmp_path: Path) -> None:
    splats = scene(3)
    splats.sh0[:] = [-9.0, 9.0, 0.0]
    write_splat(splats, tmp_path / "a.splat")
    seen = colours(read_splat(tmp_path / "a.splat").sh0, np.zeros((3, 0, 3)), np.eye(3))
    np.testing.assert_allclose(seen[0], [0, 1, 128 / 255], atol=1e-6)


def test_same_bytes_every_time_and_from_any_axes(tmp_path: Path) -> None:
    a, b = tmp_path / "a.splat", tmp_path / "b.splat"
    write_splat(scene(), a)
    write_splat(convert_axes(scene(), "LUF"), b)
    assert a.read_bytes() == b.read_bytes()


def test_dropped_values_give_one_warning(tmp_path: Path) -> None:
    info = SceneInfo(origin=(1.0, 0.0, 0.0), antialiased=True)
    with pytest.warns(CogsplatWarning) as caught:
        write_splat(replace(scene(5, 8), info=info), tmp_path / "a.splat")
    assert [str(warning.message) for warning in caught] == [
        f"{tmp_path / 'a.splat'}: .splat cannot hold SH of degree 2, the origin (1.0, 0.0, 0.0), "
        "the anti-aliasing flag"
    ]


def test_rows_that_cannot_be_drawn_are_not_written(tmp_path: Path) -> None:
    splats = scene(10)
    splats.quats[4] = 0
    with pytest.raises(DataError) as caught:
        write_splat(splats, tmp_path / "a.splat")
    assert caught.value.code == "invalid-rows"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("size", [1, 31, 33, 32 * 40 + 16])
def test_odd_sizes_are_refused(tmp_path: Path, size: int) -> None:
    (tmp_path / "a.splat").write_bytes(bytes(size))
    with pytest.raises(FormatError) as caught:
        read_splat(tmp_path / "a.splat")
    assert caught.value.code == "splat-size"
    assert f"{tmp_path / 'a.splat'}: {size} bytes" in caught.value.message


def test_says_what_else_it_may_be(tmp_path: Path) -> None:
    (tmp_path / "a.splat").write_bytes(b"<!DOCTYPE html><title>404</title>\n")
    with pytest.raises(FormatError, match="markup, as an error page"):
        read_splat(tmp_path / "a.splat")


def test_found_by_extension(tmp_path: Path) -> None:
    write_scene(scene(7), tmp_path / "a.SPLAT")
    assert len(read_scene(tmp_path / "a.SPLAT")) == 7
    with pytest.raises(StorageError) as caught:
        write_splat(scene(1), tmp_path / "a.SPLAT")
    assert caught.value.code == "exists"


@settings(deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.binary(max_size=320).map(lambda data: data[: len(data) // 32 * 32]))
def test_any_bytes_are_a_scene(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "a.splat").write_bytes(data)
    splats = read_splat(tmp_path / "a.splat")
    assert len(splats) == len(data) // 32
    for name in ARRAYS:
        assert getattr(splats, name).dtype == np.float32
