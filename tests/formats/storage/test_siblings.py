"""Files that a file names beside it: only those inside its own folder."""

from pathlib import Path

import pytest

from cogsplat.codec.errors import FormatError
from cogsplat.formats.storage.siblings import sibling


@pytest.mark.parametrize("name", ["means.webp", "deeper/means.webp", "with space.bin", ".hidden"])
def test_files_inside_the_folder_are_found(tmp_path: Path, name: str) -> None:
    assert sibling(tmp_path, name, "here", "a-code") == tmp_path / name


@pytest.mark.parametrize(
    "name",
    [
        "../secret",
        "deeper/../../secret",
        "/etc/passwd",
        "",
        "a//b",
        "c:/windows",
        "https://example.org/x",
        "back\\slash",
        "line\nbreak",
        "nul\0",
    ],
)
def test_ways_out_of_the_folder_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(FormatError, match="here: names") as caught:
        sibling(tmp_path, name, "here", "a-code")
    assert caught.value.code == "a-code"


def test_a_link_counts_by_where_it_leads(tmp_path: Path) -> None:
    folder = tmp_path / "scene"
    folder.mkdir()
    (tmp_path / "outside").write_bytes(b"x")
    (folder / "inside").write_bytes(b"x")
    (folder / "out").symlink_to(tmp_path / "outside")
    (folder / "in").symlink_to(folder / "inside")
    assert sibling(folder, "in", "here", "a-code") == folder / "in"
    with pytest.raises(FormatError):
        sibling(folder, "out", "here", "a-code")


def test_long_names_are_cut_in_the_message(tmp_path: Path) -> None:
    with pytest.raises(FormatError) as caught:
        sibling(tmp_path, "../" + "x" * 5000, "here", "a-code")
    assert len(caught.value.message) < 200
