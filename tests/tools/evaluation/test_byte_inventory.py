"""The byte inventory accounts for every byte of a file, or rejects the file."""

from pathlib import Path

import pytest

import cogsplat
from cogsplat.codec.errors import CogsplatError
from cogsplat.tools.evaluation.byte_inventory import chunk_sizes, stored_sizes

VECTORS = Path(__file__).resolve().parents[2] / "vectors"


def names(folder: str) -> list[str]:
    return sorted(path.name for path in (VECTORS / folder).glob("*.cogs"))


@pytest.mark.parametrize("name", names("valid"))
def test_sizes_add_up_to_the_file(name: str) -> None:
    path = VECTORS / "valid" / name
    with cogsplat.open(path) as file:
        assert sum(size.stored_bytes for size in stored_sizes(file)) == path.stat().st_size
        assert sum(chunk.splats for chunk in chunk_sizes(file)) == file.root.splats


def test_broken_files_are_listed_or_refused() -> None:
    refused = set()
    for name in names("invalid"):
        try:
            with cogsplat.open(VECTORS / "invalid" / name) as file:
                stored_sizes(file)
                chunk_sizes(file)
        except CogsplatError as error:
            refused.add(error.code)
    assert {"attribute-record", "stream-record", "segment-crc"} <= refused
