"""Directories of ZIP files: read where they are small, refused before they cost memory."""

import io
import zipfile

import pytest

from cogsplat.codec.errors import LimitError
from cogsplat.formats.storage.zip_directory import open_entry, open_zip


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


def test_entries_that_reach_into_the_next_are_refused() -> None:
    with zipfile.ZipFile(bundle(3)) as archive:
        for entry in archive.infolist():
            with open_entry(archive, entry) as file:
                assert file.read() == b"content"
        for number, reach in ((0, 10), (2, 10)):
            entry = archive.infolist()[number]
            entry.compress_size += reach
            with pytest.raises(zipfile.BadZipFile, match="an entry that ends at byte"):
                open_entry(archive, entry)
