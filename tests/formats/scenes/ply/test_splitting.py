"""Parts of a PLY: every row in one of them, bit for bit."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import plyfile
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from random_splats import random_splats

from cogsplat.codec.errors import CogsplatError
from cogsplat.codec.splats import SceneInfo
from cogsplat.formats.scenes.ply import splitting
from cogsplat.formats.scenes.ply.header import parse_header
from cogsplat.formats.scenes.ply.ply_scene import read_ply, write_ply
from cogsplat.formats.scenes.ply.splitting import plan_parts, write_parts

NAMES = (
    *("number", "x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"),
    *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3", "label"),
)
ROW = np.dtype([(name, "<u4" if name == "number" else "<f4") for name in NAMES[:-1]]
               + [("label", "u1")])  # fmt: skip
TYPES = {"u4": "uint", "f4": "float", "u1": "uchar"}
HEADER = "\r\n".join(
    [
        "ply",
        "format binary_little_endian 1.0",
        "comment element vertex 77",
        "obj_info kept",
        "element  vertex 00{}",
        *(f"property {TYPES[ROW[name].str[1:]]} {name}" for name in NAMES),
        "end_header\r\n",
    ]
)


def write_rows(path: Path, centres: np.ndarray, seed: int = 0) -> np.ndarray:
    """Write a PLY of rows of random bits with numbers and centres; return the rows."""
    bits = np.random.default_rng(seed).integers(0, 256, len(centres) * ROW.itemsize, np.uint8)
    rows = bits.view(ROW)
    rows["number"] = np.arange(len(rows))
    for axis, name in enumerate("xyz"):
        rows[name] = centres[:, axis]
    path.write_bytes(HEADER.format(len(rows)).encode() + rows.tobytes())
    return rows


def split(path: Path, most: int) -> list[np.ndarray]:
    """Split a PLY; return the rows of the parts, after checking their headers."""
    parts = plan_parts(path, most)
    outputs = [path.with_name(f"{number}.ply") for number in range(len(parts.counts))]
    write_parts(path, parts, outputs, force=True)
    found = []
    for output, count in zip(outputs, parts.counts, strict=True):
        head = HEADER.replace("element  vertex 00{}", f"element vertex {count}").encode()
        data = output.read_bytes()
        assert data.startswith(head)
        found.append(np.frombuffer(data[len(head) :], ROW))
        assert len(found[-1]) == count
    return found


# Each part is synced to the disk, so that scenes of many parts would take long.
@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    count=st.integers(1, 400),
    most=st.integers(30, 200),
    grid=st.sampled_from([0.0, 0.5, 4.0]),
    nan=st.integers(0, 20),
    sample=st.sampled_from([64, 256, 1 << 20]),
    block=st.sampled_from([1000, 1 << 22]),
    passes=st.sampled_from([1, 3, 128]),
)
def test_each_row_is_in_one_part_bit_for_bit(
    tmp_path: Path,
    count: int,
    most: int,
    grid: float,
    nan: int,
    sample: int,
    block: int,
    passes: int,
) -> None:
    random = np.random.default_rng(count)
    centres = random.normal(0, (9.0, 5.0, 1.0), (count, 3)).astype(np.float32)
    if grid:
        centres = np.rint(centres / grid) * grid
    lost = random.integers(0, count, nan)
    centres[lost, nan % 3] = np.nan
    path = tmp_path / "scene.ply"
    rows = write_rows(path, centres, count)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(splitting, "_SAMPLE", sample)
        patch.setattr(splitting, "_BLOCK_BYTES", block)
        patch.setattr(splitting, "_OPEN_PARTS", passes)
        found = split(path, most)
        again = split(path, most)
    for part, same in zip(found, again, strict=True):
        assert part.tobytes() == same.tobytes()
        assert (np.diff(part["number"].astype(int)) > 0).all()
    joined = np.concatenate(found)
    assert joined[np.argsort(joined["number"])].tobytes() == rows.tobytes()
    assert set(lost.tolist()) <= set(found[0]["number"].tolist())
    if not grid and not nan:
        assert max(map(len, found)) <= 1.25 * most


def test_a_misleading_sample_is_made_up_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Runs of 64 rows of every 128 see the first half of the scene alone."""
    monkeypatch.setattr(splitting, "_SAMPLE", 1024)
    centres = np.random.default_rng(1).uniform(0, 1, (2048, 3))
    centres.reshape(-1, 2, 64, 3)[:, 1, :, 0] += 10.0
    write_rows(tmp_path / "scene.ply", centres)
    sizes = [len(part) for part in split(tmp_path / "scene.ply", 300)]
    assert sum(sizes) == 2048
    assert max(sizes) <= 375


def test_centres_of_a_part_come_from_the_part(tmp_path: Path) -> None:
    centres = np.random.default_rng(2).uniform(0, 1, (500, 3)).astype(np.float32)
    write_rows(tmp_path / "scene.ply", centres)
    parts = plan_parts(tmp_path / "scene.ply", 100)
    for sample, part in zip(parts.samples, split(tmp_path / "scene.ply", 100), strict=True):
        np.testing.assert_array_equal(sample, np.stack([part[axis] for axis in "xyz"], axis=1))


def test_comments_stay_with_each_part(tmp_path: Path) -> None:
    info = SceneInfo(origin=(500000.0, 4.0, 7.0), antialiased=True)
    splats = random_splats(300, 3)
    write_ply(replace(splats, info=info), tmp_path / "scene.ply")
    parts = plan_parts(tmp_path / "scene.ply", 100)
    outputs = [tmp_path / f"{number}.ply" for number in range(len(parts.counts))]
    write_parts(tmp_path / "scene.ply", parts, outputs)
    assert [read_ply(output).info for output in outputs] == [info] * 4
    assert sum(len(read_ply(output)) for output in outputs) == 300


def text_ply(path: Path) -> None:
    data = plyfile.PlyData.read(path, mmap=False)
    plyfile.PlyData(data.elements, text=True).write(path)


def big_endian_ply(path: Path) -> None:
    data = plyfile.PlyData.read(path, mmap=False)
    plyfile.PlyData(data.elements, byte_order=">").write(path)


def ply_with_faces(path: Path) -> None:
    table = np.zeros(2, [("flag", "u1")])
    elements = [
        *plyfile.PlyData.read(path, mmap=False).elements,
        plyfile.PlyElement.describe(table, "face"),
    ]
    plyfile.PlyData(elements, byte_order="<").write(path)


def ply_of_doubles(path: Path) -> None:
    write_ply(read_ply(path), path, force=True, absolute=True)


@pytest.mark.parametrize("change", [text_ply, big_endian_ply, ply_with_faces, ply_of_doubles])
def test_other_layouts_are_refused(tmp_path: Path, change) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "scene.ply"
    write_ply(random_splats(20, 0), path)
    change(path)
    assert len(read_ply(path)) == 20
    with pytest.raises(CogsplatError, match="expected binary_little_endian with") as error:
        plan_parts(path, 10)
    assert error.value.code == "ply-not-plain"


@pytest.mark.parametrize(
    ("change", "code"),
    [
        (lambda data: data[:-1], "ply-truncated"),
        (lambda data: data + b"\0", "ply-trailing-bytes"),
        (lambda data: data.replace(b"opacity", b"opacitx"), "ply-missing-property"),
        (lambda data: b"x" + data, "ply-magic"),
    ],
)
def test_damaged_files_are_refused(tmp_path: Path, change, code: str) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "scene.ply"
    write_ply(random_splats(20, 0), path)
    path.write_bytes(change(path.read_bytes()))
    with pytest.raises(CogsplatError) as error:
        plan_parts(path, 10)
    assert error.value.code == code


def test_a_file_that_changes_is_refused_and_leaves_no_part(tmp_path: Path) -> None:
    path = tmp_path / "scene.ply"
    write_rows(path, np.random.default_rng(3).normal(size=(400, 3)))
    parts = plan_parts(path, 100)
    outputs = [tmp_path / f"{number}.ply" for number in range(4)]

    def touch(stage: str, done: int, total: int) -> None:
        os.utime(path, ns=(1, 1))

    for progress in (touch, splitting.silent):
        with pytest.raises(CogsplatError) as error:
            write_parts(path, parts, outputs, progress=progress)
        assert error.value.code == "file-changed"
        assert [found.name for found in tmp_path.iterdir()] == ["scene.ply"]
    with pytest.raises(CogsplatError) as error:
        plan_parts(path, 100, progress=lambda *_: os.utime(path))
    assert error.value.code == "file-changed"


def test_an_existing_part_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "scene.ply"
    write_rows(path, np.random.default_rng(3).normal(size=(400, 3)))
    parts = plan_parts(path, 100)
    outputs = [tmp_path / f"{number}.ply" for number in range(4)]
    outputs[2].write_bytes(b"mine")
    with pytest.raises(CogsplatError) as error:
        write_parts(path, parts, outputs)
    assert error.value.code == "exists"
    assert sorted(found.name for found in tmp_path.iterdir()) == ["2.ply", "scene.ply"]
    assert outputs[2].read_bytes() == b"mine"


def test_a_scene_without_splats_is_one_part(tmp_path: Path) -> None:
    write_rows(tmp_path / "scene.ply", np.zeros((0, 3)))
    assert [len(part) for part in split(tmp_path / "scene.ply", 5)] == [0]
    assert parse_header((tmp_path / "0.ply").read_bytes(), "part").elements[0].count == 0
