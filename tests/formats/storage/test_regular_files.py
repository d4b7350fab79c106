import os
from pathlib import Path

import pytest

from cogsplat.codec.errors import StorageError
from cogsplat.formats.storage.atomic import atomic_write
from cogsplat.formats.storage.regular_files import open_regular, read_regular

posix_only = pytest.mark.skipif(os.name != "posix", reason="POSIX files")


def code_of(path: Path, mode: str = "rb", max_bytes: int | None = None) -> str:
    with pytest.raises(StorageError, match=path.name) as caught:
        open_regular(path, mode, max_bytes=max_bytes)
    return caught.value.code


def test_regular_files_are_read_and_appended_to(tmp_path: Path) -> None:
    path = tmp_path / "log"
    for part in (b"one", b"two"):
        with open_regular(path, "ab") as file:
            file.write(part)
    with open_regular(path, "r+b") as file:
        file.write(b"ONE")
    assert read_regular(path, 6) == b"ONEtwo"


def test_a_missing_file_is_not_found(tmp_path: Path) -> None:
    assert code_of(tmp_path / "none") == "not-found"
    assert code_of(tmp_path / "none" / "log", "ab") == "not-found"


@posix_only
@pytest.mark.parametrize("mode", ["rb", "r+b", "ab", "a+b"])
def test_links_folders_and_pipes_are_refused_and_stay_as_they_were(
    tmp_path: Path, mode: str
) -> None:
    target = tmp_path / "target"
    target.write_bytes(b"precious")
    for name, made in (
        ("link", lambda path: path.symlink_to(target)),
        ("dangling", lambda path: path.symlink_to(tmp_path / "none")),
        ("folder", Path.mkdir),
        ("pipe", os.mkfifo),
    ):
        made(tmp_path / name)
        # Opening the pipe would wait for its other end.
        assert code_of(tmp_path / name, mode) == "not-a-file"
    assert target.read_bytes() == b"precious"
    assert not (tmp_path / "none").exists()


@posix_only
@pytest.mark.parametrize("mode", ["rb", "ab"])
def test_a_link_that_appears_after_the_check_is_not_followed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mode: str
) -> None:
    (tmp_path / "target").write_bytes(b"precious")
    (tmp_path / "link").symlink_to(tmp_path / "target")
    regular = (tmp_path / "target").stat()
    monkeypatch.setattr(Path, "lstat", lambda self: regular)
    assert code_of(tmp_path / "link", mode) == "io"
    assert (tmp_path / "target").read_bytes() == b"precious"


def test_sizes_are_limited_before_anything_is_read(tmp_path: Path) -> None:
    path = tmp_path / "sparse"
    with path.open("wb") as file:
        file.truncate(3 << 30)
    assert code_of(path, max_bytes=1 << 20) == "file-too-large"
    with pytest.raises(StorageError, match="3221225472 bytes, expected at most 1048576"):
        read_regular(path, 1 << 20)


def test_modes_that_empty_a_file_are_misuse(tmp_path: Path) -> None:
    for mode in ("wb", "w+b", "r"):
        with pytest.raises(ValueError, match="mode"):
            open_regular(tmp_path / "log", mode)


@posix_only
def test_atomic_write_replaces_no_target_of_a_link_unless_it_may(tmp_path: Path) -> None:
    (tmp_path / "target").write_bytes(b"precious")
    (tmp_path / "link").symlink_to(tmp_path / "target")
    with (
        pytest.raises(StorageError, match="is a link") as caught,
        atomic_write(tmp_path / "link", force=True, follow_links=False) as file,
    ):
        file.write(b"other")
    assert caught.value.code == "not-a-file"
    assert (tmp_path / "target").read_bytes() == b"precious"
    with atomic_write(tmp_path / "target", force=True, follow_links=False) as file:
        file.write(b"new")
    assert (tmp_path / "link").read_bytes() == b"new"
