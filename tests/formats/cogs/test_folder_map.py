"""Files mapped to folders, against the vectors that were taken apart without this module."""

import random
from pathlib import Path

import pytest

import cogsplat
from cogsplat.codec.errors import FormatError
from cogsplat.formats.cogs.folder_map import (
    FolderMap,
    ObjectRange,
    file_preamble,
    is_manifest,
)
from cogsplat.formats.storage.magic import MANIFEST_MAGIC
from cogsplat.tools.lab.conformance.reference_folders import MANIFEST, folder_of_file

VALID = Path(__file__).resolve().parents[2] / "vectors" / "valid"
FOLDERS = VALID.parent / "folders"
FILES = [
    "empty",
    "one-splat",
    "pages",
    "pages-only",
    "attributes-pages",
    "compensation-pages",
    "pictures-pages",
]


def mapped(name: str) -> tuple[bytes, dict[str, bytes], FolderMap]:
    data = (VALID / f"{name}.cogs").read_bytes()
    objects = folder_of_file(data)
    return data, objects, FolderMap(objects[MANIFEST], name)


def read(folder: FolderMap, objects: dict[str, bytes], offset: int, length: int) -> bytes:
    """Read a range of the file as a reader does that knows nothing but the map."""

    def bytes_of(piece: ObjectRange) -> bytes:
        if piece.data is not None:
            assert len(piece.data) == piece.length
            return piece.data
        assert len(objects[piece.name]) == piece.object_bytes
        return objects[piece.name][piece.offset : piece.offset + piece.length]

    for page in folder.pages_for(offset, length):
        folder.add_page(page, bytes_of(folder.page_range(page)))
    assert folder.pages_for(offset, length) == []
    return b"".join(bytes_of(piece) for piece in folder.object_ranges(offset, length))


@pytest.mark.parametrize("name", FILES)
def test_any_range_is_that_of_the_file(name: str) -> None:
    data, objects, folder = mapped(name)
    assert folder.file_length == len(data)
    assert folder.manifest_bytes == len(objects[MANIFEST])
    chance = random.Random(len(data))
    ranges = [(0, len(data)), (0, 0), (len(data), 0), (0, 64), (63, 2)]
    for _ in range(60):
        first = chance.randrange(len(data))
        ranges.append((first, chance.randrange(len(data) - first + 1)))
    for offset, length in ranges:
        fresh = FolderMap(objects[MANIFEST], name)
        assert read(fresh, objects, offset, length) == data[offset : offset + length]
    assert read(folder, objects, 0, len(data)) == data


def test_only_the_pages_of_a_range_are_asked_for() -> None:
    data, objects, folder = mapped("pages")
    pages = folder.pages_for(0, len(data))
    assert [page.path for page in pages] == [(0,), (1,), (2,)]
    sizes = [folder.page_range(page).length for page in pages]
    assert sizes == [len(objects[folder.page_range(page).name]) for page in pages]
    # The root's own segments need none.
    assert folder.pages_for(0, folder.root_end + 1) == []
    assert folder.pages_for(len(data) - 1, 1) == pages[2:]
    read(folder, objects, len(data) - 1, 1)
    assert folder.pages_for(0, len(data)) == pages[:2]


def test_a_manifest_holds_the_description_and_no_object_does() -> None:
    data, objects, folder = mapped("pictures-pages")
    read(folder, objects, 0, len(data))
    with cogsplat.open(data) as file:
        assert file.description_row is not None
        start, key = int(file.offsets[file.description_row]), file.description_row
        length = int(file.segments.length[key])
    (piece,) = folder.object_ranges(start, length)
    assert (piece.name, piece.data) == ("", data[start : start + length])
    assert piece.offset + length == folder.manifest_bytes == len(objects[MANIFEST])
    assert objects[MANIFEST][piece.offset :] == piece.data
    assert folder.objects().keys() | {MANIFEST} == objects.keys()


def test_pieces_name_objects_and_what_lies_in_them() -> None:
    data, objects, folder = mapped("one-splat")
    (name,) = (name for name in objects if name != MANIFEST)
    assert folder.object_ranges(folder.root_end + 3, 5) == [
        ObjectRange(name, 3, 5, len(objects[name]))
    ]
    assert folder.objects() == {name: len(objects[name])}
    assert is_manifest(objects[MANIFEST])
    assert not is_manifest(data)
    assert file_preamble(objects[MANIFEST], "x") == data[:64]
    assert objects[MANIFEST][:8] == MANIFEST_MAGIC


def test_a_damaged_page_is_refused() -> None:
    pages = mapped("pages")[2]
    page = pages.pages_for(0, pages.file_length)[0]
    with pytest.raises(FormatError, match="CRC") as refused:
        pages.add_page(page, b"x" * 10)
    assert refused.value.code == "page-crc"


@pytest.mark.parametrize(("change", "code"), [(-1, "file-truncated"), (1, "file-trailing")])
def test_a_manifest_of_another_length_is_refused(change: int, code: str) -> None:
    folder = mapped("pages")[2]
    folder.check_manifest_size(folder.manifest_bytes)
    with pytest.raises(FormatError) as refused:
        folder.check_manifest_size(folder.manifest_bytes + change)
    assert refused.value.code == code


@pytest.mark.parametrize("name", ["pages", "pictures-pages"])
def test_a_manifest_that_lacks_a_byte_is_too_short(name: str) -> None:
    _, objects, folder = mapped(name)
    for size in (folder.manifest_bytes - 1, folder.root_end + 1):
        with pytest.raises(FormatError) as refused:
            FolderMap(objects[MANIFEST][:size], name)
        assert refused.value.code == "file-truncated"
