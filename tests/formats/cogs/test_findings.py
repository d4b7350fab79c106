"""Findings of whole files against the vectors."""

import json
from pathlib import Path

import pytest

from cogsplat.codec.errors import StorageError
from cogsplat.formats.cogs.findings import findings
from cogsplat.formats.storage.source import BytesSource

VECTORS = Path(__file__).resolve().parents[2] / "vectors"
MANIFEST = json.loads((VECTORS / "manifest.json").read_text(encoding="utf-8"))


def found_in(folder, name):
    return findings(BytesSource((VECTORS / folder / f"{name}.cogs").read_bytes()))


@pytest.mark.parametrize("entry", MANIFEST["valid"], ids=lambda e: e["name"])
def test_valid_files_have_none(entry):
    assert found_in("valid", entry["name"]) == []


@pytest.mark.parametrize("entry", MANIFEST["invalid"], ids=lambda e: e["name"])
def test_invalid_files_have_the_stated_one_first(entry):
    first = found_in("invalid", entry["name"])[0]
    assert (first.code, first.clause) == (entry["code"], entry["clause"])
    assert first.kind in ("format", "truncated", "unsupported", "limit")


def test_a_short_file_is_checked_as_far_as_it_goes():
    data = bytearray((VECTORS / "valid" / "chunks.cogs").read_bytes()[:3700])
    data[800] ^= 1
    found = findings(BytesSource(bytes(data)))
    assert [finding.code for finding in found] == ["file-truncated", "segment-crc"]
    assert found[0].offset == 3700
    (alone,) = findings(BytesSource(bytes(data)), partial=True)
    assert alone == found[1]


@pytest.mark.parametrize("length", [0, 40, 300])
def test_a_file_that_ends_in_its_index_says_where(length):
    data = (VECTORS / "valid" / "chunks.cogs").read_bytes()[:length]
    (finding,) = findings(BytesSource(data))
    assert finding.code in ("preamble-truncated", "root-truncated")
    assert finding.offset is not None


@pytest.mark.parametrize("partial", [False, True])
def test_a_long_file_is_checked_up_to_where_it_should_end(partial):
    data = bytearray((VECTORS / "valid" / "chunks.cogs").read_bytes())
    end = len(data)
    (alone,) = findings(BytesSource(bytes(data) + b"more"), partial=partial)
    assert (alone.code, alone.offset) == ("file-trailing", end)
    # A byte that slips in moves all that follows.
    data.insert(end - 100, 0)
    found = findings(BytesSource(bytes(data)), partial=partial)
    assert [finding.code for finding in found] == ["file-trailing", "segment-crc"]
    assert found[0].offset == end
    assert found[1].offset < end


def test_a_source_that_cannot_be_read_is_no_finding():
    class Broken(BytesSource):
        def read(self, offset: int, length: int) -> bytes:
            raise StorageError("io", "the disk is gone")

    with pytest.raises(StorageError):
        findings(Broken(b"x" * 100))
