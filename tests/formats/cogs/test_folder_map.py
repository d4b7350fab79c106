"""Files mapped to folders, against the vectors that were taken apart without this module."""

import random
from pathlib import Path

import pytest

from cogsplat.codec.errors import FormatError
from cogsplat.formats.cogs.folder_map import (
    FolderMap,
    ObjectRange,
    file_preamble,
    is_manifest,
)
from cogsplat.formats.storage.magic import MANIFEST_MAGIC
from cogsplat.tools.lab.conformance.folder_vectors import MANIFEST, folder_of_file

VALID = Path(__file__).resolve().parents[2] / "vectors" / "valid"
FOLDERS = VALID.parent / "folders"
FILES = ["empty", "one-splat", "pages", "pages-only", "attributes-pages", "compensation-pages"]


def mapped(name: str) -> tuple[bytes, dict[str, bytes], FolderMap]:
    data = (VALID / f"{name}.cogs").read_bytes()
    objects = folder_of_file(data)
    return data, objects, FolderMap(objects[MANIFEST], name)


def read(folder: FolderMap, objects: dict[str, bytes], offset: int, length: int) -> bytes:
    """Read a range of the file as a reader does that knows nothing but the map."""
    manifest = folder.preamble + objects[MANIFEST][64:]
    for page in folder.pages_for(offset, length):
        folder.add_page(page.page, manifest[page.offset : page.offset + page.length])
    assert folder.pages_for(offset, length) == []
    parts = []
    for piece in folder.object_ranges(offset, length):
        content = objects[piece.name] if piece.name else manifest
        assert len(content) == piece.object_bytes
        parts.append(content[piece.offset : piece.offset + piece.length])
    return b"".join(parts)


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
    both = folder.pages_for(0, len(data))
    assert [page.page for page in both] == [0, 1, 2]
    assert sum(page.length for page in both) == folder.manifest_bytes - folder.head_end
    assert [folder.page_at(page.offset) for page in both] == [0, 1, 2]
    assert [folder.page_at(page.offset - 1) for page in both] == [None, 0, 1]
    # The root's own segments, and the bytes of the pages themselves, need none.
    assert folder.pages_for(0, folder.root_end + 1) == []
    assert [page.page for page in folder.pages_for(len(data) - 1, 1)] == [2]
    read(folder, objects, len(data) - 1, 1)
    assert [page.page for page in folder.pages_for(0, len(data))] == [0, 1]
    assert [folder.has_page(page) for page in range(3)] == [False, False, True]


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


def test_a_range_behind_the_last_segment_is_refused() -> None:
    folder = mapped("one-splat")[2]
    with pytest.raises(FormatError, match="segments end") as refused:
        folder.object_ranges(folder.file_length, 1)
    assert refused.value.code == "segments-length"
    pages = mapped("pages")[2]
    with pytest.raises(FormatError, match="CRC") as refused:
        pages.add_page(0, b"x" * 10)
    assert refused.value.code == "page-crc"


@pytest.mark.parametrize(("change", "code"), [(-1, "file-truncated"), (1, "file-trailing")])
def test_a_manifest_of_another_length_is_refused(change: int, code: str) -> None:
    folder = mapped("pages")[2]
    folder.check_manifest_size(folder.manifest_bytes)
    with pytest.raises(FormatError) as refused:
        folder.check_manifest_size(folder.manifest_bytes + change)
    assert refused.value.code == code


def test_a_manifest_of_no_more_than_the_root_is_too_short() -> None:
    _, objects, folder = mapped("pages")
    with pytest.raises(FormatError) as refused:
        FolderMap(objects[MANIFEST][: folder.head_end - 1], "pages")
    assert refused.value.code == "file-truncated"
    assert FolderMap(objects[MANIFEST][: folder.head_end], "pages").file_length > 0
