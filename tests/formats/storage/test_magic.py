"""What messages say that a file is, by its first bytes."""

import gzip
import io
import zipfile

import pytest
import zstandard

from cogsplat.formats.cogs.layout import MAGIC
from cogsplat.formats.storage.magic import COGS_MAGIC, describe


def zipped() -> bytes:
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w") as archive:
        archive.writestr("meta.json", "{}")
    return out.getvalue()


@pytest.mark.parametrize(
    ("head", "name"),
    [
        (MAGIC, "a COGS file"),
        (MAGIC[::-1], "reverse byte order"),
        (gzip.compress(b"x", mtime=0), "gzip"),
        (zipped(), "a ZIP file"),
        (zstandard.compress(b"x"), "zstd"),
        (b"ply\nformat ascii 1.0\n", "a PLY file"),
        (b"<!doctype html>", "markup"),
        (b"version https://git-lfs.github.com/spec/v1\n", "Git LFS pointer"),
        (b'{"a": 1}', "a JSON object"),
        (b"[1]", "a JSON array"),
    ],
)
def test_files_are_known_by_their_first_bytes(head: bytes, name: str) -> None:
    said = describe(head)
    assert name in said
    assert head[:8].hex(" ") in said


def test_other_files_are_described_by_their_bytes() -> None:
    assert describe(b"") == "an empty file"
    assert describe(b"\x00\x01") == "a file that starts with 00 01"
    assert COGS_MAGIC == MAGIC
