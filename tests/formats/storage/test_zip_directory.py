"""Directories of ZIP files: read where they are small, refused before they cost memory."""

import io
import struct
import zipfile
from pathlib import Path

import pytest

from cogsplat.codec.errors import LimitError
from cogsplat.formats.storage.zip_directory import open_zip


def bundle(entries: int) -> io.BytesIO:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for number in range(entries):
            archive.writestr(f"file {number}", b"content")
    file.seek(0)
    return file


def refusal(found: str) -> LimitError:
    return LimitError("too-large", f"here: {found}")


def test_a_small_directory_is_read_and_its_files_after_it() -> None:
    with open_zip(bundle(20), 1 << 12, refusal) as archive:
        assert len(archive.namelist()) == 20
        # Files may be larger than the directory's ration.
        assert b"".join(archive.read(name) for name in archive.namelist() * 80) == b"content" * 1600


def test_a_large_directory_is_refused_before_its_entries_are_made() -> None:
    with pytest.raises(LimitError, match="here: a ZIP directory of more than 4096 bytes"):
        open_zip(bundle(100), 1 << 12, refusal)


def test_damage_is_what_zipfile_says() -> None:
    with pytest.raises(zipfile.BadZipFile):
        open_zip(io.BytesIO(b"PK\3\4 and no directory"), 1 << 12, refusal)


def with_second_entry(field: str, value: int) -> io.BytesIO:
    """Return a bundle of three entries whose directory says something else of the second one."""
    data = bytearray(bundle(3).getvalue())
    at = [i for i in range(len(data)) if data.startswith(b"PK\1\2", i)][1]
    offset = {"compress_size": 20, "header_offset": 42}[field]
    struct.pack_into("<I", data, at + offset, value)
    return io.BytesIO(data)


@pytest.mark.parametrize(
    ("field", "value"), [("compress_size", 17), ("compress_size", 10_000), ("header_offset", 0)]
)
def test_entries_that_claim_the_bytes_of_others_are_refused(field: str, value: int) -> None:
    with pytest.raises(zipfile.BadZipFile, match="an entry from byte"):
        open_zip(with_second_entry(field, value), 1 << 12, refusal)


def test_entries_may_end_where_the_next_begins_or_before() -> None:
    for size in (7, 3):
        with open_zip(with_second_entry("compress_size", size), 1 << 12, refusal) as archive:
            assert archive.read("file 0") == b"content"


def test_a_directory_before_the_file_is_damage(tmp_path: Path) -> None:
    """Files on a disk refuse to go there with an OSError, which is none of the disk."""
    path = tmp_path / "a.zip"
    path.write_bytes(struct.pack("<4s4H2LH", b"PK\5\6", 0, 0, 1, 1, 1000, 0, 0))
    with path.open("rb") as file, pytest.raises(zipfile.BadZipFile):
        open_zip(file, 1 << 12, refusal)
