from __future__ import annotations

import contextlib
import functools
import io
import json
import math
import struct
import tracemalloc
import zipfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image
from random_splats import random_splats
from tracing import start_tracing

from cogsplat.codec.errors import (
    CogsplatError,
    CogsplatWarning,
    DataError,
    FormatError,
    LimitError,
    UnsupportedError,
)
from cogsplat.codec.geometry.transforms import convert_axes
from cogsplat.codec.splats import SceneInfo, empty
from cogsplat.formats.scenes.quantised_values import morton_order, unit_opacities
from cogsplat.formats.scenes.registry import read_scene, write_scene
from cogsplat.formats.scenes.sog.sog_scene import read_sog, write_sog
from cogsplat.formats.storage.images import decode_image, encode_image, image_size

Meta = dict[str, Any]
COUNT = 150
COEFFICIENTS = {1: 3, 2: 8, 3: 15}


scene = functools.partial(random_splats, sh_scale=0.125)


def webp(pixels: np.ndarray, **options: object) -> bytes:
    out = io.BytesIO()
    options = {"lossless": True, "exact": True, **options}
    Image.fromarray(pixels).save(out, "WEBP", **options)
    return out.getvalue()


def png(pixels: np.ndarray) -> bytes:
    out = io.BytesIO()
    Image.fromarray(pixels).save(out, "PNG")
    return out.getvalue()


def parts(bands: int = 3, entries: int = 70) -> tuple[Meta, dict[str, np.ndarray]]:
    """Return a scene's meta.json and the pixels of its images, of random codes."""
    rng = np.random.default_rng(bands)
    images = {
        name: rng.integers(0, 256, (11, 14, 4)).astype(np.uint8)
        for name in ("means_l", "means_u", "scales", "quats", "sh0")
    }
    images["quats"][..., 3] = 252 + images["quats"][..., 3] % 4
    meta: Meta = {
        "version": 2,
        "count": COUNT,
        "antialias": False,
        "means": {"mins": [-2.5, -1, 0], "maxs": [1.5, 3, 0.5], "files": ["means_l", "means_u"]},
        "scales": {"codebook": np.sort(rng.normal(-4, 1, 256)).tolist(), "files": ["scales"]},
        "quats": {"files": ["quats"]},
        "sh0": {"codebook": np.sort(rng.normal(0, 1, 256)).tolist(), "files": ["sh0"]},
    }
    if bands:
        k = COEFFICIENTS[bands]
        images["palette"] = rng.integers(0, 256, (-(-entries // 64), 64 * k, 3)).astype(np.uint8)
        labels = rng.integers(0, entries, (11, 14))
        images["labels"] = np.zeros((11, 14, 3), np.uint8)
        images["labels"][..., 0] = labels & 255
        images["labels"][..., 1] = labels >> 8
        meta["shN"] = {
            "count": entries,
            "bands": bands,
            "codebook": np.sort(rng.normal(0, 0.1, 256)).tolist(),
            "files": ["palette", "labels"],
        }
    return meta, images


def bundled(path: Path, meta: object, files: dict[str, bytes], **options: Any) -> Path:
    method = options.get("method", zipfile.ZIP_STORED)
    with zipfile.ZipFile(path, "w", method) as archive:
        for name, data in files.items():
            archive.writestr(name, data)
        archive.writestr("meta.json", meta if isinstance(meta, str) else json.dumps(meta))
    return path


def saved(
    path: Path,
    meta: Meta,
    images: dict[str, np.ndarray],
    encode: Callable[[np.ndarray], bytes] = webp,
) -> Path:
    return bundled(path, meta, {name: encode(pixels) for name, pixels in images.items()})


def expected_row(meta: Meta, images: dict[str, np.ndarray], row: int) -> dict[str, list[float]]:
    """Decode one splat with plain numbers."""
    x, y = row % 14, row // 14
    pixel = {name: [int(v) for v in images[name][y, x]] for name in images if name != "palette"}
    means = []
    for axis in range(3):
        share = (pixel["means_u"][axis] * 256 + pixel["means_l"][axis]) / 65535
        low, high = meta["means"]["mins"][axis], meta["means"]["maxs"][axis]
        log = low + (high - low) * share
        means.append(math.copysign(math.exp(abs(log)) - 1, log))
    others = [(c / 255 - 0.5) * math.sqrt(2) for c in pixel["quats"][:3]]
    quat = others.copy()
    quat.insert(pixel["quats"][3] - 252, math.sqrt(max(0.0, 1 - sum(v * v for v in others))))
    alpha = pixel["sh0"][3] / 255
    logit = {0.0: -math.inf, 1.0: math.inf}.get(alpha)
    row_values = {
        "means": means,
        "scales": [meta["scales"]["codebook"][c] for c in pixel["scales"][:3]],
        "quats": quat,
        "opacities": [math.log(alpha / (1 - alpha)) if logit is None else logit],
        "sh0": [meta["sh0"]["codebook"][c] for c in pixel["sh0"][:3]],
        "shN": [],
    }
    if "shN" in meta:
        entry = pixel["labels"][0] + 256 * pixel["labels"][1]
        k = COEFFICIENTS[meta["shN"]["bands"]]
        for c in range(k):
            codes = images["palette"][entry // 64, entry % 64 * k + c]
            row_values["shN"] += [meta["shN"]["codebook"][int(code)] for code in codes]
    return row_values


def refused(path: Path) -> CogsplatError:
    with pytest.raises(CogsplatError) as caught:
        read_sog(path)
    assert str(path) in caught.value.message
    return caught.value


@pytest.mark.parametrize("encode", [webp, png])
@pytest.mark.parametrize("bands", [0, 1, 2, 3])
def test_decodes_as_plain_numbers_do(
    tmp_path: Path, bands: int, encode: Callable[[np.ndarray], bytes]
) -> None:
    meta, images = parts(bands)
    images["sh0"][0, :2, 3] = 0, 255
    splats = read_scene(saved(tmp_path / "a.sog", meta, images, encode))
    assert (len(splats), splats.sh_degree) == (COUNT, bands)
    for row in range(COUNT):
        for name, values in expected_row(meta, images, row).items():
            actual = getattr(splats, name)[row].reshape(-1)
            np.testing.assert_allclose(actual, values, rtol=2e-6, atol=1e-6, err_msg=name)


def test_a_folder_is_read_by_its_meta_json(tmp_path: Path) -> None:
    meta, images = parts()
    bundle = read_sog(saved(tmp_path / "a.sog", meta, images))
    (tmp_path / "scene").mkdir()
    with zipfile.ZipFile(tmp_path / "a.sog") as archive:
        archive.extractall(tmp_path / "scene")
    folder = read_scene(tmp_path / "scene" / "meta.json")
    for name in ("means", "scales", "quats", "opacities", "sh0", "shN"):
        np.testing.assert_array_equal(getattr(folder, name), getattr(bundle, name), name)


@pytest.mark.parametrize("rest", [0, 3, 8, 15])
@pytest.mark.parametrize("count", [1, 16, 17, 1000, 3000])
def test_round_trip(tmp_path: Path, count: int, rest: int) -> None:
    splats = scene(count, rest)
    write_scene(splats, tmp_path / "a.sog")
    read = read_scene(tmp_path / "a.sog")
    expected = splats.take(morton_order(splats.means))
    assert read.shN.shape == expected.shN.shape
    # 16 bits over a symmetric log of about -3 to 3.
    step = 6 / 65535 / 2 * (1 + np.abs(expected.means)) * 1.1
    assert (np.abs(read.means - expected.means) <= step).all()
    for name in ("scales", "sh0"):
        error = np.abs(getattr(read, name) - getattr(expected, name))
        assert error.max() < 0.25, name
        assert error.mean() < 0.01, name
    np.testing.assert_allclose(
        unit_opacities(read.opacities), unit_opacities(expected.opacities), atol=0.5 / 255 + 1e-6
    )
    norm = np.linalg.norm(expected.quats, axis=1)
    dots = np.abs((read.quats * expected.quats).sum(axis=1)) / norm
    assert dots.min() > 1 - 6e-5
    if rest:
        error = np.abs(read.shN - expected.shN)
        # A palette of two thirds of the splats; below 1024 there is an entry for each.
        assert error.mean() < (0.04 if count > 1024 else 0.0015)
        assert count > 1024 or error.max() < 0.03


def test_few_values_come_back_exactly(tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    splats = replace(
        scene(2000, 3),
        scales=rng.choice(np.float32([-5, -4.5, 1]), (2000, 3)),
        sh0=rng.choice(np.float32([0.25, -1]), (2000, 3)),
        shN=rng.choice(np.float32([0, 0.5]), (2000, 1, 1)).repeat(9, axis=1).reshape(2000, 3, 3),
        opacities=rng.choice(np.float32([-np.inf, np.inf]), 2000),
    )
    write_sog(splats, tmp_path / "a.sog")
    read = read_sog(tmp_path / "a.sog")
    expected = splats.take(morton_order(splats.means))
    for name in ("scales", "sh0", "shN", "opacities"):
        np.testing.assert_array_equal(getattr(read, name), getattr(expected, name), name)


def test_written_again_the_file_stays_the_same(tmp_path: Path) -> None:
    for name in ("a", "b"):
        write_sog(scene(1500), tmp_path / name)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_what_a_bundle_holds(tmp_path: Path) -> None:
    write_sog(scene(1500, 3), tmp_path / "a.sog")
    with zipfile.ZipFile(tmp_path / "a.sog") as archive:
        assert archive.testzip() is None
        meta = json.loads(archive.read("meta.json"))
        for entry in archive.infolist():
            assert entry.compress_type == zipfile.ZIP_STORED
            assert entry.date_time == (1980, 1, 1, 0, 0, 0)
            if entry.filename.endswith(".webp"):
                image = Image.open(io.BytesIO(archive.read(entry)))
                assert image.format == "WEBP"
                if entry.filename != "shN_centroids.webp":
                    assert image.size == (40, 40)
    assert (meta["version"], meta["count"], meta["antialias"]) == (2, 1500, False)
    assert meta["shN"]["count"] <= 1024
    for key in ("scales", "sh0", "shN"):
        assert len(meta[key]["codebook"]) == 256
    assert Image.open(io.BytesIO(zipfile.ZipFile(tmp_path / "a.sog").read("quats.webp"))).mode in (
        "RGBA",
    )


@pytest.mark.parametrize("degree", [0, 2])
def test_an_empty_scene(tmp_path: Path, degree: int) -> None:
    write_sog(empty(degree), tmp_path / "a.sog")
    read = read_sog(tmp_path / "a.sog")
    assert (len(read), read.sh_degree) == (0, degree)


def test_antialiasing_is_stored_and_other_metadata_gives_a_warning(tmp_path: Path) -> None:
    write_sog(scene(5, 3, SceneInfo(antialiased=True)), tmp_path / "a.sog")
    assert read_sog(tmp_path / "a.sog").info == SceneInfo(antialiased=True)
    meta, images = parts(0)
    for keys, flag in (({"antialias": True}, True), ({"model": "antialiased"}, True), ({}, False)):
        assert read_sog(saved(tmp_path / "b", {**meta, **keys}, images)).info.antialiased is flag
    info = SceneInfo((1.0, 2.0, 3.0), "RUB", "linear", 0.1)
    turned = replace(scene(50, 3), info=info)
    with pytest.warns(CogsplatWarning, match="origin.*linear.*kernel"):
        write_sog(turned, tmp_path / "c.sog")
    read = read_sog(tmp_path / "c.sog")
    assert read.info == SceneInfo()
    expected = convert_axes(turned, "RDF")
    expected = expected.take(morton_order(expected.means))
    np.testing.assert_allclose(read.means, expected.means, rtol=1e-3, atol=1e-3)
    np.testing.assert_allclose(read.shN, expected.shN, atol=0.03)


def test_a_lost_first_entry_is_continued(tmp_path: Path) -> None:
    meta, images = parts(0)
    codebook = meta["scales"]["codebook"]
    images["scales"][0, 0, 0] = 0
    meta["scales"]["codebook"] = [None, *codebook[1:]]
    read = read_sog(saved(tmp_path / "a.sog", meta, images))
    step = (codebook[1] - codebook[255]) / 255
    np.testing.assert_allclose(read.scales[0, 0], codebook[1] + step, rtol=1e-6)


def test_rows_that_cannot_be_drawn_are_not_written(tmp_path: Path) -> None:
    splats = replace(scene(3), scales=np.full((3, 3), np.inf, np.float32))
    with pytest.raises(DataError) as caught:
        write_sog(splats, tmp_path / "a.sog")
    assert caught.value.code == "invalid-rows"
    assert list(tmp_path.iterdir()) == []


def put(meta: Meta, path: str, value: object) -> None:
    *parents, key = path.split(".")
    for parent in parents:
        meta = meta[parent]
    if value is None:
        del meta[key]
    else:
        meta[key] = value


@pytest.mark.parametrize(
    ("key", "value", "code"),
    [
        ("version", 3, "sog-version"),
        ("version", None, "sog-version"),
        ("version", "2", "sog-bad-meta"),
        ("model", "2dgs", "sog-model"),
        ("antialias", 1, "sog-bad-meta"),
        ("count", None, "sog-bad-meta"),
        ("count", -1, "sog-bad-meta"),
        ("count", 1.5, "sog-bad-meta"),
        ("count", 155, "sog-image-size"),
        ("count", 10**8, "sog-image-size"),
        ("count", 10**400, "sog-bad-meta"),
        ("means", None, "sog-bad-meta"),
        ("means", [1], "sog-bad-meta"),
        ("means.mins", [1, 2], "sog-bad-meta"),
        ("means.mins", [1, 2, "3"], "sog-bad-meta"),
        ("means.mins", [1, 2, True], "sog-bad-meta"),
        ("means.files", ["means_l"], "sog-bad-meta"),
        ("means.files", ["means_l", 5], "sog-bad-meta"),
        ("means.files", ["means_l", "none"], "sog-missing-file"),
        ("means.files", ["means_l", "palette"], "sog-image-size"),
        ("scales.codebook", [], "sog-bad-meta"),
        ("scales.codebook", [0.0] * 257, "sog-bad-meta"),
        ("scales.codebook", [1e39] * 256, "sog-bad-meta"),
        ("scales.codebook", [0.0] * 5, "sog-bad-index"),
        ("scales.codebook", [0.0, None], "sog-bad-meta"),
        ("sh0.codebook", {}, "sog-bad-meta"),
        ("shN.bands", 4, "sog-bad-meta"),
        ("shN.bands", 2, "sog-image-size"),
        ("shN.count", 0, "sog-bad-meta"),
        ("shN.count", 65537, "sog-bad-meta"),
        ("shN.count", 60, "sog-bad-index"),
        ("shN.count", 129, "sog-image-size"),
        ("shN.files", ["palette"], "sog-bad-meta"),
        ("quats", None, "sog-bad-meta"),
        ("quats.files", ["sh0"], "sog-bad-quaternion"),
    ],
)
def test_messages_name_the_fault(tmp_path: Path, key: str, value: object, code: str) -> None:
    meta, images = parts()
    put(meta, key, value)
    error = refused(saved(tmp_path / "a.sog", meta, images))
    assert error.code == code
    assert "expected" in error.message


@pytest.mark.parametrize("text", ["", "[]", "{", '{"version": NaN}', "{" * 9999, '{"version": 2}'])
def test_meta_that_is_none(tmp_path: Path, text: str) -> None:
    assert refused(bundled(tmp_path / "a.sog", text, {})).code == "sog-bad-meta"


@pytest.mark.parametrize(
    "name", ["../a", "/etc/passwd", "a/../../b", "C:x", "a\\b", "a\0b", "", "http://x/y", "link"]
)
def test_a_folder_names_no_file_outside(tmp_path: Path, name: str) -> None:
    meta, images = parts(0)
    folder = tmp_path / "scene"
    folder.mkdir()
    for key, pixels in images.items():
        (folder / key).write_bytes(webp(pixels))
    (tmp_path / "a").write_bytes(webp(images["scales"]))
    (folder / "link").symlink_to(tmp_path / "a")
    meta["scales"]["files"] = [name]
    (folder / "meta.json").write_text(json.dumps(meta))
    assert refused(folder / "meta.json").code == "sog-file-name"


def test_files_that_are_no_sog(tmp_path: Path) -> None:
    path = tmp_path / "a.sog"
    for data in (b"", b"ply\n", b"\x89PNG"):
        path.write_bytes(data)
        assert refused(path).code == "sog-magic"
    path.write_bytes(b"PK\x03\x04 and so on")
    assert refused(path).code == "sog-zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("other", b"")
    assert refused(path).code == "sog-missing-file"


def test_bombs(tmp_path: Path) -> None:
    meta, images = parts(0)
    files = {name: webp(pixels) for name, pixels in images.items()}
    files["sh0"] = bytes(50_000_000)
    bomb = bundled(tmp_path / "a.sog", meta, files, method=zipfile.ZIP_DEFLATED)
    start_tracing()
    try:
        error = refused(bomb)
        assert tracemalloc.get_traced_memory()[1] < 5_000_000
    finally:
        tracemalloc.stop()
    assert isinstance(error, LimitError)
    assert error.code == "sog-zip-ratio"
    long = bundled(tmp_path / "b.sog", " " * 5_000_000 + "{}", files)
    assert refused(long).code == "sog-file-too-large"


def test_images_of_one_colour_do_not_make_millions_of_splats(tmp_path: Path) -> None:
    meta, _ = parts(0)
    flat = webp(np.full((4000, 4000, 4), 255, np.uint8))
    meta["count"] = 16_000_000
    files = dict.fromkeys(("means_l", "means_u", "scales", "quats", "sh0"), flat)
    assert refused(bundled(tmp_path / "a.sog", meta, files)).code == "decoded-size"
    meta["count"] = 100
    assert refused(bundled(tmp_path / "a.sog", meta, files)).code == "sog-image-size"


def test_an_image_that_claims_to_be_huge(tmp_path: Path) -> None:
    meta, images = parts(0)
    files = {name: webp(pixels) for name, pixels in images.items()}
    # The 14-bit sides of lossless WebP, behind its signature byte.
    files["sh0"] = files["sh0"][:21] + b"\xff\xff\xff\x1f" + files["sh0"][25:]
    assert refused(bundled(tmp_path / "a.sog", meta, files)).code == "image-too-large"


def test_encrypted_and_oddly_packed_entries(tmp_path: Path) -> None:
    meta, images = parts(0)
    files = {name: webp(pixels) for name, pixels in images.items()}
    packed = bundled(tmp_path / "a.sog", meta, files, method=zipfile.ZIP_BZIP2)
    assert refused(packed).code == "sog-zip-method"
    plain = bundled(tmp_path / "b.sog", meta, files)
    data = bytearray(plain.read_bytes())
    for signature, offset in ((b"PK\x03\x04", 6), (b"PK\x01\x02", 8)):
        at = data.find(signature)
        while at >= 0:
            data[at + offset] |= 1
            at = data.find(signature, at + 4)
    plain.write_bytes(data)
    error = refused(plain)
    assert isinstance(error, UnsupportedError)
    assert error.code == "sog-zip-method"


def test_lossy_and_foreign_images(tmp_path: Path) -> None:
    meta, images = parts(0)
    files = {name: webp(pixels) for name, pixels in images.items()}
    out = io.BytesIO()
    Image.fromarray(images["sh0"]).convert("RGB").save(out, "JPEG")
    frames = [Image.fromarray(images["sh0"]), Image.fromarray(images["scales"])]
    animation = io.BytesIO()
    frames[0].save(animation, "WEBP", save_all=True, append_images=frames[1:], lossless=True)
    lossy = webp(images["sh0"], lossless=False)
    opaque = webp(images["sh0"][..., :3], lossless=False)
    for data in (out.getvalue(), animation.getvalue(), lossy, opaque, b"", b"RIFF"):
        error = refused(bundled(tmp_path / "a.sog", meta, {**files, "sh0": data}))
        assert error.code == "image-format"
    for data, code in (
        (files["sh0"][:20], "image-truncated"),
        (files["sh0"][:-9], "image-damaged"),
    ):
        assert refused(bundled(tmp_path / "a.sog", meta, {**files, "sh0": data})).code == code


def test_images_keep_colours_behind_no_alpha() -> None:
    pixels = np.random.default_rng(1).integers(0, 256, (30, 20, 4)).astype(np.uint8)
    pixels[..., 3] = 0
    data = encode_image(pixels, "x")
    assert image_size(data, "x") == (20, 30)
    np.testing.assert_array_equal(decode_image(data, "x"), pixels)


def test_a_canvas_of_another_size(tmp_path: Path) -> None:
    simple = webp(np.zeros((3, 5, 3), np.uint8))

    def extended(width: int, height: int) -> bytes:
        size = (width - 1).to_bytes(3, "little") + (height - 1).to_bytes(3, "little")
        body = b"WEBPVP8X" + struct.pack("<I4x", 10) + size + simple[12:]
        return b"RIFF" + struct.pack("<I", len(body)) + body

    assert image_size(extended(5, 3), "x") == (5, 3)
    assert decode_image(extended(5, 3), "x").shape == (3, 5, 4)
    with pytest.raises(FormatError) as caught:
        image_size(extended(70_000, 3), "x")
    assert caught.value.code == "image-damaged"
    padded = b"RIFF\0\0\0\0WEBP" + b"junk\0\0\0\0" * 1000
    with pytest.raises(UnsupportedError):
        image_size(padded, "x")


@settings(
    deadline=None, max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.data())
def test_damaged_bundles_raise_only_cogsplat_errors(tmp_path: Path, data: st.DataObject) -> None:
    good = tmp_path / "good.sog"
    if not good.exists():
        saved(good, *parts(1))
    damaged = bytearray(good.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        # The ends of the file are where a ZIP keeps its structure.
        start = data.draw(st.sampled_from([0, len(damaged) - 800]))
        damaged[data.draw(st.integers(start, len(damaged) - 1))] = data.draw(st.integers(0, 255))
    if data.draw(st.booleans()):
        del damaged[data.draw(st.integers(0, len(damaged))) :]
    (tmp_path / "damaged.sog").write_bytes(damaged)
    with contextlib.suppress(CogsplatError):
        read_sog(tmp_path / "damaged.sog")


@settings(
    deadline=None, max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(st.data())
def test_damaged_images_and_numbers_raise_only_cogsplat_errors(
    tmp_path: Path, data: st.DataObject
) -> None:
    meta, images = parts(1)
    files = {name: webp(pixels) for name, pixels in images.items()}
    name = data.draw(st.sampled_from(sorted(files)))
    image = bytearray(files[name])
    for _ in range(data.draw(st.integers(0, 3))):
        image[data.draw(st.integers(0, len(image) - 1))] = data.draw(st.integers(0, 255))
    key = data.draw(st.sampled_from(["count", "means.mins", "shN.count", "sh0.codebook", "shN"]))
    wild = st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=3)
    put(meta, key, data.draw(wild | st.lists(wild, max_size=4) | st.dictionaries(st.text(), wild)))
    bundled(tmp_path / "damaged.sog", meta, {**files, name: bytes(image)})
    with contextlib.suppress(CogsplatError):
        read_sog(tmp_path / "damaged.sog")


def test_a_folder_holds_the_files_of_the_bundle(tmp_path: Path) -> None:
    splats = scene(50)
    write_scene(splats, tmp_path / "scene.sog")
    folder = tmp_path / "folder"
    folder.mkdir()
    write_scene(splats, folder / "meta.json")
    with zipfile.ZipFile(tmp_path / "scene.sog") as archive:
        inside = {name: archive.read(name) for name in archive.namelist()}
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == inside
    again, bundled_again = read_scene(folder / "meta.json"), read_scene(tmp_path / "scene.sog")
    np.testing.assert_array_equal(again.means, bundled_again.means)
    np.testing.assert_array_equal(again.shN, bundled_again.shN)


def test_existing_files_of_a_folder_are_kept_unless_forced(tmp_path: Path) -> None:
    (tmp_path / "sh0.webp").write_bytes(b"mine")
    with pytest.raises(CogsplatError) as caught:
        write_scene(scene(50), tmp_path / "meta.json")
    assert caught.value.code == "exists"
    assert [path.name for path in tmp_path.iterdir()] == ["sh0.webp"]
    assert (tmp_path / "sh0.webp").read_bytes() == b"mine"
    write_scene(scene(50), tmp_path / "meta.json", force=True)
    assert len(read_scene(tmp_path / "meta.json")) == 50
