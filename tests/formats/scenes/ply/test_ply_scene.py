from __future__ import annotations

import importlib
import io
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
    StorageError,
    TruncatedError,
    UnsupportedError,
)
from cogsplat.codec.splats import SceneInfo, Splats
from cogsplat.formats.scenes.ply import foreign_layouts
from cogsplat.formats.scenes.ply import header as ply_header
from cogsplat.formats.scenes.ply import ply_scene as ply
from cogsplat.formats.scenes.ply.header import MAX_COUNT, MAX_HEADER_BYTES, parse_header
from cogsplat.formats.scenes.ply.ply_scene import read_ply, write_ply

ARRAYS = ("means", "scales", "quats", "opacities", "sh0", "shN")
RESTS = (0, 3, 8, 15)
SHARED = Path(__file__).parents[5] / "shared" / "data"
needs_shared = pytest.mark.skipif(not SHARED.is_dir(), reason="the real scenes are not here")


def assert_same(actual: Splats, expected: Splats) -> None:
    for name in ARRAYS:
        np.testing.assert_array_equal(getattr(actual, name), getattr(expected, name), name)
        assert getattr(actual, name).dtype == np.float32
        assert getattr(actual, name).flags.c_contiguous
    assert actual.info == expected.info


def rows(splats: Splats, dtype: str = "f4", order: list[str] | None = None) -> np.ndarray:
    """Write out the splats as a structured array, one name at a time."""
    rest = splats.shN.shape[1]
    named = {"x": splats.means[:, 0], "y": splats.means[:, 1], "z": splats.means[:, 2]}
    named["opacity"] = splats.opacities
    for c in range(3):
        named[f"f_dc_{c}"] = splats.sh0[:, c]
        named[f"scale_{c}"] = splats.scales[:, c]
        for k in range(rest):
            named[f"f_rest_{c * rest + k}"] = splats.shN[:, k, c]
    for k in range(4):
        named[f"rot_{k}"] = splats.quats[:, k]
    names = order or list(named)
    table = np.empty(len(splats), [(name, dtype) for name in names])
    for name in names:
        table[name] = named[name]
    return table


def vertex(splats: Splats, dtype: str = "f4") -> plyfile.PlyElement:
    return plyfile.PlyElement.describe(rows(splats, dtype), "vertex")


def faces(count: int = 3) -> plyfile.PlyElement:
    table = np.empty(count, [("vertex_indices", "O"), ("flag", "u1")])
    for k in range(count):
        table["vertex_indices"][k] = np.arange(k + 2, dtype="i4")
    table["flag"] = 1
    return plyfile.PlyElement.describe(table, "face")


def header_of(*lines: str) -> bytes:
    return "\n".join(["ply", *lines, "end_header\n"]).encode()


def properties(skip: str = "", rest: int = 0) -> list[str]:
    names = [*"xyz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"]
    names += [f"rot_{k}" for k in range(4)] + [f"f_rest_{k}" for k in range(rest)]
    return [f"property float {name}" for name in names if name != skip]


LITTLE = "format binary_little_endian 1.0"


def refused(path: Path, data: bytes) -> CogsplatError:
    path.write_bytes(data)
    with pytest.raises(CogsplatError) as caught:
        read_ply(path)
    assert str(path) in caught.value.message
    assert "expected" in caught.value.message or "no " in caught.value.message
    return caught.value


@pytest.mark.parametrize("rest", RESTS)
@pytest.mark.parametrize("count", [0, 1, 7, 3000])
def test_round_trip(tmp_path: Path, count: int, rest: int) -> None:
    splats = random_splats(count, rest)
    write_ply(splats, tmp_path / "a.ply")
    assert_same(read_ply(tmp_path / "a.ply"), splats)
    write_ply(splats, tmp_path / "b.ply")
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()


@pytest.mark.parametrize("rest", RESTS)
def test_plyfile_reads_what_we_write(tmp_path: Path, rest: int) -> None:
    splats = random_splats(2500, rest)
    write_ply(splats, tmp_path / "a.ply")
    table = plyfile.PlyData.read(tmp_path / "a.ply")["vertex"].data
    expected = rows(splats)
    for name in expected.dtype.names:
        np.testing.assert_array_equal(table[name], expected[name], name)
    names = list(table.dtype.names)
    assert names[:7] == ["x", "y", "z", "nx", "ny", "nz", "f_dc_0"]
    assert names[-8:-4] == ["opacity", "scale_0", "scale_1", "scale_2"]
    for name in ("nx", "ny", "nz"):
        assert not table[name].any()


@pytest.mark.parametrize("rest", RESTS)
def test_reads_properties_in_any_order(tmp_path: Path, rest: int) -> None:
    splats = random_splats(1000, rest)
    order = list(rows(splats).dtype.names)
    np.random.default_rng(5).shuffle(order)
    element = plyfile.PlyElement.describe(rows(splats, order=order), "vertex")
    plyfile.PlyData([element], byte_order="<").write(tmp_path / "a.ply")
    assert_same(read_ply(tmp_path / "a.ply"), splats)


@pytest.mark.parametrize("layout", ["text", "big", "double", "first", "behind", "text-first"])
@pytest.mark.parametrize("count", [0, 1, 40])
def test_reads_what_plyfile_writes(tmp_path: Path, layout: str, count: int) -> None:
    splats = random_splats(count, 3)
    elements = [vertex(splats, "f8" if layout == "double" else "f4")]
    if layout.endswith("first"):
        elements.insert(0, faces())
    if layout == "behind":
        elements.append(faces())
    text = layout.startswith("text")
    order = "=" if text else ">" if layout == "big" else "<"
    plyfile.PlyData(elements, text=text, byte_order=order).write(tmp_path / "a.ply")
    assert_same(read_ply(tmp_path / "a.ply"), splats)


def test_reads_fixed_elements_before_and_after(tmp_path: Path) -> None:
    splats = random_splats(20, 0)
    other = plyfile.PlyElement.describe(np.zeros(5, [("a", "u1"), ("b", "f8")]), "other")
    for elements in ([other, vertex(splats)], [vertex(splats), other]):
        plyfile.PlyData(elements, byte_order="<").write(tmp_path / "a.ply")
        assert_same(read_ply(tmp_path / "a.ply"), splats)


def test_skips_properties_that_are_no_floats(tmp_path: Path) -> None:
    splats = random_splats(20, 0)
    table = rows(splats)
    wider = np.zeros(20, [*table.dtype.descr, ("red", "u1"), ("label", "i4")])
    for name in table.dtype.names:
        wider[name] = table[name]
    element = plyfile.PlyElement.describe(wider, "vertex")
    plyfile.PlyData([element], byte_order="<").write(tmp_path / "a.ply")
    assert_same(read_ply(tmp_path / "a.ply"), splats)


def test_doubles_beyond_float32_become_infinite(tmp_path: Path) -> None:
    table = rows(random_splats(3, 0), "f8")
    table["x"][1] = 1e300
    element = plyfile.PlyElement.describe(table, "vertex")
    plyfile.PlyData([element], byte_order="<").write(tmp_path / "a.ply")
    splats = read_ply(tmp_path / "a.ply")
    assert splats.means[1, 0] == np.inf
    assert splats.invalid_rows().tolist() == [False, True, False]


def test_carriage_returns_in_the_header(tmp_path: Path) -> None:
    splats = random_splats(9, 3)
    write_ply(splats, tmp_path / "a.ply")
    data = (tmp_path / "a.ply").read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    (tmp_path / "b.ply").write_bytes(data[:end].replace(b"\n", b"\r\n") + data[end:])
    assert_same(read_ply(tmp_path / "b.ply"), splats)


def test_comments_of_any_encoding(tmp_path: Path) -> None:
    data = header_of("comment caf\xe9", "obj_info x", "comment", LITTLE, "element vertex 0")
    data = data.replace("caf\xe9".encode(), b"caf\xe9 cogsplat axes ?")
    data = data.replace(b"end_header", "\n".join([*properties(), "end_header"]).encode())
    (tmp_path / "a.ply").write_bytes(data)
    assert len(read_ply(tmp_path / "a.ply")) == 0


def test_rows_that_cannot_be_drawn_are_read_as_they_are(tmp_path: Path) -> None:
    splats = random_splats(5, 0)
    splats.means[0, 1] = np.nan
    splats.opacities[1] = np.inf
    splats.scales[2, 2] = -np.inf
    splats.quats[3] = 1e-45
    write_ply(splats, tmp_path / "a.ply")
    read = read_ply(tmp_path / "a.ply")
    assert_same(read, splats)
    assert read.invalid_rows().tolist() == [True, False, True, False, False]
    with pytest.raises(DataError) as caught:
        read.require_valid()
    assert caught.value.code == "invalid-rows"


INFO = SceneInfo((1.5, -2e300, 0.1), "LUF", "linear", 0.1, True)


@pytest.mark.parametrize("rest", [0, 15])
def test_what_the_scene_says_of_itself_survives(tmp_path: Path, rest: int) -> None:
    splats = random_splats(4, rest, INFO)
    write_ply(splats, tmp_path / "a.ply")
    assert_same(read_ply(tmp_path / "a.ply"), splats)
    assert plyfile.PlyData.read(tmp_path / "a.ply").comments == [
        "cogsplat origin 1.5 -2e+300 0.1",
        "cogsplat axes LUF",
        "cogsplat colour_space linear",
        "cogsplat kernel_px 0.1",
        "cogsplat antialiased true",
        "SplatRenderMode: mip",
    ]


@pytest.mark.parametrize(
    ("comments", "antialiased"),
    [
        (["SplatRenderMode: mip"], True),
        (["Exported from elsewhere", "SplatRenderMode: mip ", "cogsplat antialiased false"], True),
        (["SplatRenderMode: default"], False),
        (["cogsplat SplatRenderMode: mip"], False),
    ],
)
def test_scenes_that_others_mark_as_antialiased(
    tmp_path: Path, comments: list[str], antialiased: bool
) -> None:
    lines = (f"comment {comment}" for comment in comments)
    data = header_of(LITTLE, *lines, "element vertex 0", *properties())
    (tmp_path / "a.ply").write_bytes(data)
    assert read_ply(tmp_path / "a.ply").info == SceneInfo(antialiased=antialiased)


def test_a_default_scene_writes_no_comments(tmp_path: Path) -> None:
    write_ply(random_splats(1), tmp_path / "a.ply")
    assert b"comment" not in (tmp_path / "a.ply").read_bytes()[:2000]


@pytest.mark.parametrize(
    "info",
    [
        SceneInfo(axes="RDF\nelement vertex 9"),
        SceneInfo(axes="RLU"),
        SceneInfo(colour_space="cmyk"),
        SceneInfo(kernel_px=float("nan")),
        SceneInfo(origin=(0.0, float("inf"), 0.0)),
    ],
)
def test_a_scene_info_that_could_not_be_read_back_is_not_written(
    tmp_path: Path, info: SceneInfo
) -> None:
    with pytest.raises(DataError) as caught:
        write_ply(random_splats(1, 0, info), tmp_path / "a.ply")
    assert caught.value.code == "bad-scene-info"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "comment",
    [
        "cogsplat axes XYZ",
        "cogsplat kernel_px",
        "cogsplat kernel_px -1",
        "cogsplat kernel_px x",
        "cogsplat antialiased maybe",
        "cogsplat origin 1 2",
        "cogsplat origin 1 2 nan",
    ],
)
def test_damaged_comments_of_ours(tmp_path: Path, comment: str) -> None:
    data = header_of(LITTLE, f"comment {comment}", "element vertex 0", *properties())
    assert refused(tmp_path / "a.ply", data).code == "ply-bad-comment"


def test_comments_of_later_versions_are_skipped(tmp_path: Path) -> None:
    data = header_of(LITTLE, "comment cogsplat mood 7", "element vertex 0", *properties())
    (tmp_path / "a.ply").write_bytes(data)
    assert read_ply(tmp_path / "a.ply").info == SceneInfo()


def body(*lines: str, count: int = 0) -> bytes:
    return header_of(LITTLE, f"element vertex {count}", *properties(), *lines)


@pytest.mark.parametrize(
    ("code", "data"),
    [
        ("ply-magic", b""),
        ("ply-magic", b"solid teapot"),
        ("ply-magic", b"ply\rformat ascii 1.0\rend_header\r"),
        ("ply-no-end-header", b"ply\n" + LITTLE.encode()),
        ("ply-no-end-header", body().removesuffix(b"\n")),
        ("ply-header-too-long", b"ply\n" + b"comment x\n" * 10_000),
        ("ply-header-too-long", b"ply\ncomment " + b"x" * MAX_HEADER_BYTES),
        ("ply-bad-header", header_of("element vertex 0", *properties())),
        ("ply-bad-header", header_of(LITTLE)),
        ("ply-bad-header", header_of(LITTLE, "property float x")),
        ("ply-bad-header", header_of("format binary_little_endian 2.0")),
        ("ply-bad-header", header_of("format middle_endian 1.0")),
        ("ply-bad-header", header_of(LITTLE, LITTLE)),
        ("ply-bad-header", body("property half y2")),
        ("ply-bad-header", body("property list float int y2")),
        ("ply-bad-header", body("property float")),
        ("ply-bad-header", body("garbage")),
        ("ply-bad-header", body("")),
        ("ply-bad-count", header_of(LITTLE, "element vertex 2147483648")),
        ("ply-bad-count", header_of(LITTLE, "element vertex -1")),
        ("ply-bad-count", header_of(LITTLE, "element vertex 1e3")),
        ("ply-bad-count", header_of(LITTLE, "element vertex " + "9" * 5000)),
        ("ply-bad-count", header_of(LITTLE, "element vertex ٣")),
        ("ply-duplicate-property", body("property float x")),
        ("ply-duplicate-property", body("property double x")),
        ("ply-duplicate-element", body("element vertex 0")),
        ("ply-empty-element", body("element void 2147483647")),
        ("ply-no-vertex", header_of(LITTLE, "element point 0", *properties())),
        ("ply-list-property", body("property list uchar int vertex_indices")),
        ("ply-missing-property", header_of(LITTLE, "element vertex 0", *properties("scale_2"))),
        ("ply-missing-property", header_of(LITTLE, "element vertex 0")),
        ("ply-bad-sh", header_of(LITTLE, "element vertex 0", *properties(rest=44))),
        ("ply-bad-sh", header_of(LITTLE, "element vertex 0", *properties(rest=72))),
        ("ply-truncated", body(count=1)),
        ("ply-truncated", body(count=2) + bytes(2 * 56 - 1)),
        ("ply-truncated", body(count=MAX_COUNT)),
        ("ply-truncated", body("element face 9", "property list uchar int a") + bytes(8)),
        ("ply-trailing-bytes", body(count=2) + bytes(2 * 56 + 1)),
        ("ply-trailing-bytes", body("element other 2", "property uchar a") + bytes(3)),
    ],
)
def test_refuses(tmp_path: Path, code: str, data: bytes) -> None:
    assert refused(tmp_path / "a.ply", data).code == code


def test_message_lists_missing_and_existing_properties(tmp_path: Path) -> None:
    data = header_of(LITTLE, "element vertex 0", *properties("scale_2"))
    message = refused(tmp_path / "a.ply", data).message
    assert "lacks scale_2;" in message
    gap = [line.replace("f_rest_8", "f_rest_9") for line in properties(rest=9)]
    message = refused(tmp_path / "a.ply", header_of(LITTLE, "element vertex 0", *gap)).message
    assert "lacks f_rest_8;" in message


def test_a_truncated_file_says_how_long_it_should_be(tmp_path: Path) -> None:
    write_ply(random_splats(100), tmp_path / "a.ply")
    data = (tmp_path / "a.ply").read_bytes()
    error = refused(tmp_path / "a.ply", data[: len(data) // 5])
    assert isinstance(error, TruncatedError)
    assert (error.code, error.needed, error.offset) == ("ply-truncated", len(data), len(data) // 5)


@pytest.mark.parametrize("layout", ["binary_little_endian", "binary_big_endian", "ascii"])
def test_a_count_that_does_not_fit_allocates_nothing(tmp_path: Path, layout: str) -> None:
    data = header_of(f"format {layout} 1.0", f"element vertex {MAX_COUNT}", *properties())
    (tmp_path / "a.ply").write_bytes(data + bytes(1000))
    start_tracing()
    try:
        with pytest.raises(TruncatedError) as caught:
            read_ply(tmp_path / "a.ply")
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()
    assert caught.value.code == "ply-truncated"


def text_scene(tmp_path: Path, count: int = 3) -> bytes:
    plyfile.PlyData([vertex(random_splats(count, 0))], text=True).write(tmp_path / "text.ply")
    return (tmp_path / "text.ply").read_bytes()


@pytest.mark.parametrize(
    ("code", "change"),
    [
        ("ply-truncated", lambda text: text[: text.rindex(b"\n", 0, -1) + 1]),
        ("ply-trailing-bytes", lambda text: text + b"1 2 3\n"),
        ("ply-malformed", lambda text: text.rsplit(b" ", 1)[0] + b"\n"),
        ("ply-malformed", lambda text: text.rsplit(b" ", 1)[0] + b" one\n"),
        ("ply-malformed", lambda text: text.rsplit(b" ", 1)[0] + b" \xff\n"),
        ("ply-malformed", lambda text: text.rstrip() + b" 7\n"),
        ("ply-malformed", lambda text: text.rstrip() + b" 7" * (1 << 20)),
        ("ply-malformed", lambda text: text.replace(b"end_header\n", b"end_header\n\n")),
    ],
)
def test_refuses_damaged_text(tmp_path: Path, code: str, change: object) -> None:
    assert callable(change)
    assert refused(tmp_path / "a.ply", change(text_scene(tmp_path))).code == code


def test_text_with_comments_of_any_encoding(tmp_path: Path) -> None:
    text = text_scene(tmp_path).replace(b"ply\n", b"ply\ncomment caf\xe9\n", 1)
    (tmp_path / "a.ply").write_bytes(text.replace(b"\n", b"\r\n"))
    assert_same(read_ply(tmp_path / "a.ply"), random_splats(3, 0))


def test_text_may_end_without_a_line_feed_or_with_several(tmp_path: Path) -> None:
    text = text_scene(tmp_path)
    for data in (text.rstrip(b"\n"), text + b"\n\n"):
        (tmp_path / "a.ply").write_bytes(data)
        assert_same(read_ply(tmp_path / "a.ply"), random_splats(3, 0))


def test_lists_that_lie_about_their_length(tmp_path: Path) -> None:
    for length in (b"\xff\xff\xff\xff", b"\xff\xff\xff\x7f"):
        for kind in ("uint", "int"):
            head = header_of(
                LITTLE, "element face 1", f"property list {kind} double a",
                "element vertex 1", *properties(),
            )  # fmt: skip
            error = refused(tmp_path / "a.ply", head + length + bytes(56))
            assert error.code == "ply-malformed"


def test_too_many_lists(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(foreign_layouts, "_MAX_LISTS", 2)
    plyfile.PlyData([faces(3), vertex(random_splats(2, 0))], byte_order="<").write(
        tmp_path / "a.ply"
    )
    with pytest.raises(UnsupportedError) as caught:
        read_ply(tmp_path / "a.ply")
    assert caught.value.code == "ply-too-many-lists"


def test_without_plyfile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = importlib.import_module

    def absent(name: str, package: str | None = None) -> object:
        if name == "plyfile":
            raise ModuleNotFoundError(name)
        return real(name, package)

    monkeypatch.setattr(importlib, "import_module", absent)
    write_ply(random_splats(3), tmp_path / "a.ply")
    assert_same(read_ply(tmp_path / "a.ply"), random_splats(3))
    (tmp_path / "b.ply").write_bytes(text_scene(tmp_path))
    with pytest.raises(UnsupportedError, match="ascii") as caught:
        read_ply(tmp_path / "b.ply")
    assert caught.value.code == "needs-plyfile"


def test_a_file_that_shrinks_or_changes_while_it_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.ply"
    check = ply_header.check_size

    def shrink(*arguments: object) -> None:
        check(*arguments)  # type: ignore[arg-type]
        path.write_bytes(path.read_bytes()[:-2000])

    write_ply(random_splats(3000), path)
    with monkeypatch.context() as patch:
        patch.setattr(ply, "check_size", shrink)
        with pytest.raises(TruncatedError) as short:
            read_ply(path)
    assert short.value.code == "ply-truncated"

    def grow(*arguments: object) -> None:
        check(*arguments)  # type: ignore[arg-type]
        with path.open("ab") as file:
            file.write(b"more")

    write_ply(random_splats(3000), path, force=True)
    with monkeypatch.context() as patch:
        patch.setattr(ply, "check_size", grow)
        with pytest.raises(StorageError) as changed:
            read_ply(path)
    assert changed.value.code == "file-changed"


def test_storage_failures(tmp_path: Path) -> None:
    for path, code in ((tmp_path / "none.ply", "not-found"), (tmp_path, "not-a-file")):
        with pytest.raises(StorageError) as caught:
            read_ply(path)
        assert caught.value.code == code
    write_ply(random_splats(1), tmp_path / "a.ply")
    with pytest.raises(StorageError) as caught:
        write_ply(random_splats(2), tmp_path / "a.ply")
    assert caught.value.code == "exists"
    write_ply(random_splats(2), tmp_path / "a.ply", force=True)
    assert len(read_ply(tmp_path / "a.ply")) == 2


def encoded(text: bool, order: str, elements: list[plyfile.PlyElement]) -> bytes:
    stream = io.BytesIO()
    plyfile.PlyData(elements, text=text, byte_order=order).write(stream)
    return stream.getvalue()


SEEDS = [
    encoded(False, "<", [vertex(random_splats(3, 0))]),
    encoded(False, ">", [vertex(random_splats(3, 0))]),
    encoded(False, "<", [faces(2), vertex(random_splats(2, 0), "f8")]),
    encoded(True, "=", [vertex(random_splats(2, 0)), faces(2)]),
]


@settings(
    max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    seed=st.sampled_from(SEEDS),
    edits=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 255)), max_size=4),
    keep=st.one_of(st.just(1.0), st.floats(0, 1)),
)
def test_damage_only_ever_raises_our_errors(
    tmp_path: Path, seed: bytes, edits: list[tuple[float, int]], keep: float
) -> None:
    data = bytearray(seed)
    for place, value in edits:
        data[int(place * (len(data) - 1))] = value
    (tmp_path / "a.ply").write_bytes(bytes(data[: int(keep * len(data))]))
    try:
        splats = read_ply(tmp_path / "a.ply")
    except CogsplatError:
        return
    assert len(splats) <= len(data)


@settings(max_examples=200, deadline=None)
@given(
    st.lists(
        st.one_of(
            st.sampled_from(
                [
                    LITTLE,
                    "comment",
                    "element vertex 3",
                    "property float x",
                    "element f 0",
                    "property list uchar int a",
                    "end_header",
                ]
            ),
            st.text(max_size=12),
        ),
        max_size=12,
    )
)
def test_any_header_parses_or_is_refused(lines: list[str]) -> None:
    try:
        header = parse_header("\n".join(["ply", *lines, "end_header\n"]).encode(), "x.ply")
    except FormatError:
        return
    assert header.elements


@pytest.mark.shared
@needs_shared
@pytest.mark.parametrize("name", ["fox", "plushdog", "biker"])
def test_real_scenes(tmp_path: Path, name: str) -> None:
    path = SHARED / name / "scene.ply"
    splats = read_ply(path)
    table = plyfile.PlyData.read(path)["vertex"].data
    expected = rows(splats)
    for column in expected.dtype.names:
        np.testing.assert_array_equal(table[column], expected[column], column)
    write_ply(splats, tmp_path / "a.ply")
    ours, theirs = (tmp_path / "a.ply").read_bytes(), path.read_bytes()
    assert ours[ours.index(b"end_header") :] == theirs[theirs.index(b"end_header") :]
    assert_same(read_ply(tmp_path / "a.ply"), replace(splats, info=SceneInfo()))
