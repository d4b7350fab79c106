"""Folders on disk, read as the file they stand for: whole, in part, and made to deceive."""

import hashlib
import os
import shutil
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import pytest
from cogs_samples import assert_same, file_of

import cogsplat
from cogsplat.codec.errors import CogsplatError, FormatError, StorageError, TruncatedError
from cogsplat.formats.cogs.findings import findings
from cogsplat.formats.cogs.folder_source import FolderSource, manifest_path, names_folder
from cogsplat.formats.cogs.reader import open_cogs
from cogsplat.formats.storage.source import BytesSource, PrefixSource, has_range
from cogsplat.tools.lab.conformance.reference_folders import folder_of_file

VECTORS = Path(__file__).resolve().parents[2] / "vectors"

links = pytest.mark.skipif(os.name != "posix", reason="links need rights on Windows")


def placed(folder: Path, data: bytes, manifest: str = "manifest.cogsm") -> Path:
    for name, content in folder_of_file(data, manifest).items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    return folder


@pytest.fixture
def data() -> bytes:
    return file_of("vq")


@pytest.fixture
def folder(tmp_path: Path, data: bytes) -> Path:
    return placed(tmp_path / "scene", data)


def objects(folder: Path) -> list[Path]:
    return sorted((folder / "segments").iterdir())


def faults(folder: Path, *, partial: bool = False) -> list[str]:
    with closing(FolderSource(folder)) as source:
        return [found.code for found in findings(source, partial=partial)]


def test_a_folder_reads_as_its_file(folder: Path, data: bytes) -> None:
    source = FolderSource(folder)
    assert (source.size, source.stored_bytes) == (len(data), len(data))
    assert source.read(0, source.size) == data
    ranges = [(start, min(777, len(data) - start)) for start in range(0, len(data), 500)]
    with ThreadPoolExecutor(4) as pool:
        parts = list(pool.map(lambda r: source.read(*r), ranges))
    assert parts == [data[a : a + n] for a, n in ranges]
    with pytest.raises(TruncatedError, match="expected"):
        source.read(len(data), 1)
    with pytest.raises(ValueError, match="negative"):
        source.read(-1, 1)
    source.close()


def test_scenes_are_the_same_from_folder_and_file(folder: Path, data: bytes) -> None:
    with cogsplat.open(folder) as file, open_cogs(BytesSource(data)) as whole:
        assert file.missing_bytes == 0
        assert file.source_bytes == len(data)
        assert_same(file.decode(), whole.decode())
        file.verify()
    assert faults(folder) == []


def test_a_manifest_names_its_folder(folder: Path) -> None:
    (folder / "manifest.cogsm").rename(folder / "second.cogsm")
    with cogsplat.open(folder / "second.cogsm") as file:
        assert file.num_chunks > 1
    with pytest.raises(StorageError) as refused:
        cogsplat.open(folder)
    assert refused.value.code == "not-found"
    assert manifest_path(folder) == folder / "manifest.cogsm"
    assert names_folder(folder)
    assert names_folder(folder / "second.cogsm")
    assert not names_folder(objects(folder)[0])


def test_an_object_that_is_missing_leaves_a_part(folder: Path, data: bytes) -> None:
    with open_cogs(BytesSource(data)) as whole:
        rows = whole.chunk_rows(3)
        content = b"".join(
            bytes(whole.read_segment(row)) for row in (rows.head, rows.refinement, rows.tail) if row
        )
        gone = hashlib.sha256(content).hexdigest()[:32]
        expected = whole.decode(range(3))
        fourth = whole.decode([4])
    (folder / "segments" / f"{gone}.bin").unlink()
    with pytest.raises(TruncatedError, match=gone) as refused:
        cogsplat.open(folder)
    assert refused.value.code == "segment-missing"
    with cogsplat.open(folder, partial=True) as file:
        assert file.complete_chunks() == 3
        assert file.missing_bytes == len(content)
        assert_same(file.decode(), expected)
        # Chunks behind it stay usable.
        assert_same(file.decode([4]), fourth)
        with pytest.raises(TruncatedError) as refused:
            file.decode([3])
        assert refused.value.code == "segment-missing"
    assert faults(folder) == ["segment-missing"]
    assert faults(folder, partial=True) == []


def test_a_page_that_is_missing_leaves_the_chunks_before_it(tmp_path: Path) -> None:
    shutil.copytree(VECTORS / "folders" / "pages", tmp_path / "pages")
    with closing(FolderSource(tmp_path / "pages")) as source:
        name, cut = sorted(source.page_objects().items(), key=lambda entry: entry[1])[1]
        size = source.size
    (tmp_path / "pages" / name).unlink()
    with pytest.raises(TruncatedError, match=name) as refused:
        cogsplat.open(tmp_path / "pages")
    assert refused.value.code == "segment-missing"
    with (
        cogsplat.open(tmp_path / "pages", partial=True) as file,
        cogsplat.open(VECTORS / "valid" / "pages.cogs", size_bytes=cut) as expected,
    ):
        assert file.missing_bytes == expected.missing_bytes == size - cut
        assert file.complete_chunks() == expected.complete_chunks() > 0
        assert_same(file.decode(), expected.decode())


def test_the_first_bytes_of_a_folder_are_those_of_the_file(folder: Path, data: bytes) -> None:
    size = len(data) * 6 // 10
    with (
        open_cogs(FolderSource(folder), size_bytes=size) as part,
        open_cogs(BytesSource(data[:size]), partial=True) as cut,
    ):
        assert part.complete_chunks() == cut.complete_chunks() > 0
        assert part.missing_bytes == cut.missing_bytes
        assert_same(part.decode(), cut.decode())
    with closing(PrefixSource(FolderSource(folder), size)) as prefix:
        assert prefix.first_request_bytes < 16384
        assert prefix.stored_bytes == size
        assert has_range(prefix, size - 2, 2)
        assert not has_range(prefix, size - 1, 2)


@pytest.mark.parametrize("change", [-1, 1])
def test_objects_of_another_length_are_refused(folder: Path, change: int) -> None:
    path = max(objects(folder), key=lambda path: path.stat().st_size)
    content = path.read_bytes()
    path.write_bytes(content[:-1] if change < 0 else content + b"\0")
    with cogsplat.open(folder) as file, pytest.raises(FormatError) as refused:
        file.verify()
    assert refused.value.code == "segment-object"
    assert path.name in refused.value.message


@links
@pytest.mark.parametrize("kind", ["object", "pipe", "folder", "segments"])
def test_links_and_devices_are_refused(folder: Path, tmp_path: Path, kind: str) -> None:
    path = objects(folder)[0]
    aside = tmp_path / "aside"
    if kind == "segments":
        path.parent.rename(aside)
        path.parent.symlink_to(aside)
    else:
        path.rename(aside)
        {"object": path.symlink_to, "pipe": lambda _: os.mkfifo(path)}.get(
            kind, lambda _: path.mkdir()
        )(aside)
    with cogsplat.open(folder) as file, pytest.raises(FormatError) as refused:
        file.verify()
    assert refused.value.code == "segment-object"


def test_no_name_in_a_file_leads_out_of_the_folder(folder: Path, tmp_path: Path) -> None:
    """Whatever a manifest holds, only names of digits below ``segments`` are opened."""
    manifest = folder / "manifest.cogsm"
    data = bytearray(manifest.read_bytes())
    opened = []
    for at in range(64, len(data), 7):
        data[at] ^= 0xFF
        manifest.write_bytes(data)
        try:
            with cogsplat.open(folder, partial=True) as file:
                opened.append(file.decode())
        except CogsplatError as error:
            opened.append(error)
        data[at] ^= 0xFF
    assert all(isinstance(found, CogsplatError) for found in opened)
    assert {path.name for path in tmp_path.iterdir()} == {"scene"}


def test_a_folder_may_cost_what_is_in_it_not_what_it_states(folder: Path, data: bytes) -> None:
    """A manifest states any length; what counts against the limits are bytes that are there."""
    shutil.rmtree(folder / "segments")
    source = FolderSource(folder)
    assert source.stored_bytes == (folder / "manifest.cogsm").stat().st_size < len(data)
    assert source.size == len(data)
    with open_cogs(source, partial=True) as file:
        assert file.complete_chunks() == 0
        assert file.source_bytes < source.stored_bytes
