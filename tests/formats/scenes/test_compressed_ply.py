from __future__ import annotations

import contextlib
import math
import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import plyfile
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from random_splats import random_splats
from tracing import start_tracing

from cogsplat.codec.errors import (
    CogsplatError,
    DataError,
    FormatError,
    TruncatedError,
    UnsupportedError,
)
from cogsplat.codec.splats import SceneInfo, Splats, empty
from cogsplat.formats.scenes.compressed_ply import (
    is_compressed_ply,
    read_compressed_ply,
    write_compressed_ply,
)
from cogsplat.formats.scenes.ply.ply_scene import read_ply
from cogsplat.formats.scenes.quantised_values import unit_opacities
from cogsplat.formats.scenes.registry import read_scene, write_scene

ARRAYS = ("means", "scales", "quats", "opacities", "sh0", "shN")
RESTS = (0, 3, 8, 15)
SHARED = Path(__file__).parents[4] / "shared" / "data"
needs_shared = pytest.mark.skipif(not SHARED.is_dir(), reason="the real scenes are not here")

RANGES = [f"{end}_{axis}" for end in ("min", "max") for axis in "xyz"]
RANGES += [f"{end}_scale_{axis}" for end in ("min", "max") for axis in "xyz"]
COLOURS = [f"{end}_{channel}" for end in ("min", "max") for channel in "rgb"]
WORDS = ["packed_position", "packed_rotation", "packed_scale", "packed_color"]
Table = dict[str, np.ndarray]


def tables(count: int, rest: int, colours: bool = True) -> dict[str, Table]:
    """Return random elements that make a file, column by column."""
    rng = np.random.default_rng(100 + count + rest)
    chunks = -(-count // 256)
    chunk = {}
    for name in RANGES + (COLOURS if colours else []):
        low = rng.uniform(-5, 0, chunks)
        chunk[name] = (low if name.startswith("min") else -low).astype("f4")
    vertex = {name: rng.integers(0, 1 << 32, count, np.uint32) for name in WORDS}
    elements = {"chunk": chunk, "vertex": vertex}
    if rest:
        elements["sh"] = {
            f"f_rest_{k}": rng.integers(0, 256, count).astype("u1") for k in range(3 * rest)
        }
    return elements


def element(name: str, columns: Table) -> plyfile.PlyElement:
    table = np.empty(
        len(next(iter(columns.values()))), [(key, v.dtype) for key, v in columns.items()]
    )
    for key, values in columns.items():
        table[key] = values
    return plyfile.PlyElement.describe(table, name)


def saved(path: Path, elements: dict[str, Table], **options: object) -> Path:
    described = [element(name, columns) for name, columns in elements.items()]
    options = {"byte_order": "<", **options}
    plyfile.PlyData(described, **options).write(path)
    return path


def expected_row(elements: dict[str, Table], row: int) -> dict[str, list[float]]:
    """Decode one splat with plain numbers, bit by bit."""
    chunk = {name: float(values[row // 256]) for name, values in elements["chunk"].items()}
    word = {name: int(values[row]) for name, values in elements["vertex"].items()}

    def between(name: str, share: float) -> float:
        low, high = chunk.get(f"min_{name}", 0.0), chunk.get(f"max_{name}", 1.0)
        return low + (high - low) * share

    def three(bits: int, prefix: str) -> list[float]:
        shares = (bits >> 21) / 2047, (bits >> 11 & 1023) / 1023, (bits & 2047) / 2047
        return [between(prefix + axis, s) for axis, s in zip("xyz", shares, strict=True)]

    rotation = word["packed_rotation"]
    others = [((rotation >> shift & 1023) / 1023 - 0.5) * math.sqrt(2) for shift in (20, 10, 0)]
    quat = others.copy()
    quat.insert(rotation >> 30, math.sqrt(max(0.0, 1 - sum(v * v for v in others))))
    colour = word["packed_color"]
    alpha = (colour & 255) / 255
    logit = {0.0: -math.inf, 1.0: math.inf}.get(alpha)
    sh = {0: -4.0, 255: 4.0}
    rest = elements.get("sh", {})
    coefficients = []
    for k in range(len(rest) // 3):
        for c in range(3):
            byte = int(rest[f"f_rest_{c * (len(rest) // 3) + k}"][row])
            coefficients.append(sh.get(byte, ((byte + 0.5) / 256 - 0.5) * 8))
    return {
        "means": three(word["packed_position"], ""),
        "scales": three(word["packed_scale"], "scale_"),
        "quats": quat,
        "opacities": [math.log(alpha / (1 - alpha)) if logit is None else logit],
        "sh0": [
            (between(channel, (colour >> shift & 255) / 255) - 0.5) / 0.28209479177387814
            for channel, shift in zip("rgb", (24, 16, 8), strict=True)
        ],
        "shN": coefficients,
    }


def refused(path: Path) -> CogsplatError:
    with pytest.raises(CogsplatError) as caught:
        read_compressed_ply(path)
    assert str(path) in caught.value.message
    return caught.value


@pytest.mark.parametrize("colours", [True, False])
@pytest.mark.parametrize("rest", RESTS)
def test_decodes_as_plain_numbers_do(tmp_path: Path, rest: int, colours: bool) -> None:
    elements = tables(600, rest, colours)
    splats = read_scene(saved(tmp_path / "a.ply", elements))
    for row in [*range(0, 600, 7), 255, 256, 511, 512, 599]:
        for name, values in expected_row(elements, row).items():
            actual = getattr(splats, name)[row].reshape(-1)
            np.testing.assert_allclose(actual, values, rtol=2e-6, atol=2e-6, err_msg=name)


def test_elements_and_properties_in_any_order(tmp_path: Path) -> None:
    elements = tables(300, 3)
    first = read_compressed_ply(saved(tmp_path / "a.ply", elements))
    turned = {name: dict(reversed(elements[name].items())) for name in reversed(elements)}
    turned["extra"] = {"a": np.zeros(7, "f8")}
    second = read_compressed_ply(saved(tmp_path / "b.ply", turned))
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name), name)


@pytest.mark.parametrize("rest", RESTS)
@pytest.mark.parametrize("count", [0, 1, 255, 256, 257, 3000])
def test_round_trip_within_the_steps(tmp_path: Path, count: int, rest: int) -> None:
    splats = random_splats(count, rest)
    path = tmp_path / "a.compressed.ply"
    write_scene(splats, path)
    read = read_scene(path)
    assert (len(read), read.shN.shape[1]) == (count, rest)
    if not count:
        return
    # Rows come in Morton order: the nearest mean names the row.
    distances = np.linalg.norm(splats.means[None, :, :] - read.means[:, None, :], axis=2)
    rows = distances.argmin(axis=1)
    assert np.mean(distances.min(axis=1) < 0.05) == 1
    expected = splats.take(rows)
    np.testing.assert_allclose(read.means, expected.means, atol=40 / 1023 / 2)
    np.testing.assert_allclose(read.scales, expected.scales, atol=10 / 1023 / 2)
    np.testing.assert_allclose(read.sh0, expected.sh0, atol=10 / 255 / 2 + 1e-6)
    np.testing.assert_allclose(read.shN, expected.shN, atol=8 / 256 / 2 + 1e-6)
    np.testing.assert_allclose(
        unit_opacities(read.opacities), unit_opacities(expected.opacities), atol=0.5 / 255 + 1e-6
    )
    norm = np.linalg.norm(expected.quats, axis=1)
    dots = np.abs((read.quats * expected.quats).sum(axis=1)) / norm
    assert dots.min() > 1 - 2e-6
    np.testing.assert_allclose(np.linalg.norm(read.quats, axis=1), 1, atol=1e-6)


def test_every_row_is_there_once(tmp_path: Path) -> None:
    splats = replace(
        random_splats(1000, 0), sh0=np.arange(3000, dtype=np.float32).reshape(1000, 3) / 1000
    )
    write_compressed_ply(splats, tmp_path / "a.compressed.ply")
    read = read_compressed_ply(tmp_path / "a.compressed.ply")
    for name in ("means", "scales", "sh0"):
        actual, expected = np.sort(getattr(read, name), 0), np.sort(getattr(splats, name), 0)
        np.testing.assert_allclose(actual, expected, atol=0.02)


def test_written_again_the_file_stays_the_same(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_compressed_ply(random_splats(700), tmp_path / name)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


@pytest.mark.parametrize("rest", RESTS)
def test_plyfile_reads_what_we_write(tmp_path: Path, rest: int) -> None:
    write_compressed_ply(random_splats(300, rest), tmp_path / "a.ply")
    data = plyfile.PlyData.read(tmp_path / "a.ply")
    assert [e.name for e in data.elements] == ["chunk", "vertex"] + ["sh"] * bool(rest)
    assert [p.name for p in data["chunk"].properties] == RANGES + COLOURS
    assert [p.name for p in data["vertex"].properties] == WORDS
    assert len(data["chunk"]) == 2
    means = read_compressed_ply(tmp_path / "a.ply").means
    np.testing.assert_array_equal(data["chunk"]["min_x"][0], means[:256, 0].min())
    np.testing.assert_array_equal(data["chunk"]["max_z"][1], means[256:, 2].max())


def test_extremes(tmp_path: Path) -> None:
    splats = replace(
        random_splats(6, 3),
        means=np.full((6, 3), 2.5, np.float32),
        scales=np.array([[-100, 0, 100]] * 6, np.float32),
        opacities=np.array([-np.inf, -80, -1, 1, 80, np.inf], np.float32),
        quats=np.array([[1e-30, 0, 0, 0], [0, -3e20, 0, 0], *[[1, 1, -1, 1]] * 4], np.float32),
        shN=np.array([[[-9, 9, 0]] * 3] * 6, np.float32),
    )
    write_compressed_ply(splats, tmp_path / "a.ply")
    read = read_compressed_ply(tmp_path / "a.ply")
    np.testing.assert_array_equal(read.means, splats.means)
    np.testing.assert_array_equal(read.scales, [[-20, 0, 20]] * 6)
    np.testing.assert_array_equal(read.opacities[[0, 1, 4, 5]], [-np.inf, -np.inf, np.inf, np.inf])
    np.testing.assert_allclose(read.quats[0], [1, 0, 0, 0], atol=2e-3)
    np.testing.assert_allclose(read.quats[1], [0, 1, 0, 0], atol=2e-3)
    np.testing.assert_allclose(read.quats[2], [0.5, 0.5, -0.5, 0.5], atol=2e-3)
    np.testing.assert_allclose(read.shN, [[[-4, 4, 0.015625]] * 3] * 6)


def test_carries_what_the_scene_says_of_itself(tmp_path: Path) -> None:
    info = SceneInfo((1.5, 2.0, -3.0), "RUB", "linear", 0.1, True)
    write_compressed_ply(random_splats(5, info=info), tmp_path / "a.ply")
    assert read_compressed_ply(tmp_path / "a.ply").info == info
    assert b"comment SplatRenderMode: mip\n" in (tmp_path / "a.ply").read_bytes()
    foreign = saved(
        tmp_path / "b.ply", tables(3, 0), comments=["Generated by x", "SplatRenderMode: mip"]
    )
    assert read_compressed_ply(foreign).info == SceneInfo(antialiased=True)


def test_sniffs(tmp_path: Path) -> None:
    write_compressed_ply(random_splats(5), tmp_path / "a.ply")
    data = (tmp_path / "a.ply").read_bytes()
    assert is_compressed_ply(data)
    assert is_compressed_ply(data.replace(b"\n", b"\r\n"))
    assert not is_compressed_ply(data[1:])
    assert not is_compressed_ply(b"ply\ncomment packed_position\nend_header\n")
    assert not is_compressed_ply(b"ply\nend_header\nproperty uint packed_position\n")


def test_rows_that_cannot_be_drawn_are_not_written(tmp_path: Path) -> None:
    splats = replace(random_splats(3), means=np.full((3, 3), np.nan, np.float32))
    with pytest.raises(DataError) as caught:
        write_compressed_ply(splats, tmp_path / "a.ply")
    assert caught.value.code == "invalid-rows"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("value", [np.nan, np.inf, 3e38])
def test_ranges_that_are_not_finite_give_rows_that_are_not(tmp_path: Path, value: float) -> None:
    elements = tables(300, 0)
    elements["chunk"]["min_x"][1] = -value
    elements["chunk"]["max_r"][1] = value
    splats = read_compressed_ply(saved(tmp_path / "a.ply", elements))
    assert not splats.invalid_rows()[:256].any()
    if value != 3e38:
        assert splats.invalid_rows()[256:].all()


@pytest.mark.parametrize("layout", ["text", "big", "list"])
def test_layouts_that_nobody_writes(tmp_path: Path, layout: str) -> None:
    elements = tables(3, 0)
    if layout == "list":
        path = saved(tmp_path / "a.ply", elements)
        data = path.read_bytes().replace(
            b"end_header", b"element x 0\nproperty list uchar int y\nend_header"
        )
        path.write_bytes(data)
    else:
        options = {"text": True} if layout == "text" else {"byte_order": ">"}
        path = saved(tmp_path / "a.ply", elements, **options)
    error = refused(path)
    assert isinstance(error, UnsupportedError)
    assert error.code == "compressed-ply-layout"


def change(elements: dict[str, Table], what: str) -> None:
    chunk, vertex, sh = elements["chunk"], elements["vertex"], elements["sh"]
    if what == "chunk":
        del elements["chunk"]
    elif what == "range":
        del chunk["max_scale_y"]
    elif what == "colour":
        del chunk["max_b"]
    elif what == "double":
        chunk["min_x"] = chunk["min_x"].astype("f8")
    elif what == "word":
        del vertex["packed_rotation"]
    elif what == "signed":
        vertex["packed_color"] = vertex["packed_color"].astype("i4")
    elif what == "chunks":
        elements["chunk"] = {name: values[:1] for name, values in chunk.items()}
    elif what == "sh count":
        del sh["f_rest_8"]
    elif what == "sh names":
        sh["f_rest_9"] = sh.pop("f_rest_8")
    elif what == "sh rows":
        elements["sh"] = {name: values[:-1] for name, values in sh.items()}
    elif what == "sh type":
        sh["f_rest_0"] = sh["f_rest_0"].astype("i2")


@pytest.mark.parametrize(
    ("what", "code", "said"),
    [
        ("chunk", "compressed-ply-properties", "'chunk'"),
        ("range", "compressed-ply-properties", "max_scale_y"),
        ("colour", "compressed-ply-properties", "max_b"),
        ("double", "compressed-ply-properties", "min_x as float"),
        ("word", "compressed-ply-properties", "packed_rotation as uint"),
        ("signed", "compressed-ply-properties", "packed_color as uint"),
        ("chunks", "compressed-ply-chunks", "1 chunks for 300 splats, expected 2"),
        ("sh count", "compressed-ply-sh", "8 properties"),
        ("sh names", "compressed-ply-sh", "f_rest_0"),
        ("sh rows", "compressed-ply-sh", "299 rows"),
        ("sh type", "compressed-ply-properties", "f_rest_0 as uchar"),
    ],
)
def test_messages_name_the_fault(tmp_path: Path, what: str, code: str, said: str) -> None:
    elements = tables(300, 3)
    change(elements, what)
    error = refused(saved(tmp_path / "a.ply", elements))
    assert isinstance(error, FormatError)
    assert error.code == code
    assert said in error.message


def test_every_prefix_is_refused(tmp_path: Path) -> None:
    data = saved(tmp_path / "whole.ply", tables(3, 3)).read_bytes()
    for length in [*range(5, len(data) - 200, 9), *range(len(data) - 200, len(data))]:
        path = tmp_path / "cut.ply"
        path.write_bytes(data[:length])
        assert isinstance(refused(path), TruncatedError)
    path.write_bytes(data + b"\0")
    assert refused(path).code == "ply-trailing-bytes"


def test_hostile_counts_allocate_nothing(tmp_path: Path) -> None:
    path = saved(tmp_path / "a.ply", tables(3, 3))
    data = path.read_bytes()
    data = data.replace(b"element vertex 3\n", b"element vertex 2147483647\n")
    data = data.replace(b"element chunk 1\n", b"element chunk 8388608\n")
    path.write_bytes(data.replace(b"element sh 3\n", b"element sh 2147483647\n"))
    start_tracing()
    try:
        assert refused(path).code == "ply-truncated"
        assert tracemalloc.get_traced_memory()[1] < 4_000_000
    finally:
        tracemalloc.stop()


@settings(
    deadline=None, max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.data())
def test_damaged_files_raise_only_cogsplat_errors(tmp_path: Path, data: st.DataObject) -> None:
    good = tmp_path / "good.ply"
    if not good.exists():
        saved(good, tables(260, 3))
    damaged = bytearray(good.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        # Most of the file is data; the header is where it gets interesting.
        end = data.draw(st.sampled_from([1200, len(damaged)]))
        damaged[data.draw(st.integers(0, end - 1))] = data.draw(st.integers(0, 255))
    (tmp_path / "damaged.ply").write_bytes(damaged)
    with contextlib.suppress(CogsplatError):
        read_compressed_ply(tmp_path / "damaged.ply")


def test_an_empty_scene(tmp_path: Path) -> None:
    write_compressed_ply(empty(2), tmp_path / "a.ply")
    read = read_compressed_ply(tmp_path / "a.ply")
    assert (len(read), read.sh_degree) == (0, 2)


@pytest.mark.shared
@needs_shared
def test_biker_is_the_scene_of_its_ply(tmp_path: Path) -> None:
    from scipy.spatial import cKDTree

    compressed = read_scene(SHARED / "biker" / "biker.compressed.ply")
    plain = read_ply(SHARED / "biker" / "scene.ply")
    assert len(compressed) == len(plain) == 152_746
    assert np.isposinf(compressed.opacities).sum() == np.isposinf(plain.opacities).sum() == 198

    def key(splats: Splats) -> np.ndarray:
        return np.concatenate([splats.means * 50, splats.scales * 5, splats.sh0 * 5], axis=1)

    # The two were made from one scene, each with its own order and steps.
    _, rows = cKDTree(key(plain)).query(key(compressed))
    assert len(np.unique(rows)) > 0.9999 * len(plain)
    expected = plain.take(rows)
    norm = np.linalg.norm(expected.quats, axis=1)
    dots = np.abs((compressed.quats * expected.quats).sum(axis=1)) / norm
    errors = {
        "means": (np.abs(compressed.means - expected.means), 2.0**-13 + 1e-4),
        "scales": (np.abs(compressed.scales - expected.scales), 1 / 32 + 5e-3),
        "sh0": (np.abs(compressed.sh0 - expected.sh0), 0.0131 + 7e-3),
        "opacities": (
            np.abs(unit_opacities(compressed.opacities) - unit_opacities(expected.opacities)),
            1.01 / 255,
        ),
        "degrees": (np.degrees(2 * np.arccos(np.minimum(dots, 1))), 0.5),
    }
    for name, (error, bound) in errors.items():
        assert np.quantile(error, 0.999) <= bound, name
