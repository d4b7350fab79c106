from __future__ import annotations

import base64
import contextlib
import json
import struct
import tracemalloc
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from random_splats import random_splats
from scipy.spatial.transform import Rotation
from tracing import start_tracing

from cogsplat.codec.errors import (
    CogsplatError,
    CogsplatWarning,
    DataError,
    FormatError,
    LimitError,
    TruncatedError,
)
from cogsplat.codec.geometry.rotations import matrices, unit
from cogsplat.codec.geometry.sh import colours
from cogsplat.codec.splats import SceneInfo, Splats, empty
from cogsplat.formats.scenes.gltf import gltf_scene as gltf
from cogsplat.formats.scenes.gltf.gltf_scene import read_gltf, write_gltf
from cogsplat.formats.scenes.quantised_values import unit_opacities
from cogsplat.formats.scenes.registry import read_scene, write_scene

Json = dict[str, Any]
EXT = "KHR_gaussian_splatting"
# glTF's x is left, y up, z front; PLY's x is right, y down, z front.
TO_RDF = np.diag([-1.0, -1.0, 1.0])
COMPONENTS = {"i1": 5120, "u1": 5121, "i2": 5122, "u2": 5123, "f4": 5126}


def scene(count: int, rest: int = 15, info: SceneInfo | None = None) -> Splats:
    """Return random splats with unit quaternions, as glTF demands."""
    splats = random_splats(count, rest, info)
    return replace(splats, quats=unit(splats.quats))


class Maker:
    """Puts a glTF file together, one accessor at a time."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.json: Json = {
            "asset": {"version": "2.0"},
            "extensionsUsed": [EXT],
            "scenes": [{"nodes": [0]}],
            "nodes": [{"mesh": 0}],
            "meshes": [],
            "accessors": [],
            "bufferViews": [],
        }

    def accessor(self, values: np.ndarray, *, normalized: bool = False, gap: int = 0) -> int:
        rows = values if values.ndim == 2 else values[:, None]
        code = rows.dtype.str[1:]
        start = len(self.data) + 4
        element = rows.shape[1] * rows.itemsize
        stride = -(-element // 4) * 4 + gap
        self.data += bytes(4)
        for row in rows:
            self.data += row.tobytes() + b"\xaa" * (stride - element)
        view: Json = {"buffer": 0, "byteOffset": start - 4, "byteLength": 4 + stride * len(rows)}
        if stride != element:
            view["byteStride"] = stride
        self.json["bufferViews"].append(view)
        accessor: Json = {
            "bufferView": len(self.json["bufferViews"]) - 1,
            "byteOffset": 4,
            "componentType": COMPONENTS[code],
            "count": len(rows),
            "type": {1: "SCALAR", 3: "VEC3", 4: "VEC4"}[rows.shape[1]],
        }
        if normalized:
            accessor["normalized"] = True
        self.json["accessors"].append(accessor)
        return len(self.json["accessors"]) - 1

    def primitive(self, splats: Splats, **others: int) -> Json:
        """Add splats whose values are taken as glTF's; others replace attributes' accessors."""
        values = {
            "POSITION": splats.means,
            "ROTATION": splats.quats[:, [1, 2, 3, 0]],
            "SCALE": np.exp(splats.scales),
            "OPACITY": unit_opacities(splats.opacities).astype("f4"),
            "SH_DEGREE_0_COEF_0": splats.sh0,
        }
        k = 0
        for band in range(1, splats.sh_degree + 1):
            for order in range(2 * band + 1):
                values[f"SH_DEGREE_{band}_COEF_{order}"] = splats.shN[:, k]
                k += 1
        attributes = {}
        for name, array in values.items():
            index = others[name] if name in others else self.accessor(array)
            attributes[name if name == "POSITION" else f"{EXT}:{name}"] = index
        return {
            "mode": 0,
            "attributes": attributes,
            "extensions": {
                EXT: {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"},
            },
        }

    def mesh(self, *primitives: Json) -> None:
        self.json["meshes"].append({"primitives": list(primitives)})

    def glb(self, path: Path) -> Path:
        self.json["buffers"] = [{"byteLength": len(self.data)}]
        path.write_bytes(packed(json.dumps(self.json).encode(), bytes(self.data)))
        return path


def packed(text: bytes, data: bytes | None) -> bytes:
    chunks = [(b"JSON", text + b" " * (-len(text) % 4))]
    if data is not None:
        chunks.append((b"BIN\0", data + bytes(-len(data) % 4)))
    body = b"".join(struct.pack("<I4s", len(c), kind) + c for kind, c in chunks)
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def simple(splats: Splats) -> Maker:
    maker = Maker()
    maker.mesh(maker.primitive(splats))
    return maker


def covariances(splats: Splats) -> np.ndarray:
    axes = matrices(unit(splats.quats)) * np.exp(splats.scales.astype(np.float64))[:, None, :]
    return axes @ axes.transpose(0, 2, 1)


def assert_moved(actual: Splats, local: Splats, linear: np.ndarray, offset: np.ndarray) -> None:
    """Check a scene against plain linear algebra: world = linear @ local + offset, in glTF axes."""
    linear = TO_RDF @ linear
    expected = local.means @ linear.T + TO_RDF @ offset
    np.testing.assert_allclose(actual.means, expected, rtol=1e-5, atol=1e-5)
    expected = linear @ covariances(local) @ linear.T
    np.testing.assert_allclose(covariances(actual), expected, rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(actual.opacities, local.opacities, rtol=1e-4, atol=1e-5)
    # What is seen along a direction in the world is what was seen along it in the mesh.
    rng = np.random.default_rng(1)
    directions = rng.standard_normal((len(local), 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    turn = linear / np.cbrt(abs(np.linalg.det(linear)))
    seen = colours(actual.sh0, actual.shN, directions @ turn.T)
    np.testing.assert_allclose(seen, colours(local.sh0, local.shN, directions), atol=1e-5)


def refused(path: Path) -> CogsplatError:
    with pytest.raises(CogsplatError) as caught:
        read_gltf(path)
    assert str(path) in caught.value.message
    return caught.value


@pytest.mark.parametrize("rest", [0, 3, 8, 15])
def test_reads_floats(tmp_path: Path, rest: int) -> None:
    splats = scene(40, rest)
    read = read_scene(simple(splats).glb(tmp_path / "a.bin"))
    assert_moved(read, splats, np.eye(3), np.zeros(3))
    assert read.info == SceneInfo()
    np.testing.assert_allclose(read.scales, splats.scales, rtol=1e-6)
    for array in (read.means, read.quats, read.shN):
        assert array.flags.writeable
        assert array.flags.aligned


@pytest.mark.parametrize("rest", [0, 3, 8, 15])
@pytest.mark.parametrize("name", ["a.glb", "a.gltf"])
def test_round_trip(tmp_path: Path, name: str, rest: int) -> None:
    splats = scene(100, rest, SceneInfo(colour_space="linear"))
    write_scene(splats, tmp_path / name)
    read = read_scene(tmp_path / name)
    for field in ("means", "sh0", "shN"):
        np.testing.assert_array_equal(getattr(read, field), getattr(splats, field), field)
    for field in ("scales", "quats"):
        actual, expected = getattr(read, field), getattr(splats, field)
        np.testing.assert_allclose(actual, expected, rtol=1e-6, atol=2e-7, err_msg=field)
    np.testing.assert_allclose(
        unit_opacities(read.opacities), unit_opacities(splats.opacities), atol=1e-7
    )
    assert read.info == splats.info
    first = (tmp_path / name).read_bytes()
    write_scene(splats, tmp_path / name, force=True)
    assert (tmp_path / name).read_bytes() == first


def test_extremes(tmp_path: Path) -> None:
    splats = replace(
        scene(4, 0),
        scales=np.array([[-200, 0, 200]] * 4, np.float32),
        opacities=np.array([-np.inf, -90, 40, np.inf], np.float32),
    )
    write_gltf(splats, tmp_path / "a.glb")
    read = read_gltf(tmp_path / "a.glb")
    np.testing.assert_allclose(read.scales, [[-87.33654, 0, 88.72284]] * 4, rtol=1e-6)
    np.testing.assert_array_equal(read.opacities, [-np.inf, -np.inf, np.inf, np.inf])


def test_what_a_glb_holds(tmp_path: Path) -> None:
    splats = scene(5, 3)
    write_gltf(splats, tmp_path / "a.glb")
    data = (tmp_path / "a.glb").read_bytes()
    magic, version, total, length, kind = struct.unpack_from("<4sIII4s", data)
    assert (magic, version, total, kind) == (b"glTF", 2, len(data), b"JSON")
    document = json.loads(data[20 : 20 + length])
    binary = data[20 + length :]
    assert struct.unpack_from("<I4s", binary) == (len(binary) - 8, b"BIN\0")
    assert length % 4 == document["buffers"][0]["byteLength"] % 4 == 0
    assert document["extensionsUsed"] == [EXT]
    (primitive,) = document["meshes"][0]["primitives"]
    assert primitive["mode"] == 0
    assert primitive["extensions"][EXT]["colorSpace"] == "srgb_rec709_display"
    names = primitive["attributes"]
    assert len(names) == 6 + 3
    positions = document["accessors"][names["POSITION"]]
    np.testing.assert_allclose(positions["min"], (splats.means @ TO_RDF).min(axis=0), rtol=1e-6)
    np.testing.assert_allclose(positions["max"], (splats.means @ TO_RDF).max(axis=0), rtol=1e-6)
    view = document["bufferViews"][document["accessors"][names["COLOR_0"]]["bufferView"]]
    rgba = np.frombuffer(binary, np.uint8, 20, 8 + view["byteOffset"]).reshape(5, 4)
    expected = (0.5 + 0.28209479 * splats.sh0).clip(0, 1) * 255
    np.testing.assert_allclose(rgba[:, :3], expected, atol=0.51)


INTEGERS = {
    "ROTATION i1": (127, "i1", True),
    "ROTATION i2": (32767, "i2", True),
    "OPACITY u1": (255, "u1", True),
    "OPACITY u2": (65535, "u2", True),
    "SCALE u1": (255, "u1", True),
    "SCALE i2": (32767, "i2", True),
    "SCALE i1 plain": (1, "i1", False),
    "POSITION i2": (32767, "i2", True),
    "POSITION u2 plain": (1, "u2", False),
}


@pytest.mark.parametrize("what", list(INTEGERS))
def test_reads_integers(tmp_path: Path, what: str) -> None:
    one, code, normalized = INTEGERS[what]
    name = what.split()[0]
    splats = scene(30, 0)
    rng = np.random.default_rng(2)
    low = -one if name in ("ROTATION", "POSITION") and code[0] == "i" else 0
    high = one if normalized else 100
    shape = {"ROTATION": (30, 4), "OPACITY": (30,)}.get(name, (30, 3))
    codes = rng.integers(low, high + 1, shape).astype(code)
    codes.reshape(-1)[0] = high
    maker = Maker()
    index = maker.accessor(codes, normalized=normalized, gap=4)
    maker.mesh(maker.primitive(splats, **{name: index}))
    read = read_gltf(maker.glb(tmp_path / "a.glb"))
    values = codes.astype(np.float64) / one
    if name == "POSITION":
        np.testing.assert_allclose(read.means, values @ TO_RDF, rtol=1e-6)
    elif name == "OPACITY":
        np.testing.assert_allclose(unit_opacities(read.opacities), values, atol=1e-6)
    elif name == "SCALE":
        np.testing.assert_allclose(np.exp(read.scales), values, rtol=1e-5, atol=1e-37)
    else:
        expected = matrices(unit(np.roll(values, 1, axis=1).astype("f4")))
        actual = matrices(unit(read.quats))
        np.testing.assert_allclose(np.abs(actual), np.abs(expected), atol=1e-5)


def test_the_most_negative_integer_is_minus_one(tmp_path: Path) -> None:
    maker = Maker()
    index = maker.accessor(np.array([[-128, 0, 0, 0]], "i1"), normalized=True)
    maker.mesh(maker.primitive(scene(1, 0), ROTATION=index))
    read = read_gltf(maker.glb(tmp_path / "a.glb"))
    np.testing.assert_array_equal(np.abs(read.quats), [[0, 1, 0, 0]])


def test_buffers_inside_and_beside(tmp_path: Path) -> None:
    splats = scene(20, 3)
    maker = simple(splats)
    expected = read_gltf(maker.glb(tmp_path / "a.glb"))
    text = base64.b64encode(maker.data).decode()
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "the data.bin").write_bytes(maker.data + b"more")
    for uri in (f"data:application/octet-stream;base64,{text}", "sub/the%20data.bin"):
        maker.json["buffers"] = [{"byteLength": len(maker.data), "uri": uri}]
        (tmp_path / "a.gltf").write_text(json.dumps(maker.json))
        read = read_scene(tmp_path / "a.gltf")
        np.testing.assert_array_equal(read.means, expected.means)
        np.testing.assert_array_equal(read.shN, expected.shN)


@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("as_matrix", [False, True])
def test_nodes_move_splats(tmp_path: Path, as_matrix: bool, mirrored: bool) -> None:
    splats = scene(60, 15)
    maker = simple(splats)
    outer, inner = Rotation.from_rotvec([0.3, -1.1, 0.4]), Rotation.from_rotvec([2, 0.2, -0.7])
    flip = np.array([1.0, 1.0, -1.0 if mirrored else 1.0])
    child: Json = {"mesh": 0}
    linear = inner.as_matrix() * (0.5 * flip)
    if as_matrix:
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = linear, [1, 2, 3]
        child["matrix"] = matrix.T.reshape(-1).tolist()
    else:
        child["rotation"] = (inner.as_quat() * 1.001).tolist()
        child["scale"] = (0.5 * flip).tolist()
        child["translation"] = [1, 2, 3]
    parent = {"children": [1], "rotation": outer.as_quat().tolist(), "scale": [3, 3, 3]}
    maker.json["nodes"] = [parent, child]
    read = read_gltf(maker.glb(tmp_path / "a.glb"))
    whole = 3 * outer.as_matrix() @ linear
    assert_moved(read, splats, whole, 3 * outer.as_matrix() @ np.array([1, 2, 3]))


def test_several_primitives_and_places(tmp_path: Path) -> None:
    first, second = scene(10, 0), scene(7, 3)
    maker = Maker()
    triangles = {"attributes": {"POSITION": 0}}
    maker.mesh(maker.primitive(first), triangles, maker.primitive(second))
    maker.mesh(triangles)
    maker.json["nodes"] = [
        {"mesh": 0},
        {"children": [2]},
        {"mesh": 0, "translation": [1, 0, 0]},
        {"mesh": 1},
        {"mesh": 0, "translation": [0, 5, 0]},
    ]
    maker.json["scenes"] = [{"nodes": [4]}, {"nodes": [0, 1, 3]}]
    maker.json["scene"] = 1
    read = read_gltf(maker.glb(tmp_path / "a.glb"))
    assert (len(read), read.sh_degree) == (34, 1)
    np.testing.assert_allclose(read.means[:10] - read.means[17:27], [[1, 0, 0]] * 10, atol=1e-5)
    assert not read.shN[:10].any()
    np.testing.assert_array_equal(read.sh0[10:17], second.sh0)
    del maker.json["scene"]
    assert len(read_gltf(maker.glb(tmp_path / "a.glb"))) == 17
    del maker.json["scenes"]
    assert len(read_gltf(maker.glb(tmp_path / "a.glb"))) == 51


def test_drafts_stored_logarithms(tmp_path: Path) -> None:
    splats = scene(10, 0)
    maker = Maker()
    maker.mesh(maker.primitive(splats, SCALE=maker.accessor(splats.scales)))
    with pytest.warns(CogsplatWarning, match="logarithms"):
        read = read_gltf(maker.glb(tmp_path / "a.glb"))
    np.testing.assert_array_equal(read.scales, splats.scales)


def test_flat_splats_and_rows_that_are_no_numbers(tmp_path: Path) -> None:
    maker = Maker()
    splats = scene(3, 0)
    scales = np.array([[0, 1, 1], [1, np.nan, 1], [1, 1, 1]], "f4")
    opacity = maker.accessor(np.array([1.000001, 0.5, np.nan], "f4"))
    maker.mesh(maker.primitive(splats, SCALE=maker.accessor(scales), OPACITY=opacity))
    read = read_gltf(maker.glb(tmp_path / "a.glb"))
    assert read.invalid_rows().tolist() == [False, True, True]
    assert read.scales[0, 0] < -80
    assert read.opacities[0] == np.inf


def test_dropped_values_give_a_warning(tmp_path: Path) -> None:
    info = SceneInfo((1.0, 2.0, 3.0), "RUB", "srgb", 0.1, True)
    with pytest.warns(CogsplatWarning, match="origin.*kernel.*anti-aliasing") as caught:
        write_gltf(scene(3, 3, info), tmp_path / "a.glb")
    assert len(caught) == 1
    assert read_gltf(tmp_path / "a.glb").info == SceneInfo()


def test_scenes_that_are_not_written(tmp_path: Path) -> None:
    bad = replace(scene(3), means=np.full((3, 3), np.nan, np.float32))
    for splats, code in ((bad, "invalid-rows"), (empty(1), "no-splats")):
        with pytest.raises(DataError) as caught:
            write_gltf(splats, tmp_path / "a.glb")
        assert caught.value.code == code
    assert list(tmp_path.iterdir()) == []


def test_beyond_the_sizes_of_files(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(gltf, "_MAX_GLB_BYTES", 1000)
    monkeypatch.setattr(gltf, "MAX_TEXT_BYTES", 1000)
    for name in ("a.glb", "a.gltf"):
        with pytest.raises(LimitError) as caught:
            write_gltf(scene(30, 0), tmp_path / name)
        assert caught.value.code == "gltf-too-large"
    assert list(tmp_path.iterdir()) == []


def put(root: Json, path: str, value: object) -> None:
    *parents, last = [int(key) if key.isdigit() else key for key in path.split("/")]
    node: Any = root
    for key in parents:
        node = node[key]
    if value is None:
        del node[last]
    else:
        node[last] = value


PRIMITIVE = "meshes/0/primitives/0"
ATTRIBUTES = f"{PRIMITIVE}/attributes"
SPLATTING = f"{PRIMITIVE}/extensions/{EXT}"


@pytest.mark.parametrize(
    ("path", "value", "code"),
    [
        ("asset", None, "gltf-bad-json"),
        ("asset/version", "1.0", "gltf-version"),
        ("extensionsRequired", ["KHR_gaussian_splatting_compression_spz_2"], "gltf-compressed"),
        ("extensionsRequired", ["EXT_other"], "gltf-extension"),
        ("extensionsRequired", "EXT_other", "gltf-bad-json"),
        ("meshes", None, "gltf-bad-json"),
        ("meshes", [], "gltf-bad-json"),
        ("meshes", [5], "gltf-bad-json"),
        (PRIMITIVE, {"attributes": {}}, "gltf-no-splats"),
        ("nodes", [{}], "gltf-no-splats"),
        ("nodes/0/children", [0], "gltf-node-tree"),
        ("nodes/0/children", [1], "gltf-bad-json"),
        ("nodes/0/children", [-1], "gltf-bad-json"),
        ("nodes/0/mesh", 1.5, "gltf-bad-json"),
        ("nodes/0/scale", [1, 2, 1], "gltf-shear"),
        ("nodes/0/scale", [0, 0, 0], "gltf-shear"),
        ("nodes/0/scale", [1, 1], "gltf-bad-json"),
        ("nodes/0/rotation", [0, 0, 0, 0], "gltf-bad-transform"),
        ("nodes/0/rotation", [1e200, 0, 0, 0], "gltf-bad-transform"),
        ("nodes/0/matrix", [1] * 16, "gltf-shear"),
        ("nodes/0/matrix", [1e999], "gltf-bad-json"),
        ("scenes/0/nodes", [7], "gltf-bad-json"),
        ("scene", 1, "gltf-bad-json"),
        (f"{PRIMITIVE}/mode", None, "gltf-mode"),
        (f"{PRIMITIVE}/mode", 4, "gltf-mode"),
        (f"{SPLATTING}/kernel", "other", "gltf-kernel"),
        (f"{SPLATTING}/projection", "orthographic", "gltf-projection"),
        (f"{SPLATTING}/colorSpace", "BT.2020", "gltf-colour-space"),
        (f"{SPLATTING}/colorSpace", 5, "gltf-bad-json"),
        (
            f"{SPLATTING}/extensions",
            {"KHR_gaussian_splatting_compression_spz_2": {"bufferView": 0}},
            "gltf-spz",
        ),
        (f"{SPLATTING}/extensions", {"EXT_kernel": {}}, "gltf-extension"),
        (f"{ATTRIBUTES}/POSITION", None, "gltf-missing-attribute"),
        (f"{ATTRIBUTES}/{EXT}:SCALE", None, "gltf-missing-attribute"),
        (f"{ATTRIBUTES}/{EXT}:SCALE", 99, "gltf-bad-json"),
        (f"{ATTRIBUTES}/{EXT}:SCALE", 3, "gltf-bad-accessor"),
        (f"{ATTRIBUTES}/{EXT}:SH_DEGREE_0_COEF_0", None, "gltf-bad-sh"),
        (f"{ATTRIBUTES}/{EXT}:SH_DEGREE_1_COEF_2", None, "gltf-bad-sh"),
        (f"{ATTRIBUTES}/{EXT}:SH_DEGREE_2_COEF_0", 5, "gltf-bad-sh"),
        ("accessors/1/count", 4, "gltf-count"),
        ("accessors/1/count", 2**31 - 1, "gltf-bad-accessor"),
        ("accessors/1/count", 2**40, "gltf-bad-json"),
        ("accessors/1/count", 0, "gltf-bad-json"),
        ("accessors/1/byteOffset", 8, "gltf-bad-accessor"),
        ("accessors/1/byteOffset", -8, "gltf-bad-json"),
        ("accessors/1/type", "VEC3", "gltf-bad-accessor"),
        ("accessors/1/componentType", 5125, "gltf-component-type"),
        ("accessors/1/sparse", {"count": 1}, "gltf-sparse"),
        ("accessors/1/bufferView", None, "gltf-compressed"),
        ("accessors/1/bufferView", 99, "gltf-bad-json"),
        ("bufferViews/1/byteStride", 4, "gltf-bad-accessor"),
        ("bufferViews/1/byteStride", 252, "gltf-bad-accessor"),
        ("bufferViews/1/byteLength", 2**50, "gltf-bad-accessor"),
        ("bufferViews/1/byteOffset", 2**50, "gltf-bad-accessor"),
        ("bufferViews/1/extensions", {"EXT_meshopt_compression": {}}, "gltf-compressed"),
        ("bufferViews/1/buffer", 1, "gltf-bad-json"),
        ("buffers/0/byteLength", 2**50, "gltf-truncated"),
        ("buffers/0/uri", "http://example.org/a.bin", "gltf-uri"),
        ("buffers/0/uri", "../a.bin", "gltf-uri"),
        ("buffers/0/uri", "%2e%2e/a.bin", "gltf-uri"),
        ("buffers/0/uri", "none.bin", "not-found"),
        ("buffers/0/uri", "data:,abc", "gltf-uri"),
        ("buffers/0/uri", "data:;base64,?", "gltf-bad-buffer"),
        ("buffers/0/uri", "data:;base64,\u00e9", "gltf-bad-buffer"),
        ("buffers/0/uri", "data:;base64,AAAA", "gltf-truncated"),
    ],
)
def test_messages_name_the_fault(tmp_path: Path, path: str, value: object, code: str) -> None:
    maker = simple(scene(5, 3))
    maker.json["buffers"] = [{"byteLength": len(maker.data)}]
    put(maker.json, path, value)
    file = tmp_path / "a.glb"
    file.write_bytes(packed(json.dumps(maker.json).encode(), bytes(maker.data)))
    with pytest.raises(CogsplatError) as caught:
        read_gltf(file)
    assert caught.value.code == code
    assert str(tmp_path) in caught.value.message


@pytest.mark.parametrize("value", [1.1, -0.1, np.inf])
def test_opacities_out_of_range(tmp_path: Path, value: float) -> None:
    maker = Maker()
    opacity = maker.accessor(np.array([0.5, value, 0.5], "f4"))
    maker.mesh(maker.primitive(scene(3, 0), OPACITY=opacity))
    assert refused(maker.glb(tmp_path / "a.glb")).code == "gltf-bad-opacity"


def test_colour_spaces_are_not_mixed(tmp_path: Path) -> None:
    maker = Maker()
    second = maker.primitive(scene(3, 0))
    second["extensions"][EXT]["colorSpace"] = "lin_rec709_display"
    maker.mesh(maker.primitive(scene(3, 0)), second)
    assert refused(maker.glb(tmp_path / "a.glb")).code == "gltf-colour-space"


def test_containers(tmp_path: Path) -> None:
    path = tmp_path / "a.glb"
    good = simple(scene(2, 0)).glb(path).read_bytes()
    cases = [
        (b"", "gltf-magic"),
        (b"ply\n", "gltf-magic"),
        (good[:4] + b"\x01" + good[5:], "gltf-version"),
        (good + b"\0\0\0\0", "gltf-bad-glb"),
        (packed(b"[]", None), "gltf-bad-json"),
        (packed(b"{}" + b" " * 4, None)[:16] + b"BIN\0" + b"{}    ", "gltf-truncated"),
        (struct.pack("<4sII", b"glTF", 2, 12), "gltf-bad-glb"),
        (packed(b"{" * 5000, None), "gltf-bad-json"),
        (good.replace(b"BIN\0", b"XXXX"), "gltf-bad-buffer"),
    ]
    for data, code in cases:
        path.write_bytes(data)
        assert refused(path).code == code
    for length in range(4, len(good), 7):
        path.write_bytes(good[:length])
        assert isinstance(refused(path), TruncatedError)


def test_repeats_are_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    maker = simple(scene(1000, 0))
    maker.json["nodes"] = [{"mesh": 0}] * 17
    maker.json["scenes"] = [{"nodes": list(range(17))}]
    assert refused(maker.glb(tmp_path / "a.glb")).code == "gltf-too-many-instances"
    maker.json["scenes"] = [{"nodes": list(range(16))}]
    assert len(read_gltf(maker.glb(tmp_path / "a.glb"))) == 16_000
    monkeypatch.setattr(gltf, "_MAX_PRIMITIVES", 15)
    assert refused(tmp_path / "a.glb").code == "gltf-too-many-instances"


def test_hostile_counts_allocate_nothing(tmp_path: Path) -> None:
    maker = simple(scene(5, 3))
    for accessor in maker.json["accessors"]:
        accessor["count"] = 2**31 - 1
    path = maker.glb(tmp_path / "a.glb")
    start_tracing()
    try:
        assert isinstance(refused(path), FormatError | LimitError)
        assert tracemalloc.get_traced_memory()[1] < 4_000_000
    finally:
        tracemalloc.stop()


@settings(
    deadline=None, max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.data())
@pytest.mark.filterwarnings("ignore::cogsplat.codec.errors.CogsplatWarning")
def test_damaged_files_raise_only_cogsplat_errors(tmp_path: Path, data: st.DataObject) -> None:
    good = tmp_path / "good.glb"
    if not good.exists():
        maker = simple(scene(3, 3))
        maker.json["nodes"][0].update({"rotation": [0, 0, 0, 1], "scale": [2, 2, 2]})
        maker.glb(good)
    damaged = bytearray(good.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    (tmp_path / "damaged.glb").write_bytes(damaged)
    with contextlib.suppress(CogsplatError):
        read_gltf(tmp_path / "damaged.glb")


@settings(
    deadline=None, max_examples=200, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.data())
@pytest.mark.filterwarnings("ignore::cogsplat.codec.errors.CogsplatWarning")
def test_wild_json_raises_only_cogsplat_errors(tmp_path: Path, data: st.DataObject) -> None:
    maker = simple(scene(3, 0))
    maker.json["buffers"] = [{"byteLength": len(maker.data)}]
    maker.json["nodes"][0].update({"matrix": np.eye(4).reshape(-1).tolist(), "children": []})
    places: list[tuple[Any, Any]] = []

    def collect(node: Any) -> None:
        for key in node if isinstance(node, dict) else range(len(node)):
            places.append((node, key))
            if isinstance(node[key], dict | list):
                collect(node[key])

    collect(maker.json)
    wild = (
        st.none()
        | st.booleans()
        | st.integers()
        | st.floats()
        | st.sampled_from([-1, 0, 1, 2, 5121, 5126, 1e308, 2**31])
        | st.text(max_size=4)
    )
    for _ in range(data.draw(st.integers(1, 3))):
        node, key = data.draw(st.sampled_from(places))
        node[key] = data.draw(wild | st.lists(wild, max_size=4))
    text = json.dumps(maker.json).encode()
    (tmp_path / "wild.glb").write_bytes(packed(text, bytes(maker.data)))
    with contextlib.suppress(CogsplatError):
        read_gltf(tmp_path / "wild.glb")
