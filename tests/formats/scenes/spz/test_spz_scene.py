"""SPZ against a decoder written splat by splat from the format's description, and hostile files."""

from __future__ import annotations

import gzip
import math
import struct
import tracemalloc
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import zstandard
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tracing import start_tracing

from cogsplat.codec.errors import (
    CogsplatError,
    CogsplatWarning,
    DataError,
    FormatError,
    StorageError,
    TruncatedError,
    UnsupportedError,
)
from cogsplat.codec.geometry.rotations import unit
from cogsplat.codec.geometry.transforms import convert_axes
from cogsplat.codec.splats import SceneInfo, Splats
from cogsplat.formats.scenes.ply.ply_scene import read_ply
from cogsplat.formats.scenes.registry import read_scene, write_scene
from cogsplat.formats.scenes.spz.container import is_spz
from cogsplat.formats.scenes.spz.spz_scene import read_spz, write_spz

ARRAYS = ("means", "scales", "quats", "opacities", "sh0", "shN")
SHARED = Path(__file__).parents[5] / "shared" / "data"
REST = {0: 0, 1: 3, 2: 8, 3: 15, 4: 24}
# Parity of the bases above DC in y and z together, which RUB and RDF have the other way round.
# Monomials by band: y z x | xy yz zz xz xx | y xyz y z x z x
SH_SIGNS = (-1, -1, 1, -1, 1, 1, -1, 1, -1, 1, -1, -1, 1, -1, 1)
COORDINATE_SYSTEMS = (
    *("LDB", "RDB", "LUB", "RUB", "LDF", "RDF", "LUF", "RUF"),
    *("LBU", "RBU", "LFU", "RFU", "LBD", "RBD", "LFD", "RFD"),
)


def scene(count: int = 500, degree: int = 3, spread: float = 3.0) -> Splats:
    """Values within SPZ's ranges, with opacities of every size."""
    rng = np.random.default_rng(count + degree)
    opacities = rng.normal(0, 4, count)
    opacities[: min(2, count)] = [math.inf, -math.inf][: min(2, count)]
    return Splats(
        means=rng.normal(0, spread, (count, 3)).astype(np.float32),
        scales=rng.uniform(-9.9, 5.8, (count, 3)).astype(np.float32),
        quats=rng.normal(0, 2, (count, 4)).astype(np.float32),
        opacities=opacities.astype(np.float32),
        sh0=rng.uniform(-3.2, 3.2, (count, 3)).astype(np.float32),
        shN=rng.uniform(-0.9, 0.9, (count, REST[degree], 3)).astype(np.float32),
    )


def streams(count: int, version: int, degree: int) -> list[bytes]:
    """Draw any bytes, since any are legal, but for half floats, which are finite."""
    rng = np.random.default_rng([count, version, degree])
    rows = (9, 1, 3, 3, 4 if version >= 3 else 3, 3 * REST[degree])
    drawn = [rng.integers(0, 256, count * row, np.uint8).tobytes() for row in rows]
    if version == 1:
        drawn[0] = rng.normal(0, 3, count * 3).astype("<f2").tobytes()
    return drawn


def header(version: int, count: int, degree: int = 0, bits: int = 12, flags: int = 0) -> bytes:
    return struct.pack("<4sIIBBB", b"NGSP", version, count, degree, bits, flags)


def in_gzip(head: bytes, parts: list[bytes], extensions: bytes = b"") -> bytes:
    return gzip.compress(head + b"\0" + b"".join(parts) + extensions)


def in_zstd(head: bytes, parts: list[bytes], extensions: bytes = b"") -> bytes:
    full = [part for part in parts if part]
    frames = [zstandard.compress(part, 1) for part in full]
    toc = [struct.pack("<QQ", len(f), len(p)) for f, p in zip(frames, full, strict=True)]
    start = struct.pack("<BI12x", len(full), 32 + len(extensions))
    return b"".join([head, start, extensions, *toc, *frames])


def build(
    version: int,
    count: int,
    degree: int = 0,
    bits: int = 12,
    flags: int = 0,
    extensions: bytes = b"",
) -> bytes:
    head = header(version, count, degree, bits, flags)
    wrap = in_zstd if version == 4 else in_gzip
    return wrap(head, streams(count, version, degree), extensions)


def record(kind: int, payload: bytes) -> bytes:
    return struct.pack("<II", kind, len(payload)) + payload


def decoded(version: int, count: int, degree: int, bits: int) -> dict[str, np.ndarray]:
    """Decode `streams` one splat at a time, in float64, and turn the result from RUB to RDF."""
    positions, alphas, colors, scales, rotations, sh = streams(count, version, degree)
    out: dict[str, list[object]] = {name: [] for name in ARRAYS}
    rest = REST[degree]
    for k in range(count):
        if version == 1:
            x, y, z = struct.unpack_from("<3e", positions, 6 * k)
        else:
            x, y, z = (
                int.from_bytes(positions[9 * k + 3 * c :][:3], "little", signed=True) / 2**bits
                for c in range(3)
            )
        out["means"].append((x, -y, -z))
        out["scales"].append([scales[3 * k + c] / 16 - 10 for c in range(3)])
        out["sh0"].append([(colors[3 * k + c] / 255 - 0.5) / 0.15 for c in range(3)])
        alpha = alphas[k] / 255
        ends = {0.0: -math.inf, 1.0: math.inf}
        out["opacities"].append(ends[alpha] if alpha in ends else math.log(alpha / (1 - alpha)))
        if version >= 3:
            word = int.from_bytes(rotations[4 * k : 4 * k + 4], "little")
            largest, xyzw = word >> 30, [0.0] * 4
            for c in (3, 2, 1, 0):
                if c != largest:
                    xyzw[c] = (word & 511) / 511 * math.sqrt(0.5) * (-1 if word & 512 else 1)
                    word >>= 10
            xyzw[largest] = math.sqrt(max(0, 1 - sum(v * v for v in xyzw)))
        else:
            xyzw = [v / 127.5 - 1 for v in rotations[3 * k : 3 * k + 3]]
            xyzw.append(math.sqrt(max(0, 1 - sum(v * v for v in xyzw))))
        out["quats"].append((xyzw[3], xyzw[0], -xyzw[1], -xyzw[2]))
        kept = min(rest, 15)
        out["shN"].append(
            [
                [(sh[3 * (k * rest + j) + c] - 128) / 128 * SH_SIGNS[j] for c in range(3)]
                for j in range(kept)
            ]
        )
    arrays = {name: np.array(values, np.float64) for name, values in out.items()}
    # Lists of no coefficients have no channels either.
    arrays["shN"] = arrays["shN"].reshape(count, min(rest, 15), 3)
    return arrays


def refused(path: Path, data: bytes) -> CogsplatError:
    path.write_bytes(data)
    with pytest.raises(CogsplatError) as caught:
        read_spz(path)
    assert str(path) in caught.value.message
    return caught.value


@pytest.mark.parametrize("version", [1, 2, 3, 4])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("bits", [12, 17])
def test_every_version_and_degree(tmp_path: Path, version: int, degree: int, bits: int) -> None:
    path, count = tmp_path / "a.spz", 300
    path.write_bytes(build(version, count, degree, bits))
    splats = read_spz(path)
    expected = decoded(version, count, degree, bits)
    assert splats.sh_degree == degree
    assert splats.info == SceneInfo()
    for name in ARRAYS:
        actual = getattr(splats, name)
        assert actual.dtype == np.float32
        # The component that is not stored is a root, whose error grows where it is near zero.
        tolerance = {"opacities": 1e-6, "sh0": 5e-7, "quats": 1e-5}.get(name, 0)
        np.testing.assert_allclose(
            actual, expected[name], rtol=tolerance, atol=tolerance, err_msg=name
        )


@pytest.mark.parametrize("version", [3, 4])
def test_degree_4_is_cut_with_a_warning(tmp_path: Path, version: int) -> None:
    path = tmp_path / "a.spz"
    path.write_bytes(build(version, 50, 4))
    with pytest.warns(CogsplatWarning, match=r"a\.spz: SH of degree 4, expected at most 3"):
        splats = read_spz(path)
    np.testing.assert_array_equal(splats.shN, decoded(version, 50, 4, 12)["shN"])


def test_more_rows_than_a_block(tmp_path: Path) -> None:
    path, count = tmp_path / "a.spz", 70_001
    path.write_bytes(build(4, count, 1))
    splats = read_spz(path)
    positions, *_, sh = streams(count, 4, 1)
    last = int.from_bytes(positions[-9:-6], "little", signed=True) / 4096
    assert splats.means[-1, 0] == last
    signs = np.array(SH_SIGNS[:3])[:, None]
    expected = (np.frombuffer(sh, np.uint8).reshape(-1, 3, 3).astype(float) - 128) / 128 * signs
    np.testing.assert_array_equal(splats.shN, expected)


@pytest.mark.parametrize("version", [1, 4])
def test_antialiased_flag(tmp_path: Path, version: int) -> None:
    path = tmp_path / "a.spz"
    path.write_bytes(build(version, 5, flags=1))
    assert read_spz(path).info == SceneInfo(antialiased=True)


@pytest.mark.parametrize("version", [2, 4])
def test_unknown_flags_are_mentioned(tmp_path: Path, version: int) -> None:
    path = tmp_path / "a.spz"
    path.write_bytes(build(version, 5, flags=0x14))
    with pytest.warns(CogsplatWarning, match=r"a\.spz: holds flags 0x14 \(unknown\): ignored"):
        assert len(read_spz(path)) == 5


def test_unknown_flags_may_come_with_bytes(tmp_path: Path) -> None:
    path = tmp_path / "a.spz"
    path.write_bytes(build(3, 5, flags=0x10, extensions=b"whatever"))
    with pytest.warns(CogsplatWarning, match="0x10"):
        assert len(read_spz(path)) == 5
    assert refused(path, build(3, 5, extensions=b"?")).code == "spz-trailing-bytes"


@pytest.mark.parametrize("version", [3, 4])
def test_levels_of_detail_are_refused(tmp_path: Path, version: int) -> None:
    error = refused(tmp_path / "a.spz", build(version, 5, flags=0x80))
    assert isinstance(error, UnsupportedError)
    assert error.code == "spz-lod-tree"


@pytest.mark.parametrize("version", [2, 3, 4])
@pytest.mark.parametrize("number", range(1, 17))
def test_coordinate_system_extension(tmp_path: Path, version: int, number: int) -> None:
    plain, labelled = tmp_path / "a.spz", tmp_path / "b.spz"
    plain.write_bytes(build(version, 40, 3))
    extension = record(0xADBE0003, struct.pack("<I", number))
    labelled.write_bytes(build(version, 40, 3, flags=2, extensions=extension))
    # What RUB would be read as, taken back to what is stored and called by its right name.
    axes = COORDINATE_SYSTEMS[number - 1]
    stored = convert_axes(read_spz(plain), "RUB")
    expected = convert_axes(replace(stored, info=SceneInfo(axes=axes)), "RDF")
    actual = read_spz(labelled)
    assert actual.info == SceneInfo()
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(actual, name), getattr(expected, name), name)


def test_unspecified_coordinate_system_is_the_default(tmp_path: Path) -> None:
    extension = record(0xADBE0003, bytes(4))
    (tmp_path / "a.spz").write_bytes(build(4, 9))
    (tmp_path / "b.spz").write_bytes(build(4, 9, flags=2, extensions=extension))
    a, b = read_spz(tmp_path / "a.spz"), read_spz(tmp_path / "b.spz")
    np.testing.assert_array_equal(a.means, b.means)


@pytest.mark.parametrize("version", [3, 4])
def test_other_extensions_are_skipped_by_length(tmp_path: Path, version: int) -> None:
    path = tmp_path / "a.spz"
    extensions = record(0xADBE0002, bytes(12)) + record(0x12340001, b"") + record(
        0xADBE0003, struct.pack("<I", 6)
    ) + record(7, b"odd")  # fmt: skip
    path.write_bytes(build(version, 9, flags=2, extensions=extensions))
    with pytest.warns(CogsplatWarning) as caught:
        splats = read_spz(path)
    assert [str(warning.message) for warning in caught] == [
        f"{path}: holds extension 0xadbe0002 (orbit limits), extension 0x12340001 (unknown), "
        "extension 0x00000007 (unknown): ignored"
    ]
    # Number 6 is RDF, so nothing is turned.
    expected = decoded(version, 9, 0, 12)["means"] * [1, -1, -1]
    np.testing.assert_array_equal(splats.means, expected)


@pytest.mark.parametrize("version", [3, 4])
@pytest.mark.parametrize(
    ("extensions", "code"),
    [
        (b"abc", "spz-extension"),
        (record(5, b"12345")[:-1], "spz-extension"),
        (struct.pack("<II", 5, 0xFFFFFFFF), "spz-extension"),
        (record(0xADBE0003, struct.pack("<I", 17)), "spz-coordinate-system"),
        (record(0xADBE0003, b"\1"), "spz-coordinate-system"),
        (record(0xADBE0003, b""), "spz-coordinate-system"),
    ],
)
def test_broken_extensions(tmp_path: Path, version: int, extensions: bytes, code: str) -> None:
    error = refused(tmp_path / "a.spz", build(version, 3, flags=2, extensions=extensions))
    assert error.code == code


def test_half_float_nan_passes_through(tmp_path: Path) -> None:
    parts = streams(3, 1, 0)
    parts[0] = struct.pack("<9e", 1, 2, 3, math.nan, 5, 6, 7, math.inf, 9)
    # Every NaN there is, quiet or signalling.
    every = np.array([*range(0x7C01, 0x8000), *range(0xFC01, 0x10000)], "<u2")
    for nans in (parts[0], every.tobytes()):
        count = len(nans) // 6
        parts = streams(count, 1, 0)
        parts[0] = nans
        (tmp_path / "a.spz").write_bytes(in_gzip(header(1, count), parts))
        splats = read_spz(tmp_path / "a.spz")
        assert splats.invalid_rows().tolist() == [count > 3, *[True] * (count - 1)]


@pytest.mark.parametrize("version", [2, 3, 4])
@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("sh_bits", [(5, 4), (8, 8), (1, 1)])
def test_written_within_the_steps(
    tmp_path: Path, version: int, degree: int, sh_bits: tuple[int, int]
) -> None:
    splats = scene(degree=degree)
    first, rest = sh_bits
    write_spz(splats, tmp_path / "a.spz", version=version, sh1_bits=first, sh_rest_bits=rest)
    back = read_spz(tmp_path / "a.spz")
    assert back.info == splats.info

    def off(name: str) -> np.ndarray:
        return np.abs(getattr(back, name) - getattr(splats, name))

    assert off("means").max() <= 2**-13 * (1 + 1e-6)
    assert off("scales").max() <= 1 / 32 * (1 + 1e-5)
    assert off("sh0").max() <= 0.5 / 255 / 0.15 * (1 + 1e-5)
    alphas = [1 / (1 + np.exp(-s.opacities.astype(float))) for s in (back, splats)]
    assert np.abs(alphas[0] - alphas[1]).max() <= 0.5 / 255 * (1 + 1e-5)
    assert back.opacities[:2].tolist() == [math.inf, -math.inf]
    one, other = unit(back.quats), unit(splats.quats)
    other *= np.sign((one * other).sum(axis=1, keepdims=True))
    if version == 2:
        # Three components in bytes from -1 to 1; w is a root, off by most where it is 0.
        other *= np.where(other[:, :1] < 0, -1, 1)
        one = back.quats
        half_step = 0.5 / 127.5 + 1e-6
        assert np.abs(one - other)[:, 1:].max() <= half_step
        greatest = 2 * math.sqrt(3) * half_step + 3 * half_step**2
        assert np.abs(one - other)[:, 0].max() <= math.sqrt(greatest)
        assert (one[:, 0] >= 0).all()
    else:
        # The largest component is at least 1/2: three errors of half a step count at most √3 times.
        assert np.abs(one - other).max() <= 0.5 * math.sqrt(0.5) / 511 * 3
    if degree:
        # Half a step each side of a level, and at the top the missing level of 1.
        steps = np.repeat([2.0 ** (1 - first), 2.0 ** (1 - rest)], [3, REST[degree] - 3])
        limit = np.maximum(steps / 2, 1 / 128)[None, :, None]
        assert (off("shN") <= limit * (1 + 1e-5)).all()


def test_versions_hold_the_same_but_for_the_quaternions_of_2(tmp_path: Path) -> None:
    splats = replace(scene(), info=SceneInfo(antialiased=True))
    for version in (2, 3, 4):
        write_spz(splats, tmp_path / f"{version}.spz", version=version)
    second, third = (gzip.decompress((tmp_path / f"{v}.spz").read_bytes()) for v in (2, 3))
    # Header, then 9 + 1 + 3 + 3 bytes a splat before quaternions of 3 or 4, and SH behind them.
    start, count = 16 + 16 * len(splats), len(splats)
    assert (second[:8], third[:8]) == (b"NGSP\2\0\0\0", b"NGSP\3\0\0\0")
    assert (
        second[8:start] + second[start + 3 * count :] == third[8:start] + third[start + 4 * count :]
    )
    assert (tmp_path / "4.spz").read_bytes()[:8] == b"NGSP\4\0\0\0"
    three, four = (read_spz(tmp_path / f"{version}.spz") for version in (3, 4))
    assert three.info == four.info == splats.info
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(three, name), getattr(four, name), name)


@pytest.mark.parametrize("version", [2, 3, 4])
def test_same_bytes_every_time(tmp_path: Path, version: int) -> None:
    a, b = tmp_path / "a.spz", tmp_path / "b.spz"
    write_spz(scene(), a, version=version)
    write_spz(scene(), b, version=version)
    assert a.read_bytes() == b.read_bytes()


def test_a_second_round_trip_is_lossless(tmp_path: Path) -> None:
    write_spz(scene(), tmp_path / "a.spz")
    once = read_spz(tmp_path / "a.spz")
    write_spz(once, tmp_path / "b.spz")
    twice = read_spz(tmp_path / "b.spz")
    for name in ("means", "scales", "opacities", "sh0", "shN"):
        np.testing.assert_array_equal(getattr(twice, name), getattr(once, name), name)
    # Where two components are nearly the same, either may be the one left out.
    turn = np.abs((unit(once.quats).astype(float) * unit(twice.quats)).sum(axis=1))
    assert turn.min() > 1 - 1e-5


@pytest.mark.parametrize("degree", [0, 3])
@pytest.mark.parametrize("version", [2, 3, 4])
@pytest.mark.parametrize("count", [0, 1])
def test_small_scenes(tmp_path: Path, count: int, version: int, degree: int) -> None:
    write_spz(scene(count, degree), tmp_path / "a.spz", version=version)
    back = read_spz(tmp_path / "a.spz")
    assert (len(back), back.sh_degree) == (count, degree)


def test_other_axes_are_stored_alike(tmp_path: Path) -> None:
    splats = scene()
    write_spz(splats, tmp_path / "a.spz")
    write_spz(convert_axes(splats, "LUF"), tmp_path / "b.spz")
    assert (tmp_path / "a.spz").read_bytes() == (tmp_path / "b.spz").read_bytes()


@pytest.mark.parametrize(
    ("spread", "bits"), [(3.0, 12), (1.1, 12), (0.01, 19), (1e-9, 24), (1e4, 9), (1e6, 3)]
)
def test_fractional_bits_follow_the_extent(tmp_path: Path, spread: float, bits: int) -> None:
    splats = scene(1000, 0)
    means = np.random.default_rng(0).uniform(-spread, spread, (1000, 3)).astype(np.float32)
    means[0] = spread
    write_spz(replace(splats, means=means), tmp_path / "a.spz")
    chosen = (tmp_path / "a.spz").read_bytes()[13]
    assert chosen == bits
    error = np.abs(read_spz(tmp_path / "a.spz").means - means).max()
    assert error <= 2.0 ** -(chosen + 1) * 1.001


@pytest.mark.parametrize(("spread", "bits"), [(3.0, 12), (0.01, 12), (1e4, 9)])
def test_the_usual_precision_is_that_of_other_programs(
    tmp_path: Path, spread: float, bits: int
) -> None:
    """The reference writes 12 fractional bits; where the farthest mean would not fit, fewer."""
    splats = scene(1000, 0)
    means = np.random.default_rng(0).uniform(-spread, spread, (1000, 3)).astype(np.float32)
    means[0] = spread
    splats = replace(splats, means=means)
    for precision in ("usual", "fine"):
        write_spz(splats, tmp_path / f"{precision}.spz", precision=precision)
    usual, fine = (tmp_path / f"{name}.spz" for name in ("usual", "fine"))
    assert usual.read_bytes()[13] == bits
    assert usual.stat().st_size <= fine.stat().st_size
    with pytest.raises(ValueError, match="precision 'low', expected one of"):
        write_spz(splats, tmp_path / "low.spz", precision="low")


def test_dropped_values_give_one_warning(tmp_path: Path) -> None:
    info = SceneInfo(origin=(1.0, 2.0, 3.0), colour_space="linear", kernel_px=0.1)
    splats = replace(scene(100), info=info)
    splats.means[3] = 1e9
    splats.scales[:5, 0] = -20.0
    with pytest.warns(CogsplatWarning) as caught:
        write_spz(splats, tmp_path / "a.spz")
    assert [str(warning.message) for warning in caught] == [
        f"{tmp_path / 'a.spz'}: SPZ cannot hold the origin (1.0, 2.0, 3.0), the colour space "
        "linear, the kernel of 0.1 px², 1 % of the means (out of range, clipped), 1.7 % of the "
        "scales (out of range, clipped)"
    ]
    assert read_spz(tmp_path / "a.spz").scales.min() == -10.0


def test_rows_that_cannot_be_drawn_are_not_written(tmp_path: Path) -> None:
    splats = scene(10)
    splats.scales[4, 1] = np.nan
    with pytest.raises(DataError) as caught:
        write_spz(splats, tmp_path / "a.spz")
    assert caught.value.code == "invalid-rows"
    assert list(tmp_path.iterdir()) == []


def test_misuse(tmp_path: Path) -> None:
    for version in (1, 5):
        with pytest.raises(ValueError, match=r"expected one of \(2, 3, 4\)"):
            write_spz(scene(1), tmp_path / "a.spz", version=version)
    for bits in (0, 9):
        with pytest.raises(ValueError, match="expected 1 to 8"):
            write_spz(scene(1), tmp_path / "a.spz", sh1_bits=bits)
        with pytest.raises(ValueError, match="expected 1 to 8"):
            write_spz(scene(1), tmp_path / "a.spz", sh_rest_bits=bits)


def test_found_by_first_bytes(tmp_path: Path) -> None:
    write_scene(scene(3), tmp_path / "a.spz")
    write_spz(scene(4), tmp_path / "b.ply", version=3)
    assert len(read_scene(tmp_path / "a.spz")) == 3
    assert len(read_scene(tmp_path / "b.ply")) == 4
    with pytest.raises(StorageError) as caught:
        write_spz(scene(1), tmp_path / "a.spz")
    assert caught.value.code == "exists"
    assert not is_spz(b"")
    assert not is_spz(gzip.compress(b"something else entirely"))
    assert not is_spz(b"\x1f\x8b\x08 broken")


# Format and offset of what `v4` replaces: fields of the header, and the first entry of the table.
FIELDS = {
    "version": ("<I", 4),
    "count": ("<I", 8),
    "degree": ("<B", 12),
    "bits": ("<B", 13),
    "num_streams": ("<B", 15),
    "toc": ("<I", 16),
    "stored": ("<Q", 32),
    "raw": ("<Q", 40),
}


def v4(**changes: int) -> bytes:
    """Return a version 4 file of 6 splats, SH 0, with fields replaced."""
    data = bytearray(build(4, 6))
    for name, value in changes.items():
        layout, at = FIELDS[name]
        struct.pack_into(layout, data, at, value)
    return bytes(data)


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"version": 0}, "spz-version"),
        ({"version": 3}, "spz-version"),
        ({"version": 5}, "spz-version"),
        ({"count": 7}, "spz-toc"),
        ({"count": 0}, "spz-toc"),
        ({"count": 0xFFFFFFFF}, "spz-toc"),
        ({"degree": 1}, "spz-toc"),
        ({"degree": 5}, "spz-bad-sh"),
        ({"bits": 31}, "spz-fractional-bits"),
        ({"num_streams": 4}, "spz-toc"),
        ({"num_streams": 0}, "spz-toc"),
        ({"num_streams": 255}, "spz-toc"),
        ({"toc": 0}, "spz-toc"),
        ({"toc": 31}, "spz-toc"),
        ({"toc": 0xFFFFFFFF}, "spz-truncated"),
        ({"stored": 0}, "spz-trailing-bytes"),
        ({"stored": 2**64 - 1}, "spz-truncated"),
        ({"raw": 55}, "spz-toc"),
        ({"raw": 2**64 - 1}, "spz-toc"),
    ],
)
def test_headers_that_lie(tmp_path: Path, changes: dict[str, int], code: str) -> None:
    assert refused(tmp_path / "a.spz", v4(**changes)).code == code


def frames(positions: bytes) -> bytes:
    """Return a version 4 file of 6 splats with this stored for positions."""
    rest = [zstandard.compress(part) for part in streams(6, 4, 0)[1:5]]
    sizes = [(len(positions), 54), *zip(map(len, rest), (6, 18, 18, 24), strict=True)]
    toc = b"".join(struct.pack("<QQ", *size) for size in sizes)
    head = header(4, 6) + struct.pack("<BI12x", 5, 32)
    return b"".join([head, toc, positions, *rest])


def test_frames_that_lie(tmp_path: Path) -> None:
    path, raw = tmp_path / "a.spz", streams(6, 4, 0)[0]
    good = zstandard.compress(raw)
    unsized = zstandard.ZstdCompressor(write_content_size=False).compress(raw)
    summed = zstandard.ZstdCompressor(write_checksum=True).compress(raw)
    for frame in (good, unsized, summed):
        path.write_bytes(frames(frame))
        assert len(read_spz(path)) == 6
    longer = zstandard.ZstdCompressor(write_content_size=False).compress(raw + b"?")
    shorter = zstandard.ZstdCompressor(write_content_size=False).compress(raw[:-1])
    skippable = struct.pack("<II", 0x184D2A50, 3) + b"abc" + good
    damaged = summed[:-1] + bytes([summed[-1] ^ 1])
    bad = [b"", b"abc", b"\0" * 40, good[:-1], good[:5], good + b"?", good + good, longer, shorter,
           skippable, damaged, zstandard.compress(raw + b"?"), zstandard.compress(b"")]  # fmt: skip
    for frame in bad:
        assert refused(path, frames(frame)).code == "spz-zstd"


def test_gzip_that_lies(tmp_path: Path) -> None:
    path, good = tmp_path / "a.spz", build(3, 6)
    crc = bytearray(good)
    crc[-6] ^= 1
    deflate = bytearray(good)
    deflate[10] ^= 0xFF
    assert refused(path, bytes(crc)).code == "spz-gzip"
    assert refused(path, bytes(deflate)).code in ("spz-gzip", "spz-magic", "spz-truncated")
    assert refused(path, good + b"?").code == "spz-trailing-bytes"
    assert refused(path, good + good).code == "spz-trailing-bytes"
    assert refused(path, build(4, 6)[:4] + good).code == "spz-version"
    assert refused(path, gzip.compress(b"NGSP" + bytes(12))).code == "spz-version"
    assert refused(path, gzip.compress(build(4, 6))).code == "spz-version"
    assert refused(path, gzip.compress(b"")).code == "spz-truncated"
    assert refused(path, gzip.compress(bytes(64))).code == "spz-magic"
    short = in_gzip(header(3, 7), streams(6, 3, 0))
    assert refused(path, short).code == "spz-truncated"
    long = in_gzip(header(3, 5), streams(6, 3, 0))
    assert refused(path, long).code == "spz-trailing-bytes"


@pytest.mark.parametrize("version", [2, 3, 4])
def test_cut_short_anywhere(tmp_path: Path, version: int) -> None:
    data = build(version, 30, 1)
    for length in range(0, len(data), 7):
        error = refused(tmp_path / "a.spz", data[:length])
        assert isinstance(error, TruncatedError), length
        assert error.code == "spz-truncated"
        if version == 4 and length > 32:
            assert length < error.needed <= len(data)


@pytest.mark.parametrize("data", [b"ply\n", b"PK\3\4", b"\0" * 100, b"<html>", b"NGSX"])
def test_other_files(tmp_path: Path, data: bytes) -> None:
    error = refused(tmp_path / "a.spz", data)
    assert isinstance(error, FormatError)
    assert error.code == "spz-magic"


def test_no_memory_for_counts_the_file_does_not_bear_out(tmp_path: Path) -> None:
    count = 4_000_000
    zeros = [bytes(count * row) for row in (9, 1, 3, 3, 4)]
    bombs = {
        "spz-truncated": [
            in_gzip(header(3, 0xFFFFFFFF, 3), streams(6, 3, 3)),
            in_gzip(header(3, 1000, 3), streams(6, 3, 3)),
        ],
        "spz-trailing-bytes": [gzip.compress(header(3, 6) + bytes(100_000_000))],
        "decoded-size": [in_zstd(header(4, count), zeros)],
        "spz-zstd": [frames(zstandard.compress(bytes(100_000_000)))],
    }
    del zeros
    for code, files in bombs.items():
        for data in files:
            (tmp_path / "a.spz").write_bytes(data)
            start_tracing()
            try:
                with pytest.raises(CogsplatError) as caught:
                    read_spz(tmp_path / "a.spz")
                _, peak = tracemalloc.get_traced_memory()
            finally:
                tracemalloc.stop()
            assert caught.value.code == code
            assert peak < 8_000_000 + 4 * len(data), code


@settings(
    max_examples=150,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    version=st.integers(1, 4),
    unwrapped=st.booleans(),
    flips=st.lists(st.tuples(st.integers(0, 2000), st.integers(1, 255)), min_size=1, max_size=4),
)
def test_flipped_bytes_raise_only_cogsplat_errors(
    tmp_path: Path, version: int, unwrapped: bool, flips: list[tuple[int, int]]
) -> None:
    extension = record(0xADBE0003, struct.pack("<I", 13))
    data = bytearray(build(version, 8, 1, flags=2, extensions=extension))
    # Inside the gzip member, where its checksum does not catch everything.
    inside = unwrapped and version < 4
    if inside:
        data = bytearray(gzip.decompress(data))
    for at, change in flips:
        data[at % len(data)] ^= change
    path = tmp_path / "a.spz"
    path.write_bytes(gzip.compress(data) if inside else data)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CogsplatWarning)
        try:
            splats = read_spz(path)
        except CogsplatError:
            return
    assert len(splats) == 8


@pytest.mark.shared
@pytest.mark.skipif(not SHARED.is_dir(), reason="the real scenes are not here")
def test_biker_equals_its_ply(tmp_path: Path) -> None:
    # Its PLY was made from this file by another implementation.
    splats, expected = read_spz(SHARED / "biker/biker.spz"), read_ply(SHARED / "biker/scene.ply")
    np.testing.assert_array_equal(splats.means, expected.means)
    np.testing.assert_array_equal(splats.scales, expected.scales)
    assert np.isposinf(splats.opacities).sum() == 198
    np.testing.assert_allclose(splats.opacities, expected.opacities, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(splats.sh0, expected.sh0, rtol=0, atol=1e-6)
    quats = unit(expected.quats)
    quats *= np.sign((splats.quats * quats).sum(axis=1, keepdims=True))
    np.testing.assert_allclose(splats.quats, quats, rtol=0, atol=1e-6)
    write_spz(splats, tmp_path / "a.spz")
    again = read_spz(tmp_path / "a.spz")
    for name in ("means", "scales", "opacities", "sh0"):
        np.testing.assert_array_equal(getattr(again, name), getattr(splats, name), name)


@pytest.mark.parametrize("threads", ["1", "4"])
def test_results_do_not_depend_on_the_number_of_threads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, threads: str
) -> None:
    module = "cogsplat.formats.scenes.spz."
    for name in ("container", "spz_values"):
        monkeypatch.setattr(f"{module}{name}.thread_count", lambda _: int(threads))
    splats = scene(40_000, 1)
    write_spz(splats, tmp_path / "a.spz")
    monkeypatch.undo()
    write_spz(splats, tmp_path / "b.spz")
    assert (tmp_path / "a.spz").read_bytes() == (tmp_path / "b.spz").read_bytes()


def test_empty_scene_of_many_streams(tmp_path: Path) -> None:
    # Writers may list streams of no bytes, or none.
    for data in (in_zstd(header(4, 0, 3), [b""] * 6), _listed_but_empty()):
        (tmp_path / "a.spz").write_bytes(data)
        assert len(read_spz(tmp_path / "a.spz")) == 0


def _listed_but_empty() -> bytes:
    frame = zstandard.compress(b"")
    toc = struct.pack("<QQ", len(frame), 0) * 6
    return header(4, 0, 3) + struct.pack("<BI12x", 6, 32) + toc + frame * 6
