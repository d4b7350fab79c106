"""Our reader against the conformance files: bits of valid files, reason codes of invalid files."""

import hashlib
import itertools
import json
import random
import re
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

import cogsplat
from cogsplat.codec.cameras import Camera
from cogsplat.codec.errors import CogsplatError, TruncatedError
from cogsplat.codec.render.rasteriser import render
from cogsplat.formats.cogs.description_json import to_json
from cogsplat.formats.cogs.folder_source import FolderSource
from cogsplat.formats.cogs.known_chunks import known_chunks
from cogsplat.formats.cogs.reader import open_cogs
from cogsplat.formats.cogs.scene_index import read_scene_index
from cogsplat.formats.storage.source import BytesSource
from cogsplat.tools.lab import make_vectors
from cogsplat.tools.lab.conformance import tolerance

VECTORS = Path(__file__).resolve().parent / "vectors"
MANIFEST = json.loads((VECTORS / "manifest.json").read_text(encoding="utf-8"))
VALID = MANIFEST["valid"]
INVALID = MANIFEST["invalid"]
FOLDERS = MANIFEST["folders"]
INVALID_FOLDERS = MANIFEST["invalid_folders"]
DRAWINGS = MANIFEST["drawings"]
ARRAYS = MANIFEST["arrays"]

# A part may be cut: this file has another fault behind its cut.
PART_CODES = {"order-cut-splats": "splat-count"}


def name_of(entry):
    return entry["name"]


def data_of(folder, entry):
    return (VECTORS / folder / f"{entry['name']}.cogs").read_bytes()


def arrays_of(entry):
    values = np.fromfile(VECTORS / "valid" / f"{entry['name']}.f32", "<f4")
    out, start = {}, 0
    for name in ARRAYS:
        shape = entry["shapes"][name]
        stop = start + int(np.prod(shape))
        out[name] = values[start:stop].reshape(shape)
        start = stop
    assert start == len(values)
    return out


def assert_rows(splats, arrays, rows):
    """Assert that a decoded scene equals rows of the expected arrays, bit by bit."""
    for name in ARRAYS:
        actual, expected = getattr(splats, name), arrays[name][rows]
        assert actual.shape == expected.shape, name
        assert np.array_equal(actual.view(np.uint32), expected.view(np.uint32)), name


def coarse_of(entry):
    """Return the arrays decoded from heads alone, checked against the manifest's hash."""
    with open_cogs(BytesSource(data_of("valid", entry))) as file:
        splats = file.decode(refine=False)
    arrays = {name: getattr(splats, name) for name in ARRAYS}
    digest = hashlib.sha256(b"".join(a.astype("<f4").tobytes() for a in arrays.values()))
    assert digest.hexdigest() == entry.get("coarse_sha256", entry["arrays_sha256"])
    return arrays


def digest(splats):
    """Return the SHA-256 of a decoded scene's concatenated arrays."""
    values = b"".join(getattr(splats, name).astype("<f4").tobytes() for name in ARRAYS)
    return hashlib.sha256(values).hexdigest()


def counts_of(entry):
    """Return the splats per chunk that the whole file draws: 0 for a chunk that has ended."""
    until = entry.get("until", [0] * len(entry["chunk_splats"]))
    return [0 if end else count for count, end in zip(entry["chunk_splats"], until, strict=True)]


def refusal(call):
    try:
        call()
    except CogsplatError as error:
        return error
    return None


def clause_of(error):
    stated = getattr(error, "clause", "")
    return stated or re.search(r"SPEC (\d+\.\d+)", error.message)[1]


def test_there_are_files_and_the_manifest_lists_them_all():
    listed = {"README.md", "manifest.json"}
    for entry in VALID:
        listed |= {f"valid/{entry['name']}.cogs", f"valid/{entry['name']}.f32"}
    listed |= {f"invalid/{entry['name']}.cogs" for entry in INVALID}
    for entry in DRAWINGS:
        listed |= {f"drawings/{entry['scene']}.cogs", f"drawings/{entry['name']}.f32"}
    # What the objects of a folder are called follows from their bytes.
    named = {f"folders/{entry['name']}" for entry in FOLDERS}
    named |= {f"invalid-folders/{entry['name']}" for entry in INVALID_FOLDERS}
    inside = {path for path in VECTORS.glob("*folders/**/*") if path.is_file()}
    assert {path.relative_to(VECTORS).as_posix().rsplit("/segments")[0].removesuffix(
        f"/{path.name}") for path in inside} == named  # fmt: skip
    listed |= {path.relative_to(VECTORS).as_posix() for path in inside}
    there = {path.relative_to(VECTORS).as_posix() for path in VECTORS.rglob("*") if path.is_file()}
    assert there == listed
    assert len(VALID) >= 12
    assert len(INVALID) >= 50
    names = [
        (folder, entry["name"]) for folder in ("valid", "invalid") for entry in MANIFEST[folder]
    ]
    assert len(names) == len(set(names))


@pytest.mark.parametrize("folder", ["valid", "invalid"])
def test_files_are_those_of_the_manifest(folder):
    for entry in MANIFEST[folder]:
        data = data_of(folder, entry)
        assert (len(data), hashlib.sha256(data).hexdigest()) == (entry["bytes"], entry["sha256"])
    for entry in VALID:
        arrays = (VECTORS / "valid" / f"{entry['name']}.f32").read_bytes()
        assert hashlib.sha256(arrays).hexdigest() == entry["arrays_sha256"]


def test_files_are_what_the_generator_makes():
    assert make_vectors.differences() == []


@pytest.mark.parametrize("entry", VALID, ids=name_of)
def test_valid_file_decodes_to_the_bit(entry, kernels):
    with open_cogs(BytesSource(data_of("valid", entry))) as file:
        file.verify()
        assert file.chunks.splats.tolist() == entry["chunk_splats"]
        assert file.root.sh_degree == entry["sh_degree"]
        assert file.missing_bytes == 0
        arrays = arrays_of(entry)
        for threads in (1, 3):
            assert_rows(file.decode(threads=threads), arrays, slice(None))


@pytest.mark.parametrize("entry", VALID, ids=name_of)
def test_heads_alone_decode_to_the_bit(entry, kernels):
    assert coarse_of(entry).keys() == arrays_of(entry).keys()


@pytest.mark.parametrize("entry", VALID, ids=name_of)
def test_root_says_what_the_manifest_says(entry):
    info = dict(entry["info"])
    with open_cogs(BytesSource(data_of("valid", entry))) as file:
        found = file.root.info
        assert list(found.origin) == info["origin"]
        for key in ("axes", "colour_space", "kernel_px", "antialiased"):
            assert getattr(found, key) == info[key]
        view, expected = file.root.first_view, info.get("first_view")
        assert (view is None) == (expected is None)
        if view is not None and expected is not None:
            for key in ("width", "height", "fx", "fy", "cx", "cy"):
                assert getattr(view, key) == expected[key]
            assert view.rotation.ravel().tolist() == expected["rotation"]
            assert view.translation.tolist() == expected["translation"]
            target = None if view.target is None else view.target.tolist()
            assert target == expected.get("target")
        for key in ("up", "core_box"):
            value = getattr(file.root, key)
            assert (None if value is None else value.tolist()) == info.get(key)


@pytest.mark.parametrize("entry", VALID, ids=name_of)
def test_attributes_and_cameras_come_to_the_bit(entry):
    kinds = entry.get("attributes", [])
    chunks = dict(entry.get("attribute_chunks", []))
    with open_cogs(BytesSource(data_of("valid", entry))) as file:
        assert [[k.name, k.dtype, k.components] for k in file.root.attributes] == kinds
        for chunk in range(file.num_chunks):
            assert file.has_extras(chunk) == (chunk in chunks)
            extras = file.decode([chunk]).extras
            assert list(extras) == ([name for name, _, _ in kinds] if chunk in chunks else [])
            rows = [values.astype(values.dtype.newbyteorder("<")) for values in extras.values()]
            found = [hashlib.sha256(values.tobytes()).hexdigest() for values in rows]
            assert found == chunks.get(chunk, [])
            assert not file.decode([chunk], extras=False).extras
        assert bool(file.decode().extras) == (bool(kinds) and len(chunks) == file.num_chunks)
        cameras = file.cameras()
        assert len(cameras) == len(entry.get("cameras", []))
        for camera, expected in zip(cameras, entry.get("cameras", []), strict=True):
            for key in ("name", "width", "height", "fx", "fy", "cx", "cy"):
                assert getattr(camera, key) == expected[key]
            assert camera.rotation.ravel().tolist() == expected["rotation"]
            assert camera.translation.tolist() == expected["translation"]


@pytest.mark.parametrize("entry", VALID, ids=name_of)
def test_view_tables_come_to_the_bit(entry):
    with open_cogs(BytesSource(data_of("valid", entry))) as file:
        tables = [(path, file.view_table(path)) for path in file.view_table_rows]
    found = []
    for path, table in tables:
        assert table is not None
        columns = (table.positions.tolist(), table.shares.tolist())
        found.append([list(path), [list(row) for row in zip(*columns, strict=True)]])
    assert found == entry.get("view_tables", [])


@pytest.mark.parametrize("entry", [x for x in VALID if "parents" in x], ids=name_of)
def test_parents_are_in_indices_above(entry):
    index = read_scene_index(BytesSource(data_of("valid", entry)), partial=False)
    expected = [-1 if parent is None else parent for parent in entry["parents"]]
    assert known_chunks(index).parents.tolist() == expected


@pytest.mark.parametrize("entry", VALID, ids=name_of)
def test_descriptions_and_pictures_come_to_the_bit(entry):
    expected = entry.get("description")
    with open_cogs(BytesSource(data_of("valid", entry))) as file:
        description = file.description(pictures=True)
    assert (description is None) == (expected is None)
    if description is not None:
        # A key of a later version is skipped.
        assert to_json(description) == {k: v for k, v in expected.items() if k != "mood"}
        found = {
            name: [
                picture.media_type,
                picture.width,
                picture.height,
                hashlib.sha256(picture.data).hexdigest(),
            ]
            for name, picture in description.pictures().items()
        }
        assert found == entry["pictures"]


@pytest.mark.parametrize("entry", VALID, ids=name_of)
def test_first_chunks_are_compensated_to_the_bit(entry):
    expected = dict(entry.get("compensated", []))
    with open_cogs(BytesSource(data_of("valid", entry))) as file:
        assert bool(file.compensation().layers) == bool(expected)
        for chunks in range(1, file.num_chunks + 1):
            found = file.decode(range(chunks), compensate=True)
            if expected:
                until = np.array(entry.get("until", [0] * file.num_chunks))[:chunks]
                kept = np.repeat((until == 0) | (until > chunks), file.chunks.splats[:chunks])
                values = [found.scales[kept].astype("<f4"), found.opacities[kept].astype("<f4")]
                data = b"".join(part.tobytes() for part in values)
                assert hashlib.sha256(data).hexdigest() == expected[chunks]
            stored = file.decode(range(chunks))
            for name in ("means", "quats", "sh0", "shN"):
                np.testing.assert_array_equal(getattr(found, name), getattr(stored, name))


@pytest.mark.parametrize("entry", VALID, ids=name_of)
def test_sets_of_chunks_are_compensated_to_the_bit(entry):
    expected = entry.get("compensated_sets", [])
    with open_cogs(BytesSource(data_of("valid", entry))) as file:
        is_cut = bool(len(file.chunks.cell)) and bool(file.chunks.cell.all())
        assert bool(expected) == (is_cut and "compensated" in entry)
        for chunks, sha256 in expected:
            found = file.decode(chunks, compensate=True)
            values = [found.scales.astype("<f4"), found.opacities.astype("<f4")]
            data = b"".join(part.tobytes() for part in values)
            assert hashlib.sha256(data).hexdigest() == sha256


@pytest.mark.parametrize("entry", VALID, ids=name_of)
def test_chunks_alone_in_any_order_are_rows_of_the_whole(entry, kernels):
    arrays = arrays_of(entry)
    counts = counts_of(entry)
    ends = np.cumsum([0, *counts])
    order = [chunk for chunk, count in enumerate(counts) if count]
    random.Random(4).shuffle(order)
    with open_cogs(BytesSource(data_of("valid", entry))) as file:
        for chunk in order:
            assert_rows(file.decode([chunk]), arrays, slice(ends[chunk], ends[chunk + 1]))
        rows = [row for chunk in order for row in range(ends[chunk], ends[chunk + 1])]
        assert_rows(file.decode(order), arrays, np.array(rows, np.int64))


@pytest.mark.parametrize("entry", VALID, ids=name_of)
def test_lower_degrees_are_the_first_coefficients(entry, kernels):
    arrays = arrays_of(entry)
    with open_cogs(BytesSource(data_of("valid", entry))) as file:
        for degree in range(entry["sh_degree"]):
            splats = file.decode(sh_degree=degree)
            cut = {**arrays, "shN": arrays["shN"][:, : (degree + 1) ** 2 - 1]}
            assert_rows(splats, cut, slice(None))


@pytest.mark.parametrize("entry", [e for e in VALID if "levels" in e], ids=name_of)
def test_levels_decode_to_the_bit(entry, kernels):
    with open_cogs(BytesSource(data_of("valid", entry))) as file:
        levels = [(level.scale, level.chunks) for level in file.root.levels]
        assert levels == [(scale, chunks) for scale, chunks, _ in entry["levels"]]
        for level, (_, _, sha256) in enumerate(entry["levels"]):
            assert digest(file.decode(level=level)) == sha256


@pytest.mark.parametrize("entry", VALID, ids=name_of)
def test_prefixes_give_the_chunks_that_are_complete(entry):
    data = data_of("valid", entry)
    arrays = arrays_of(entry)
    ends = np.cumsum([0, *entry["chunk_splats"]])
    coarse = coarse_of(entry)
    nexts = [size for size, *_ in entry["prefixes"][1:]] + [len(data)]
    drawn = entry.get("drawn", [None] * len(nexts))
    for (size, chunks, tails, refined), end, sha256 in zip(
        entry["prefixes"], nexts, drawn, strict=True
    ):
        if sha256 is not None:
            for length in {size, max(end - 1, size)}:
                with open_cogs(BytesSource(data[:length]), partial=True) as file:
                    assert file.complete_chunks() == chunks
                    assert digest(file.decode()) == sha256
            continue
        expected = {name: array[: ends[chunks]].copy() for name, array in arrays.items()}
        for chunk in range(chunks):
            rows = slice(ends[chunk], ends[chunk + 1])
            if chunk not in refined:
                for name in ARRAYS:
                    expected[name][rows] = coarse[name][rows]
            if chunk not in tails:
                expected["shN"][rows] = 0
        for length in {size, max(end - 1, size)}:
            with open_cogs(BytesSource(data[:length]), partial=True) as file:
                assert file.complete_chunks() == chunks
                assert file.missing_bytes == len(data) - length
                assert_rows(file.decode(), expected, slice(None))
    first = entry["prefixes"][0][0]
    with pytest.raises(TruncatedError):
        open_cogs(BytesSource(data[: first - 1]), partial=True)


@pytest.mark.parametrize("entry", VALID, ids=name_of)
def test_short_files_are_refused_where_all_is_expected(entry):
    data = data_of("valid", entry)
    for length in random.Random(len(data)).sample(range(len(data)), 20):
        with pytest.raises(TruncatedError):
            open_cogs(BytesSource(data[:length]))


@pytest.mark.parametrize("entry", INVALID, ids=name_of)
def test_invalid_file_is_refused_with_its_code(entry, kernels):
    data = data_of("invalid", entry)
    stages = ["open", "decode", "verify"]

    def up_to(stage):
        with open_cogs(BytesSource(data)) as file:
            if stage != "open":
                file.decode()
            if stage == "verify":
                file.verify()

    for stage in itertools.takewhile(lambda s: s != entry["stage"], stages):
        up_to(stage)
    error = refusal(lambda: up_to(entry["stage"]))
    assert error is not None
    assert (error.code, clause_of(error)) == (entry["code"], entry["clause"])


@pytest.mark.parametrize("entry", INVALID, ids=name_of)
def test_invalid_file_is_refused_as_a_part_too(entry):
    data = data_of("invalid", entry)
    error = refusal(lambda: open_cogs(BytesSource(data), partial=True).decode())
    if entry["stage"] == "verify" or entry["partial"]:
        assert error is None
    else:
        assert error is not None
        assert error.code == PART_CODES.get(entry["name"], entry["code"])


@pytest.mark.parametrize("entry", FOLDERS, ids=name_of)
def test_folder_is_the_file_that_it_stands_for(entry):
    for manifest, name in entry["manifests"].items():
        source = FolderSource(VECTORS / "folders" / entry["name"] / manifest)
        data = (VECTORS / "valid" / f"{name}.cogs").read_bytes()
        assert source.read(0, source.size) == data
        with open_cogs(source) as file:
            file.verify()


@pytest.mark.parametrize("entry", INVALID_FOLDERS, ids=name_of)
def test_invalid_folder_is_refused_with_its_code(entry):
    stages = ["open", "decode", "verify"]

    def up_to(stage, partial=False):
        with closing(FolderSource(VECTORS / "invalid-folders" / entry["name"])) as source:
            file = open_cogs(source, partial=partial)
            if stage != "open":
                file.decode()
            if stage == "verify":
                file.verify()

    for stage in itertools.takewhile(lambda s: s != entry["stage"], stages):
        up_to(stage)
    error = refusal(lambda: up_to(entry["stage"]))
    assert error is not None
    assert (error.code, clause_of(error)) == (entry["code"], entry["clause"])
    as_part = refusal(lambda: up_to("decode", partial=True))
    assert (as_part is None) == (entry["partial"] or entry["stage"] == "verify")


@pytest.mark.parametrize("entry", DRAWINGS, ids=name_of)
def test_pictures_are_those_of_the_reference(entry):
    data = (VECTORS / "drawings" / f"{entry['name']}.f32").read_bytes()
    assert hashlib.sha256(data).hexdigest() == entry["sha256"]
    camera = {k: np.array(v) if isinstance(v, list) else v for k, v in entry["camera"].items()}
    camera["rotation"] = camera["rotation"].reshape(3, 3)
    with cogsplat.open(VECTORS / "drawings" / f"{entry['scene']}.cogs") as file:
        file.verify()
        picture = render(file.decode(), Camera(**camera))
    expected = np.frombuffer(data, "<f4").reshape(picture.shape)
    assert tolerance.picture_fault(picture, expected, is_viewer=False) == ""
    # What SPEC B.4 says of float32.
    assert np.abs(picture - expected).max() < 1e-5


def test_every_clause_that_can_be_broken_has_files():
    covered = {clause for entry in VALID for clause in entry["clauses"]}
    broken = {entry["clause"] for entry in [*INVALID, *INVALID_FOLDERS]}
    rules = {f"{chapter}.{part}" for chapter, last in ((3, 4), (5, 12), (6, 17), (7, 5))
             for part in range(1, last + 1)}  # fmt: skip
    assert rules - covered - broken == set()
    assert {"4.1", "4.2", "4.3", "4.4"} <= broken
