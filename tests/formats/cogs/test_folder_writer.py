"""Files into folders and back: byte for byte, shared by versions, whole or not at all."""

from dataclasses import replace
from pathlib import Path

import pytest
from cogs_samples import file_of

import cogsplat
from cogsplat.codec.errors import (
    Cancelled,
    CogsplatWarning,
    FormatError,
    StorageError,
    TruncatedError,
)
from cogsplat.formats.cogs import layout
from cogsplat.formats.cogs.folder_writer import check_manifest_name, pack_cogs, unpack_cogs
from cogsplat.formats.cogs.layout import SegmentKind
from cogsplat.formats.cogs.writer import Segment, write_cogs
from cogsplat.tools.lab.conformance.reference_folders import (
    MANIFEST,
    file_of_folder,
    folder_of_file,
)

VALID = sorted((Path(__file__).resolve().parents[2] / "vectors" / "valid").glob("*.cogs"))


def contents(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


@pytest.mark.parametrize("path", VALID, ids=lambda path: path.stem)
def test_every_file_comes_back_byte_for_byte(path: Path, tmp_path: Path) -> None:
    with cogsplat.open(path) as file:
        done = unpack_cogs(file, tmp_path / "out")
    found = contents(tmp_path / "out")
    # The oracle takes files apart on its own.
    assert found == folder_of_file(path.read_bytes())
    assert file_of_folder(found) == path.read_bytes()
    assert done.written == len(found) - 1
    assert done.shared == 0
    assert done.written_bytes + done.manifest_bytes == sum(map(len, found.values()))
    with cogsplat.open(tmp_path / "out") as folder:
        assert pack_cogs(folder, tmp_path / "back.cogs") == path.stat().st_size
    assert (tmp_path / "back.cogs").read_bytes() == path.read_bytes()


def test_versions_share_objects(tmp_path: Path) -> None:
    by_name = {path.stem: path for path in VALID}
    folder = tmp_path / "both"
    with cogsplat.open(by_name["attributes"]) as file:
        first = unpack_cogs(file, folder, name="first.cogsm")
    with cogsplat.open(by_name["attributes-pages"]) as file:
        second = unpack_cogs(file, folder, name="second.cogsm")
    # The second has a page more.
    assert (first.written, second.shared, second.written) == (2, 2, 3)
    for name, stem in {"first.cogsm": "attributes", "second.cogsm": "attributes-pages"}.items():
        with cogsplat.open(folder / name) as file:
            pack_cogs(file, tmp_path / "back.cogs", force=True)
        assert (tmp_path / "back.cogs").read_bytes() == by_name[stem].read_bytes()


def test_a_manifest_is_replaced_only_where_that_is_asked_for(scene: Path, tmp_path: Path) -> None:
    with cogsplat.open(scene) as file:
        unpack_cogs(file, tmp_path / "out")
        with pytest.raises(StorageError) as refused:
            unpack_cogs(file, tmp_path / "out")
        assert refused.value.code == "exists"
        again = unpack_cogs(file, tmp_path / "out", force=True)
    assert (again.written, again.shared) == (0, len(contents(tmp_path / "out")) - 1)


def test_damaged_objects_and_links_are_replaced(scene: Path, tmp_path: Path) -> None:
    with cogsplat.open(scene) as file:
        unpack_cogs(file, tmp_path / "out")
    good = contents(tmp_path / "out")
    first, second, third, *_ = sorted((tmp_path / "out" / "segments").iterdir())
    first.write_bytes(first.read_bytes()[:-1])
    second.write_bytes(bytes(second.stat().st_size))
    other = tmp_path / "other"
    other.write_bytes(b"not to be touched")
    third.unlink()
    third.symlink_to(other)
    with cogsplat.open(scene) as file:
        done = unpack_cogs(file, tmp_path / "out", force=True)
    assert done.written == 3
    assert contents(tmp_path / "out") == good
    assert other.read_bytes() == b"not to be touched"
    assert not third.is_symlink()


def test_segments_behind_a_link_are_not_written(scene: Path, tmp_path: Path) -> None:
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "segments").symlink_to(tmp_path / "elsewhere")
    with cogsplat.open(scene) as file, pytest.raises(StorageError) as refused:
        unpack_cogs(file, tmp_path / "out")
    assert refused.value.code == "not-a-folder"
    assert list((tmp_path / "elsewhere").iterdir()) == []


def test_no_manifest_before_its_objects(scene: Path, tmp_path: Path) -> None:
    """Work that is stopped leaves objects, which the next run takes, and no manifest."""

    def stop(stage: str, done: int, total: int) -> None:
        if done > 5:
            raise Cancelled

    with cogsplat.open(scene) as file:
        with pytest.raises(Cancelled):
            unpack_cogs(file, tmp_path / "out", progress=stop)
        assert not (tmp_path / "out" / MANIFEST).exists()
        there = len(contents(tmp_path / "out"))
        done = unpack_cogs(file, tmp_path / "out")
    assert done.shared == there > 0


def test_damage_is_not_passed_on(scene: Path, tmp_path: Path) -> None:
    data = bytearray(scene.read_bytes())
    data[-1] ^= 1
    scene.write_bytes(data)
    with cogsplat.open(scene) as file, pytest.raises(FormatError) as refused:
        unpack_cogs(file, tmp_path / "out")
    assert refused.value.code == "segment-crc"
    assert not (tmp_path / "out" / MANIFEST).exists()


def test_parts_give_parts(scene: Path, tmp_path: Path) -> None:
    data = scene.read_bytes()
    size = len(data) // 2
    with cogsplat.open(data[:size], partial=True) as file:
        done = unpack_cogs(file, tmp_path / "out")
        assert done.segments < len(file.segments)
    with cogsplat.open(tmp_path / "out", partial=True) as file:
        written = pack_cogs(file, tmp_path / "back.cogs")
    assert (tmp_path / "back.cogs").read_bytes() == data[:written]
    assert size - 10_000 < written <= size
    paged = next(path for path in VALID if path.stem == "pages").read_bytes()
    with (
        cogsplat.open(paged[: len(paged) // 2], partial=True) as file,
        pytest.raises(TruncatedError),
    ):
        unpack_cogs(file, tmp_path / "pages")
    assert list((tmp_path / "pages" / "segments").iterdir()) == []


@pytest.mark.parametrize(
    "name", ["", ".cogsm", "a.cogs", "../a.cogsm", "a/b.cogsm", "a\\b.cogsm", "c:a.cogsm",
             "a\0.cogsm", "a?.cogsm", "a\n.cogsm"],
)  # fmt: skip
def test_names_of_manifests_are_names(name: str) -> None:
    with pytest.raises(ValueError, match="file name that ends"):
        check_manifest_name(name)


def test_manifests_begin_with_their_own_magic(scene: Path, tmp_path: Path) -> None:
    with cogsplat.open(scene) as file:
        done = unpack_cogs(file, tmp_path / "out")
    made = done.manifest.read_bytes()
    assert made[:8] != layout.MAGIC
    assert made == folder_of_file(scene.read_bytes())[MANIFEST]
    assert done.manifest_bytes == len(made)


def test_a_version_that_lacks_tails_stores_nothing_twice(tmp_path: Path) -> None:
    """A head that another version has with a tail is read from the object of both."""
    data = file_of("transform", 6000, 3, 500)
    (tmp_path / "whole.cogs").write_bytes(data)
    with cogsplat.open(data) as file:
        unpack_cogs(file, tmp_path / "out", name="whole.cogsm")
        segments = [
            Segment(
                int(file.segments.kind[row]),
                int(file.segments.owner[row]),
                bytes(file.read_segment(row)),
                (),
            )
            for row in range(len(file.segments))
            if file.segments.kind[row] in (SegmentKind.HEAD, SegmentKind.REFINEMENT)
        ]
        root = replace(file.root, sh_degree=0, codebooks=(), pages=(), attributes=())
    write_cogs(root, segments, tmp_path / "plain.cogs")
    before = contents(tmp_path / "out")
    with cogsplat.open(tmp_path / "plain.cogs") as file:
        done = unpack_cogs(file, tmp_path / "out", name="plain.cogsm")
    assert (done.written, done.written_bytes) == (0, 0)
    assert {*contents(tmp_path / "out")} - {*before} == {"plain.cogsm"}
    with cogsplat.open(tmp_path / "out" / "plain.cogsm") as file:
        file.verify()
        pack_cogs(file, tmp_path / "back.cogs")
    assert (tmp_path / "back.cogs").read_bytes() == (tmp_path / "plain.cogs").read_bytes()


def test_a_manifest_beside_that_cannot_be_read_is_told(scene: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "old.cogsm").write_bytes(b"of another time")
    with cogsplat.open(scene) as file, pytest.warns(CogsplatWarning, match=r"old\.cogsm"):
        done = unpack_cogs(file, tmp_path / "out")
    assert done.shared == 0
