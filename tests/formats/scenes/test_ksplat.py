"""Files laid out here, value by value, from the format's description."""

from __future__ import annotations

import math
import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from tracing import start_tracing

from cogsplat.codec.errors import CogsplatError, FormatError, TruncatedError, UnsupportedError
from cogsplat.codec.splats import SceneInfo
from cogsplat.formats.scenes.ksplat import read_ksplat
from cogsplat.formats.scenes.registry import read_scene, write_scene

Rows = list[dict[str, list[float]]]

REST = (0, 9, 24)
LOW, HIGH = -0.75, 1.25
BLOCK = 5.0
RANGE = 32767


def rows(count: int, degree: int, seed: int) -> Rows:
    """Values that level 0 holds exactly; sh is by coefficient, then channel."""
    rng = np.random.default_rng([seed, count, degree])
    return [
        {
            "means": rng.uniform(-2, 2, 3).astype(np.float32).tolist(),
            "scales": rng.uniform(0.01, 2, 3).astype(np.float16).tolist(),
            "quats": rng.normal(0, 0.5, 4).astype(np.float16).tolist(),
            "rgba": rng.integers(0, 256, 4).tolist(),
            "sh": rng.uniform(LOW, HIGH, REST[degree]).astype(np.float16).tolist(),
        }
        for _ in range(count)
    ]


def stored_sh(values: list[float]) -> list[float]:
    """Order coefficients as files do: by band, and in a band by channel."""
    out = []
    for first, last in ((0, 3), (3, 8)):
        if 3 * last <= len(values):
            out += [values[3 * k + c] for c in range(3) for k in range(first, last)]
    return out


def splat_bytes(row: dict[str, list[float]], level: int, centre: tuple[float, ...]) -> bytes:
    sh = stored_sh(row["sh"])
    rgba = struct.pack("<4B", *row["rgba"])
    if level == 0:
        numbers = [*row["means"], *row["scales"], *row["quats"]]
        return struct.pack("<10f", *numbers) + rgba + struct.pack(f"<{len(sh)}f", *sh)
    steps = [
        round((v - c) / (BLOCK / 2) * RANGE) + RANGE
        for v, c in zip(row["means"], centre, strict=True)
    ]
    out = struct.pack("<3H7e", *steps, *row["scales"], *row["quats"]) + rgba
    if level == 1:
        return out + struct.pack(f"<{len(sh)}e", *sh)
    return out + bytes(round((v - LOW) / (HIGH - LOW) * 255) for v in sh)


def section(
    splats: Rows, level: int, degree: int, room: int = 0, bucket: int = 4
) -> tuple[bytes, bytes]:
    """Return the header and the bytes of a section: full buckets of `bucket`, then ones and rest.

    Buckets have centres of their own, all within reach of every splat.
    """
    count = len(splats)
    full = count // bucket
    left = count - full * bucket
    partial = [] if not left else [1, 0, left - 1] if left > 1 else [1]
    sizes = [bucket] * full + partial
    centres = [(0.04 * k, -0.02 * k, 0.01 * k) for k in range(len(sizes))]
    of_splat = [centre for centre, size in zip(centres, sizes, strict=True) for _ in range(size)]
    body = b"".join(
        splat_bytes(row, level, centre) for row, centre in zip(splats, of_splat, strict=True)
    )
    stride = len(splat_bytes(rows(1, degree, 0)[0], level, (0, 0, 0)))
    body += bytes(stride * room)
    if level:
        table = struct.pack(f"<{len(partial)}I", *partial)
        table += b"".join(struct.pack("<3f", *centre) for centre in centres)
        body = table + body
        fields = (bucket, len(sizes), BLOCK, 12, RANGE, len(body), full, len(partial))
    else:
        fields = (0, 0, 0.0, 0, 0, len(body), 0, 0)
    head = struct.pack("<IIIIfHxxIIIIH", count, count + room, *fields, degree)
    return head.ljust(1024, b"\0"), body


def header(count: int, sections: int, level: int, sh: tuple[float, float] = (LOW, HIGH)) -> bytes:
    out = struct.pack("<BBxxIIIIHxx", 0, 1, sections, sections, count, count, level)
    return (out + struct.pack("<3f2f", 1, 2, 3, *sh)).ljust(4096, b"\0")


def build(level: int, *parts: tuple[bytes, bytes]) -> bytes:
    count = sum(struct.unpack_from("<I", head)[0] for head, _ in parts)
    heads, bodies = zip(*parts, strict=True)
    return b"".join([header(count, len(parts), level), *heads, *bodies])


def refused(path: Path, data: bytes) -> CogsplatError:
    path.write_bytes(data)
    with pytest.raises(CogsplatError) as caught:
        read_ksplat(path)
    assert str(path) in caught.value.message
    return caught.value


@pytest.mark.parametrize("level", [0, 1, 2])
@pytest.mark.parametrize("degree", [0, 1, 2])
@pytest.mark.parametrize("count", [0, 1, 4, 11])
def test_every_level_and_degree(tmp_path: Path, level: int, degree: int, count: int) -> None:
    check(tmp_path, level, degree, count)


def test_more_rows_than_a_block(tmp_path: Path) -> None:
    check(tmp_path, 2, 1, 17_000)


def check(tmp_path: Path, level: int, degree: int, count: int) -> None:
    path, given_rows = tmp_path / "a.ksplat", rows(count, degree, 1)
    # More buckets than a few would put their centres out of a splat's reach.
    path.write_bytes(build(level, section(given_rows, level, degree, bucket=max(4, count // 8))))
    splats = read_ksplat(path)
    assert splats.info == SceneInfo()
    assert len(splats) == count
    assert splats.sh_degree == (degree if count else 0)

    def given_values(name: str, width: int) -> np.ndarray:
        return np.array([row[name] for row in given_rows], np.float64).reshape(count, width)

    np.testing.assert_allclose(
        splats.means,
        given_values("means", 3),
        rtol=0,
        atol=BLOCK / RANGE / 4 + 1e-6 if level else 0,
    )
    np.testing.assert_allclose(splats.scales, np.log(given_values("scales", 3)), atol=1e-6)
    np.testing.assert_array_equal(splats.quats, given_values("quats", 4))
    rgba = given_values("rgba", 4) / 255
    np.testing.assert_allclose(splats.sh0 * 0.28209479177387814 + 0.5, rgba[:, :3], atol=1e-6)
    alphas = 1 / (1 + np.exp(-splats.opacities.astype(float)))
    np.testing.assert_allclose(alphas, rgba[:, 3], atol=1e-6)
    if count:
        step = (HIGH - LOW) / 255
        sh = given_values("sh", REST[degree]).reshape(count, -1, 3)
        np.testing.assert_allclose(
            splats.shN, sh, rtol=0, atol=step / 2 + 1e-6 if level == 2 else 0
        )


@pytest.mark.parametrize("level", [0, 1, 2])
def test_sections_with_room_and_of_different_degrees(tmp_path: Path, level: int) -> None:
    first, second, third = rows(7, 1, 1), rows(5, 2, 2), rows(6, 0, 3)
    data = build(
        level,
        section(first, level, 1, room=3),
        section([], level, 2, room=2),
        section(second, level, 2),
        section(third, level, 0, room=1),
    )
    (tmp_path / "a.ksplat").write_bytes(data)
    splats = read_ksplat(tmp_path / "a.ksplat")
    assert splats.sh_degree == 2
    expected = [row["means"] for row in (*first, *second, *third)]
    np.testing.assert_allclose(splats.means, expected, rtol=0, atol=1e-4)
    assert not splats.shN[:7, 3:].any()
    assert splats.shN[:7, :3].any()
    assert splats.shN[7:12].all(axis=(1, 2)).all() or level == 2
    assert not splats.shN[12:].any()


def test_fields_that_older_writers_left_empty(tmp_path: Path) -> None:
    given_rows = rows(5, 1, 4)
    head, body = section(given_rows, 2, 1)
    no_range = head[:24] + bytes(4) + head[28:]
    data = header(5, 1, 2, (0.0, 0.0)) + no_range + body
    (tmp_path / "a.ksplat").write_bytes(data)
    splats = read_ksplat(tmp_path / "a.ksplat")
    np.testing.assert_allclose(splats.means, [r["means"] for r in given_rows], rtol=0, atol=1e-4)
    sh = np.array([row["sh"] for row in given_rows]).reshape(5, 3, 3)
    levels = np.rint((sh - LOW) / (HIGH - LOW) * 255)
    np.testing.assert_allclose(splats.shN, levels / 255 * 3 - 1.5, rtol=0, atol=1e-6)


@pytest.mark.parametrize(("level", "flat"), [(0, -150), (1, -25), (2, -25)])
def test_flat_splats_and_bad_numbers(tmp_path: Path, level: int, flat: int) -> None:
    given_rows = rows(4, 0, 5)
    given_rows[0]["scales"][1] = 0.0
    given_rows[1]["scales"][2] = -1.0
    given_rows[2]["quats"][2] = math.nan
    given_rows[3]["rgba"][3] = 255
    (tmp_path / "a.ksplat").write_bytes(build(level, section(given_rows, level, 0)))
    splats = read_ksplat(tmp_path / "a.ksplat")
    assert splats.invalid_rows().tolist() == [False, True, True, False]
    np.testing.assert_allclose(splats.scales[0, 1], flat * math.log(2), rtol=1e-6)
    assert splats.opacities[3] == math.inf


@pytest.mark.parametrize("level", [0, 1, 2])
def test_signalling_nan_passes_through(tmp_path: Path, level: int) -> None:
    head, body = section(rows(1, 1, 5), level, 1)
    stride = len(splat_bytes(rows(1, 1, 0)[0], level, (0, 0, 0)))
    nan = b"\1\x7c" if level else b"\1\0\x80\x7f"
    numbers = body[:-stride] + (nan * stride)[:stride]
    (tmp_path / "a.ksplat").write_bytes(build(level, (head, numbers)))
    assert read_ksplat(tmp_path / "a.ksplat").invalid_rows().tolist() == [True]


def test_found_by_extension_and_not_written(tmp_path: Path) -> None:
    (tmp_path / "a.KSPLAT").write_bytes(build(1, section(rows(3, 0, 6), 1, 0)))
    splats = read_scene(tmp_path / "a.KSPLAT")
    assert len(splats) == 3
    with pytest.raises(UnsupportedError) as caught:
        write_scene(splats, tmp_path / "b.ksplat")
    assert caught.value.code == "read-only-format"


def with_field(data: bytes, layout: str, at: int, value: float) -> bytes:
    out = bytearray(data)
    struct.pack_into(layout, out, at, value)
    return bytes(out)


@pytest.mark.parametrize(
    ("layout", "at", "value", "code"),
    [
        ("<B", 0, 1, "ksplat-version"),
        ("<B", 1, 0, "ksplat-version"),
        ("<I", 4, 2, "ksplat-truncated"),
        ("<I", 4, 0, "ksplat-trailing-bytes"),
        ("<I", 4, 0xFFFFFFFF, "ksplat-truncated"),
        ("<I", 16, 10, "ksplat-count"),
        ("<I", 16, 0xFFFFFFFF, "ksplat-count"),
        ("<H", 20, 3, "ksplat-level"),
        ("<H", 20, 0, "ksplat-truncated"),
        ("<I", 4096, 12, "ksplat-count"),
        ("<I", 4100, 12, "ksplat-truncated"),
        ("<I", 4100, 0xFFFFFFFF, "ksplat-truncated"),
        ("<I", 4104, 3, "ksplat-buckets"),
        ("<I", 4108, 0xFFFFFFFF, "ksplat-truncated"),
        ("<I", 4108, 4, "ksplat-buckets"),
        ("<H", 4116, 11, "ksplat-buckets"),
        ("<I", 4128, 0xFFFFFFFF, "ksplat-buckets"),
        ("<I", 4132, 4, "ksplat-buckets"),
        ("<H", 4136, 2, "ksplat-truncated"),
        ("<H", 4136, 3, "ksplat-bad-sh"),
        ("<I", 5120 + 8, 1, "ksplat-buckets"),
    ],
)
def test_headers_that_lie(tmp_path: Path, layout: str, at: int, value: int, code: str) -> None:
    # Two full buckets of four and three partial ones of 1, 0 and 2.
    good = build(1, section(rows(11, 1, 7), 1, 1))
    error = refused(tmp_path / "a.ksplat", with_field(good, layout, at, value))
    assert error.code == code


@pytest.mark.parametrize("level", [0, 1, 2])
def test_cut_short_anywhere(tmp_path: Path, level: int) -> None:
    data = build(level, section(rows(5, 1, 8), level, 1), section(rows(3, 0, 9), level, 0))
    for length in [*range(0, len(data), 97), len(data) - 1]:
        error = refused(tmp_path / "a.ksplat", data[:length])
        assert isinstance(error, TruncatedError)
        assert length < error.needed <= len(data)
    assert refused(tmp_path / "a.ksplat", data + b"?").code == "ksplat-trailing-bytes"


@pytest.mark.parametrize("head", [b"<html>", b"ply\n", b"\1\1", b"PK\3\4"])
def test_other_files(tmp_path: Path, head: bytes) -> None:
    error = refused(tmp_path / "a.ksplat", head.ljust(6000, b" "))
    assert isinstance(error, UnsupportedError | FormatError)
    assert "expected 0.1" in error.message


def test_no_memory_for_counts_the_file_does_not_bear_out(tmp_path: Path) -> None:
    data = build(1, section(rows(11, 0, 7), 1, 0))
    for at in (4, 16, 4096, 4100, 4104, 4108, 4128, 4132):
        lying = with_field(data, "<I", at, 0x7FFFFFF0)
        (tmp_path / "a.ksplat").write_bytes(lying)
        start_tracing()
        try:
            # Buckets of any size are fine: there may be room in them.
            if at == 4104:
                assert len(read_ksplat(tmp_path / "a.ksplat")) == 11
            else:
                with pytest.raises(CogsplatError):
                    read_ksplat(tmp_path / "a.ksplat")
            _, peak = tracemalloc.get_traced_memory()
        finally:
            tracemalloc.stop()
        assert peak < 500_000


@settings(
    max_examples=150,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    level=st.integers(0, 2),
    flips=st.lists(
        st.tuples(
            # Where something is stored: fields of the headers, and the sections.
            st.one_of(st.integers(0, 44), st.integers(4096, 4138), st.integers(6144, 7000)),
            st.integers(1, 255),
        ),
        min_size=1,
        max_size=4,
    ),
)
def test_flipped_bytes_raise_only_cogsplat_errors(
    tmp_path: Path, level: int, flips: list[tuple[int, int]]
) -> None:
    parts = [section(rows(6, 2, seed), level, 2) for seed in (1, 2)]
    data = bytearray(build(level, *parts))
    for at, change in flips:
        data[at % len(data)] ^= change
    (tmp_path / "a.ksplat").write_bytes(data)
    try:
        splats = read_ksplat(tmp_path / "a.ksplat")
    except CogsplatError:
        return
    assert len(splats) <= 12
