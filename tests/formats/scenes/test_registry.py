from __future__ import annotations

import base64
import json
import zipfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cogsplat.codec.errors import FormatError, StorageError, UnsupportedError
from cogsplat.codec.splats import Splats, empty
from cogsplat.formats.cogs.layout import MAGIC
from cogsplat.formats.scenes import registry
from cogsplat.formats.scenes.registry import (
    FORMATS,
    Format,
    is_cogs,
    read_scene,
    scene_bytes,
    write_scene,
)
from cogsplat.formats.storage.atomic import StrPath
from cogsplat.formats.storage.limits import Limits
from cogsplat.tools.lab.synthetic.terrace import synth


def read_three(path: StrPath, *, limits: Limits | None = None) -> Splats:
    return empty(0, 3)


NARROW = Format(
    "narrow", (".narrow.ply",), lambda head: b"packed" in head, read_three, None
)  # fmt: skip


def test_every_format_is_named_once_and_has_extensions_of_its_own() -> None:
    names = [format_.name for format_ in FORMATS]
    extensions = [extension for format_ in FORMATS for extension in format_.extensions]
    assert len(set(names)) == len(names) > 0
    assert len(set(extensions)) == len(extensions)
    assert all(e.startswith(".") and e == e.lower() for e in extensions)


def test_writes_by_extension_and_reads_back(tmp_path: Path) -> None:
    path = tmp_path / "Scene.PLY"
    write_scene(empty(1, 5), path)
    assert len(read_scene(str(path))) == 5
    with pytest.raises(StorageError) as caught:
        write_scene(empty(1, 6), path)
    assert caught.value.code == "exists"
    write_scene(empty(1, 6), path, force=True)
    assert len(read_scene(path)) == 6


def test_first_bytes_go_before_the_extension(tmp_path: Path) -> None:
    write_scene(empty(0, 2), tmp_path / "a.ply")
    (tmp_path / "a.ply").rename(tmp_path / "a.splat")
    assert len(read_scene(tmp_path / "a.splat")) == 2


def test_an_extension_selects_the_reader_that_reports_the_error(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes(b"nothing")
    with pytest.raises(FormatError) as caught:
        read_scene(tmp_path / "a.ply")
    assert caught.value.code == "ply-magic"


def test_a_narrower_format_in_front_of_a_wider(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(registry, "FORMATS", (NARROW, *FORMATS))
    (tmp_path / "a.ply").write_bytes(b"ply\ncomment packed\n")
    assert len(read_scene(tmp_path / "a.ply")) == 3
    (tmp_path / "b.narrow.ply").write_bytes(b"?")
    assert len(read_scene(tmp_path / "b.narrow.ply")) == 3
    with pytest.raises(UnsupportedError, match=r"expected .* ply \(\.ply\)") as caught:
        write_scene(empty(0), tmp_path / "c.narrow.ply")
    assert caught.value.code == "read-only-format"


@pytest.mark.parametrize(
    ("head", "said"),
    [
        (b"", "an empty file"),
        (b"\x1f\x8b\x08\x00", "gzip"),
        (b"RAD0", "Spark RAD"),
        (b"version https://git-lfs.github.com/spec/v1\n", "Git LFS pointer"),
        (b"<!DOCTYPE html>", "markup"),
        (b"\x00\x01\x02", "00 01 02"),
        (MAGIC[::-1], "reverse byte order"),
    ],
)
def test_names_what_it_does_not_know(tmp_path: Path, head: bytes, said: str) -> None:
    path = tmp_path / "a.xyz"
    path.write_bytes(head)
    with pytest.raises(FormatError) as caught:
        read_scene(path)
    assert caught.value.code == "unknown-format"
    assert said in caught.value.message
    assert str(path) in caught.value.message
    assert ", expected " in caught.value.message
    assert " ply (.ply)" in caught.value.message


def test_unknown_extension_for_writing(tmp_path: Path) -> None:
    with pytest.raises(FormatError) as caught:
        write_scene(empty(0), tmp_path / "a.xyz")
    assert caught.value.code == "unknown-format"
    assert list(tmp_path.iterdir()) == []


def test_tells_a_cogs_file_apart(tmp_path: Path) -> None:
    ours, damaged, theirs = tmp_path / "a.bin", tmp_path / "b.COGS", tmp_path / "c.cogs"
    ours.write_bytes(MAGIC + bytes(60))
    damaged.write_bytes(MAGIC.replace(b"\r\n", b"\n"))
    write_scene(empty(0), tmp_path / "c.ply")
    (tmp_path / "c.ply").rename(theirs)
    assert [is_cogs(path) for path in (ours, damaged, theirs)] == [True, True, False]
    with pytest.raises(FormatError) as caught:
        read_scene(ours)
    assert caught.value.code == "cogs-file"


def test_missing_files(tmp_path: Path) -> None:
    for call in (read_scene, is_cogs):
        with pytest.raises(StorageError) as caught:
            call(tmp_path / "none.ply")
        assert caught.value.code == "not-found"


def test_splats_pass_through_unchanged(tmp_path: Path) -> None:
    splats = replace(empty(0, 4), means=np.arange(12, dtype=np.float32).reshape(4, 3))
    write_scene(splats, tmp_path / "a.ply")
    np.testing.assert_array_equal(read_scene(tmp_path / "a.ply").means, splats.means)


def test_extreme_quaternions_are_normalised_where_they_can_be(tmp_path: Path) -> None:
    quats = [[3, 0, 4, 0], [0, 0, 2e30, 0], [0, -1e-40, 0, 0], [0, 0, 0, 0], [np.inf, 1, 0, 0],
             [np.nan, 1e30, 0, 0]]  # fmt: skip
    splats = replace(empty(0, 6), quats=np.array(quats, np.float32))
    write_scene(splats, tmp_path / "a.ply")
    read = read_scene(tmp_path / "a.ply")
    expected = splats.quats.copy()
    expected[1:3] = [[0, 0, 1, 0], [0, -1, 0, 0]]
    np.testing.assert_array_equal(read.quats, expected)
    assert read.invalid_rows().tolist() == [False, False, False, True, True, True]


def test_the_bytes_of_a_scene_are_those_of_all_its_files(tmp_path: Path) -> None:
    splats = synth(1500)
    write_scene(splats, tmp_path / "a.ply")
    assert scene_bytes(tmp_path / "a.ply") == (tmp_path / "a.ply").stat().st_size
    write_scene(splats, tmp_path / "a.sog")
    assert scene_bytes(tmp_path / "a.sog") == (tmp_path / "a.sog").stat().st_size
    with zipfile.ZipFile(tmp_path / "a.sog") as archive:
        archive.extractall(tmp_path / "sog")
        unpacked = sum(entry.file_size for entry in archive.infolist())
    assert scene_bytes(tmp_path / "sog" / "meta.json") == unpacked
    write_scene(splats, tmp_path / "a.gltf")
    inside = (tmp_path / "a.gltf").stat().st_size
    assert scene_bytes(tmp_path / "a.gltf") == inside
    text = json.loads((tmp_path / "a.gltf").read_text())
    _, _, data = text["buffers"][0]["uri"].partition(",")
    (tmp_path / "the data.bin").write_bytes(base64.b64decode(data))
    text["buffers"][0]["uri"] = "the%20data.bin"
    text["buffers"].append({"byteLength": 9, "uri": "not-there.bin"})
    (tmp_path / "b.gltf").write_text(json.dumps(text))
    size = sum((tmp_path / name).stat().st_size for name in ("b.gltf", "the data.bin"))
    assert scene_bytes(tmp_path / "b.gltf") == size
    assert len(read_scene(tmp_path / "b.gltf")) == 1500
