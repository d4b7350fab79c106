"""COLMAP records: reading, skipping, and errors about truncated files."""

import struct
from pathlib import Path

import pytest

from cogsplat.codec.errors import FormatError, TruncatedError
from cogsplat.formats.cameras.colmap_records import (
    COUNT,
    MAX_LINE_BYTES,
    MAX_NAME_BYTES,
    RecordReader,
    skip_line,
)


def written(tmp_path: Path, data: bytes) -> Path:
    path = tmp_path / "a.bin"
    path.write_bytes(data)
    return path


def test_records_come_one_after_the_other_across_blocks(tmp_path: Path) -> None:
    rows = [struct.pack("<Q", row) + bytes(40) for row in range(5000)]
    path = written(tmp_path, COUNT.pack(5000) + b"".join(rows) + b"name\0")
    with path.open("rb") as file:
        reader = RecordReader(file, "a.bin")
        assert reader.read_count(48, "rows") == 5000
        found = []
        for _ in range(5000):
            found.append(struct.unpack("<Q", reader.read(8, "a row"))[0])
            reader.skip(40, "the rest of it")
        assert found == list(range(5000))
        assert reader.read_name("what follows") == "name"
        reader.require_end()


def test_truncated_files_are_refused(tmp_path: Path) -> None:
    path = written(tmp_path, COUNT.pack(2) + bytes(8))
    with path.open("rb") as file:
        reader = RecordReader(file, "a.bin")
        with pytest.raises(TruncatedError, match="2 rows") as caught:
            reader.read_count(8, "rows")
        assert caught.value.needed == 24
        for ask in (lambda: reader.read(9, "a row"), lambda: reader.skip(1 << 60, "a row")):
            with pytest.raises(TruncatedError, match="a row"):
                ask()
        with pytest.raises(FormatError, match="expected 8") as left:
            reader.require_end()
        assert left.value.code == "colmap-trailing-bytes"


def test_names_end(tmp_path: Path) -> None:
    for data, code in ((b"abc", "colmap-truncated"), (b"x" * MAX_NAME_BYTES, "colmap-malformed")):
        with written(tmp_path, data).open("rb") as file:
            with pytest.raises(FormatError) as caught:
                RecordReader(file, "a.bin").read_name("an image")
            assert caught.value.code == code


def test_lines_of_any_length_are_passed_over(tmp_path: Path) -> None:
    path = written(tmp_path, b"1 " * MAX_LINE_BYTES + b"\nnext\n")
    with path.open("rb") as file:
        skip_line(file)
        assert file.readline() == b"next\n"
        skip_line(file)
        assert file.read() == b""
