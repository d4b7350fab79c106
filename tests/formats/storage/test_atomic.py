from __future__ import annotations

import errno
import os
import socket
import stat
import subprocess
import sys
import zlib
from pathlib import Path

import pytest

from cogsplat.codec.errors import StorageError
from cogsplat.formats.storage import atomic
from cogsplat.formats.storage.atomic import (
    TargetExistsError,
    atomic_write,
    open_for_read,
    storage_errors,
)

needs_permissions = pytest.mark.skipif(
    os.name != "posix" or os.geteuid() == 0, reason="root and Windows ignore permission bits"
)
posix_only = pytest.mark.skipif(os.name != "posix", reason="POSIX files")


def write(path: Path, data: bytes, force: bool = False) -> None:
    with atomic_write(path, force) as file:
        file.write(data)


def test_writes_whole_and_leaves_nothing_beside(tmp_path: Path) -> None:
    target = tmp_path / "a.bin"
    with atomic_write(target) as file:
        file.write(b"first")
        assert not target.exists()
    assert target.read_bytes() == b"first"
    assert list(tmp_path.iterdir()) == [target]


def test_replaces_only_when_forced(tmp_path: Path) -> None:
    target = tmp_path / "a.bin"
    write(target, b"old")
    with pytest.raises(TargetExistsError) as caught:
        write(target, b"new")
    assert (caught.value.code, caught.value.exit_code) == ("exists", 2)
    assert target.read_bytes() == b"old"
    write(target, b"new", force=True)
    assert target.read_bytes() == b"new"


@pytest.mark.parametrize("error", [KeyboardInterrupt(), RuntimeError("x"), SystemExit(1)])
def test_whatever_leaves_the_block_keeps_the_old_file(tmp_path: Path, error: BaseException) -> None:
    target = tmp_path / "a.bin"
    write(target, b"old")

    def fail() -> None:
        with atomic_write(target, force=True) as file:
            file.write(b"new")
            raise error

    with pytest.raises(type(error)):
        fail()
    assert target.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [target]


def test_a_second_writer_who_finishes_first_is_not_overwritten(tmp_path: Path) -> None:
    target = tmp_path / "a.bin"

    def race() -> None:
        with atomic_write(target) as slow:
            slow.write(b"slow")
            write(target, b"fast")

    with pytest.raises(TargetExistsError):
        race()
    assert target.read_bytes() == b"fast"
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.parametrize(
    ("number", "code"),
    [
        (errno.ENOSPC, "disk-full"),
        (errno.EDQUOT, "disk-full"),
        (errno.EACCES, "permission"),
        (errno.EROFS, "permission"),
        (errno.EIO, "io"),
    ],
)
def test_system_errors_in_the_block_get_their_code(tmp_path: Path, number: int, code: str) -> None:
    def fail() -> None:
        with atomic_write(tmp_path / "a.bin") as file:
            file.write(b"x")
            raise OSError(number, os.strerror(number))

    with pytest.raises(StorageError) as caught:
        fail()
    assert (caught.value.code, caught.value.exit_code) == (code, 4)
    assert "a.bin" in caught.value.message
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_fills_up_at_the_last_flush(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "a.bin"
    write(target, b"old")

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(atomic.os, "fsync", full)
    with pytest.raises(StorageError, match=r"a\.bin") as caught:
        write(target, b"new", force=True)
    assert caught.value.code == "disk-full"
    assert target.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [target]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full")
def test_a_full_device_itself() -> None:
    def fill() -> None:
        with storage_errors("/dev/full"), Path("/dev/full").open("wb") as file:
            file.write(b"x" * 100_000)

    with pytest.raises(StorageError) as caught:
        fill()
    assert caught.value.code == "disk-full"


def test_messages_name_the_output_and_not_its_temporary(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    target = tmp_path / "a.bin"

    def busy(source: Path, destination: Path) -> None:
        raise OSError(errno.EACCES, "busy", str(source), None, str(destination))

    monkeypatch.setattr(Path, "replace", busy)
    with pytest.raises(StorageError) as caught:
        write(target, b"x")
    assert caught.value.message.startswith(f"{target}: busy")


@pytest.mark.parametrize("force", [False, True])
def test_a_folder_is_no_target(tmp_path: Path, force: bool) -> None:
    with pytest.raises(StorageError, match="a folder") as caught:
        write(tmp_path, b"x", force)
    assert caught.value.code == "not-a-file"


@pytest.mark.skipif(not Path("/dev/null").is_char_device(), reason="no /dev/null")
def test_a_device_is_no_target() -> None:
    with pytest.raises(StorageError, match="a device") as caught:
        write(Path("/dev/null"), b"x", force=True)
    assert caught.value.code == "not-a-file"


def test_a_missing_folder_and_a_file_for_a_folder(tmp_path: Path) -> None:
    for target in (tmp_path / "none" / "a.bin", tmp_path / "file" / "a.bin"):
        (tmp_path / "file").touch()
        with pytest.raises(StorageError) as caught:
            write(target, b"x")
        assert caught.value.code == "not-found"


@needs_permissions
def test_a_read_only_folder(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(StorageError) as caught:
            write(tmp_path / "a.bin", b"x")
    finally:
        tmp_path.chmod(0o700)
    assert caught.value.code == "permission"


@posix_only
def test_permission_bits_and_links_survive_a_replacement(tmp_path: Path) -> None:
    real, link = tmp_path / "real.bin", tmp_path / "link.bin"
    write(real, b"old")
    real.chmod(0o640)
    link.symlink_to(real)
    write(link, b"new", force=True)
    assert link.is_symlink()
    assert real.read_bytes() == b"new"
    assert stat.S_IMODE(real.stat().st_mode) == 0o640


def dead_pid() -> int:
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


@posix_only
def test_removes_what_dead_processes_of_this_machine_left(tmp_path: Path) -> None:
    here = f"{zlib.crc32(socket.gethostname().encode()):08x}"
    elsewhere = f"{int(here, 16) ^ 1:08x}"
    stale = tmp_path / f".a.bin.{dead_pid()}-{here}00000000.tmp"
    kept = [
        tmp_path / f".a.bin.{os.getpid()}-{here}00000000.tmp",
        tmp_path / f".a.bin.{dead_pid()}-{elsewhere}00000000.tmp",
        tmp_path / ".a.bin.tmp",
        tmp_path / "a.bin.1.tmp",
    ]
    for path in (stale, *kept):
        path.touch()
    write(tmp_path / "a.bin", b"x")
    assert sorted(tmp_path.iterdir()) == sorted([*kept, tmp_path / "a.bin"])


@posix_only
def test_a_killed_writer_leaves_no_target(tmp_path: Path) -> None:
    target = tmp_path / "a.bin"
    script = (
        "import os, signal, sys\n"
        "from cogsplat.formats.storage.atomic import atomic_write\n"
        "with atomic_write(sys.argv[1]) as file:\n"
        "    file.write(b'x'); file.flush(); os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    subprocess.run([sys.executable, "-c", script, str(target)], check=False)
    (left,) = tmp_path.iterdir()
    assert left.name.endswith(".tmp")
    write(target, b"whole")
    assert list(tmp_path.iterdir()) == [target]


def test_open_for_read(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(b"abc")
    with open_for_read(path) as file:
        assert file.read() == b"abc"
    for bad, code in ((tmp_path / "none", "not-found"), (tmp_path, "not-a-file")):
        with pytest.raises(StorageError) as caught:
            open_for_read(bad)
        assert caught.value.code == code


@posix_only
def test_opening_a_pipe_refuses_rather_than_waits(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(StorageError) as caught:
        open_for_read(tmp_path / "pipe")
    assert caught.value.code == "not-a-file"


@needs_permissions
def test_reading_without_permission(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    path.touch(mode=0o000)
    with pytest.raises(StorageError) as caught:
        open_for_read(path)
    assert caught.value.code == "permission"
