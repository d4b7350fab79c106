"""Mutants are the same for the same seed, of every sort, and most get past the first checks."""

import struct
from collections import Counter

import pytest
from mutants import MANIFEST, VECTORS

from cogsplat.codec.errors import CogsplatError
from cogsplat.formats.cogs.reader import open_cogs
from cogsplat.formats.storage.source import BytesSource
from cogsplat.tools.lab.conformance.file_mutations import make_mutant
from cogsplat.tools.lab.conformance.payload_mutations import parse_records

FILES = [
    (entry["name"], (VECTORS / "valid" / f"{entry['name']}.cogs").read_bytes())
    for entry in MANIFEST["valid"]
]
MANY = 2000

# What only a decoder finds that reads payloads, not one that compares CRCs and tables.
DEEP = {
    "stream-record", "stream-rows", "stream-params", "stream-planes", "stream-kind",
    "stream-missing", "stream-unexpected", "stream-duplicate", "plane-length", "plane-radix",
    "plane-digits", "zstd-frame", "zstd-size", "grid-value", "grid-levels", "code-range",
    "morton-class", "quat-largest", "index-range", "codebook-missing", "bits-padding",
}  # fmt: skip


@pytest.fixture(scope="module")
def verdicts() -> Counter[str]:
    found: Counter[str] = Counter()
    for number in range(MANY):
        case = make_mutant(FILES, 3, number)
        try:
            with open_cogs(BytesSource(case.data), partial=case.partial) as file:
                file.decode()
            found["accepted"] += 1
        except CogsplatError as error:
            found[error.code] += 1
    return found


def test_a_mutant_follows_from_seed_and_number_alone() -> None:
    again = [make_mutant(FILES, 5, number) for number in (7, 3, 7)]
    assert again[0] == again[2]
    assert again[0].data != again[1].data
    assert make_mutant(FILES, 6, 7).data != again[0].data


def test_every_sort_of_change_occurs() -> None:
    changes = {make_mutant(FILES, 1, number).change for number in range(MANY)}
    for change in (
        "bytes", "cut", "preamble", "index bytes", "value", "column", "plane", "params",
        "record field", "records", "planes", "stream count", "payload bytes", "map of a payload",
        "payloads swapped", "segment moved", "segment dropped", "segment doubled",
        "payload of another file", "record of another payload",
    ):  # fmt: skip
        assert change in changes


def test_most_mutants_get_past_the_checksums(verdicts: Counter[str]) -> None:
    sums = sum(verdicts[code] for code in ("preamble-crc", "root-crc", "page-crc", "segment-crc"))
    assert sums < MANY / 8
    assert sum(verdicts[code] for code in DEEP) > MANY / 5
    assert len(DEEP - set(verdicts)) <= 4
    assert MANY / 10 < verdicts["accepted"] < MANY / 2


def test_records_of_what_is_no_payload_are_refused() -> None:
    for payload in (b"", struct.pack("<H", 3), struct.pack("<H", 0) + b"\0"):
        with pytest.raises((struct.error, ValueError)):
            parse_records(payload)
