from __future__ import annotations

import errno
import os
import socket
import stat
import subprocess
import sys
import zlib
from pathlib import Path
from typing import BinaryIO

import pytest

from cogsplat.codec.errors import StorageError
from cogsplat.formats.storage import atomic
from cogsplat.formats.storage.atomic import (
    OutputIsInputError,
    TargetExistsError,
    atomic_write,
    check_output,
    open_for_read,
    storage_errors,
    sync_all,
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
        write(target, b"x", force=True)
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


def machine() -> str:
    return f"{zlib.crc32(socket.gethostname().encode()):08x}"


def dead_pid() -> int:
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


@posix_only
def test_removes_what_dead_processes_of_this_machine_left(tmp_path: Path) -> None:
    elsewhere = f"{int(machine(), 16) ^ 1:08x}"
    stale = tmp_path / f".a.bin.{dead_pid()}-{machine()}00000000.tmp"
    kept = [
        tmp_path / f".a.bin.{dead_pid()}-{elsewhere}00000000.tmp",
        tmp_path / ".a.bin.tmp",
        tmp_path / "a.bin.1.tmp",
    ]
    for path in (stale, *kept):
        path.touch()
    write(tmp_path / "a.bin", b"x")
    assert sorted(tmp_path.iterdir()) == sorted([*kept, tmp_path / "a.bin"])


@posix_only
def test_a_live_temporary_stays_though_its_number_says_nothing_here(tmp_path: Path) -> None:
    """In another container of the machine, the same volume shows other processes' files."""
    writer = atomic_write(tmp_path / "live.bin")
    file = writer.__enter__()
    file.write(b"work of minutes")
    (own,) = tmp_path.iterdir()
    foreign = tmp_path / f".live.bin.{dead_pid()}-{machine()}00000000.tmp"
    own.rename(foreign)
    script = (
        "import sys\n"
        "from cogsplat.formats.storage.atomic import atomic_write\n"
        "with atomic_write(sys.argv[1]) as file:\n"
        "    file.write(b'x')\n"
    )
    subprocess.run([sys.executable, "-c", script, str(tmp_path / "other.bin")], check=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == [foreign.name, "other.bin"]
    foreign.rename(own)
    writer.__exit__(None, None, None)
    assert (tmp_path / "live.bin").read_bytes() == b"work of minutes"


@posix_only
def test_an_output_is_checked_while_another_process_removes_stale_temporaries(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The temporary of a check is unlocked for a moment before the check removes it."""
    unlink = Path.unlink

    def unlink_after_another_process(path: Path, missing_ok: bool = False) -> None:
        if path.exists():
            unlink(path)
        unlink(path, missing_ok)

    monkeypatch.setattr(Path, "unlink", unlink_after_another_process)
    atomic.check_output(tmp_path / "a.bin", force=False)
    assert list(tmp_path.iterdir()) == []


@posix_only
def test_a_temporary_cleared_before_it_was_locked_is_made_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    locked = []

    def lock(file: BinaryIO) -> bool:
        locked.append(file.name)
        if len(locked) == 1:
            Path(file.name).unlink()
        return True

    monkeypatch.setattr(atomic, "lock", lock)
    write(tmp_path / "a.bin", b"x")
    assert len(locked) == 2
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"x"]


def race(target: Path, writers: int) -> list[str]:
    """Let processes write one path at once, and return what each says."""
    script = (
        "import sys, time\n"
        "from cogsplat.codec.errors import StorageError\n"
        "from cogsplat.formats.storage.atomic import atomic_write\n"
        "print('ready', flush=True); sys.stdin.readline()\n"
        "try:\n"
        "    with atomic_write(sys.argv[1]) as file:\n"
        "        file.write(sys.argv[2].encode())\n"
        "    print('won')\n"
        "except StorageError as error:\n"
        "    print(error.code)\n"
    )
    processes = [
        subprocess.Popen(
            [sys.executable, "-c", script, str(target), str(k)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        for k in range(writers)
    ]
    for process in processes:
        assert process.stdout is not None
        process.stdout.readline()
    for process in processes:
        assert process.stdin is not None
        process.stdin.write("go\n")
        process.stdin.flush()
    return [process.communicate()[0].strip() for process in processes]


def test_of_several_writers_exactly_one_succeeds(tmp_path: Path) -> None:
    target = tmp_path / "a.bin"
    found = race(target, 4)
    assert sorted(found) == ["exists", "exists", "exists", "won"]
    assert target.read_text() == str(found.index("won"))
    assert list(tmp_path.iterdir()) == [target]


def arrive_late(target: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let another file take the name after the last look at it and before it is given."""
    real = os.fsync

    def sync(descriptor: int) -> None:
        real(descriptor)
        target.write_bytes(b"first")

    monkeypatch.setattr(atomic.os, "fsync", sync)


@pytest.mark.skipif(os.name != "posix", reason="folders are synced on POSIX alone")
def test_the_file_is_synced_before_its_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    synced: list[bool] = []
    real = os.fsync

    def sync(descriptor: int) -> None:
        synced.append(stat.S_ISDIR(os.fstat(descriptor).st_mode))
        real(descriptor)

    monkeypatch.setattr(atomic.os, "fsync", sync)
    write(tmp_path / "a.bin", b"here")
    assert synced == [False, True]


def without_links(source: Path, target: Path) -> None:
    raise OSError(errno.EPERM, os.strerror(errno.EPERM))


@pytest.mark.parametrize("links", [True, False])
def test_a_name_taken_at_the_last_moment_is_not_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, links: bool
) -> None:
    if not links:
        monkeypatch.setattr(atomic.os, "link", without_links)
    arrive_late(tmp_path / "a.bin", monkeypatch)
    with pytest.raises(TargetExistsError):
        write(tmp_path / "a.bin", b"second")
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"first"]


def test_file_systems_without_hard_links(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(atomic.os, "link", without_links)
    write(tmp_path / "a.bin", b"x")
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"x"]


@pytest.mark.parametrize("name", ["a" * 251 + ".bin", "ä" * 125 + ".bin"])
def test_names_as_long_as_the_file_system_takes(tmp_path: Path, name: str) -> None:
    write(tmp_path / name, b"x")
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_an_output_is_found_out_before_the_work(tmp_path: Path) -> None:
    target = tmp_path / "a.bin"
    check_output(target, force=False)
    assert list(tmp_path.iterdir()) == []
    target.write_bytes(b"old")
    check_output(target, force=True)
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [b"old"]
    with pytest.raises(TargetExistsError):
        check_output(target, force=False)
    with pytest.raises(StorageError) as caught:
        check_output(tmp_path / "none" / "a.bin", force=False)
    assert caught.value.code == "not-found"


@pytest.mark.skipif(not Path("/proc/self").is_dir(), reason="no /proc")
def test_a_folder_that_takes_no_files(tmp_path: Path) -> None:
    with pytest.raises(StorageError) as caught:
        check_output("/proc/a.bin", force=False)
    assert caught.value.exit_code == 4


@posix_only
@pytest.mark.parametrize("force", [False, True])
@pytest.mark.parametrize("name", ["scene.bin", "folder/../scene.bin", "soft.bin", "hard.bin"])
def test_an_output_that_is_an_input(tmp_path: Path, name: str, force: bool) -> None:
    (tmp_path / "folder").mkdir()
    source = tmp_path / "scene.bin"
    source.write_bytes(b"x")
    (tmp_path / "soft.bin").symlink_to(source)
    os.link(source, tmp_path / "hard.bin")
    with pytest.raises(OutputIsInputError) as caught:
        check_output(tmp_path / name, force=force, inputs=[tmp_path / "none", source])
    assert (caught.value.code, caught.value.exit_code) == ("output-is-input", 2)


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


def test_many_files_are_synced_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[str] = []
    monkeypatch.setattr(os, "fsync", lambda descriptor: synced.append("one"))
    paths = [tmp_path / f"{number}.bin" for number in range(3)]
    for path in paths:
        with atomic_write(path, durable=False) as file:
            file.write(b"x")
    assert synced == []
    monkeypatch.setattr(os, "sync", lambda: synced.append("all"), raising=False)
    sync_all(paths)
    assert synced == ["all"]
    # As on Windows, which has no call for all of them.
    monkeypatch.delattr(os, "sync")
    sync_all(paths)
    assert synced == ["all", "one", "one", "one"]
    assert {path.read_bytes() for path in paths} == {b"x"}


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
