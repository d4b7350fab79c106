"""check of a file: every broken rule, with clause and offset."""

from pathlib import Path

import pytest
from running import ROOT, Run, SmallScene

from cogsplat.formats.cogs.reader import open_cogs
from cogsplat.formats.storage.source import FileSource

INVALID = ROOT / "tests" / "vectors" / "invalid"


def test_a_good_file_conforms(run: Run, small: SmallScene) -> None:
    told = run("check", small.cogs)
    assert (told.code, told.out.splitlines()[-1].split(": ")[-1]) == (0, "conforms to SPEC.md")
    told = run("check", small.cogs, "--json")
    assert told.json["valid"] is True
    assert told.json["findings"] == []


def test_all_broken_segments_are_listed(run: Run, small: SmallScene, tmp_path: Path) -> None:
    with open_cogs(FileSource(small.cogs)) as file:
        starts = [int(file.offsets[file.chunk_rows(chunk).head]) for chunk in (0, 2)]
    data = bytearray(small.cogs.read_bytes())
    for start in starts:
        data[start + 40] ^= 0x10
    path = tmp_path / "broken.cogs"
    path.write_bytes(data)
    told = run("check", path, "--json")
    assert told.code == 3
    findings = told.json["findings"]
    assert isinstance(findings, list)
    assert [(f["code"], f["clause"], f["offset"]) for f in findings] == [
        ("segment-crc", "5.3", start) for start in starts
    ]
    assert run("check", path).out.count("segment-crc") == 2


@pytest.mark.parametrize(
    ("name", "code", "clause"),
    [
        ("magic-ply", "not-cogs", "3.1"),
        ("chunk-box-small", "chunk-box", "5.4"),
        ("segment-hash-wrong", "segment-hash", "5.3"),
        ("zstd-cut", "zstd-frame", "6.3"),
        ("cameras-nan", "root-value", "5.8"),
        ("decoded-size", "decoded-size", "9.2"),
        ("file-cut", "file-truncated", "3.3"),
    ],
)
def test_findings_have_the_code_of_the_vectors(run: Run, name: str, code: str, clause: str) -> None:
    told = run("check", INVALID / f"{name}.cogs", "--json")
    assert told.code == 3
    findings = told.json["findings"]
    assert isinstance(findings, list)
    assert (findings[0]["code"], findings[0]["clause"]) == (code, clause)


def test_a_file_that_is_not_there(run: Run, tmp_path: Path) -> None:
    assert run("check", tmp_path / "none.cogs").code == 4
