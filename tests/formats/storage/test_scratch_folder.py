"""Scratch folders: removed after use, and after their process was killed."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from cogsplat.formats.storage import scratch_folder as module
from cogsplat.formats.storage.atomic import host_digits
from cogsplat.formats.storage.scratch_folder import scratch_folder

pytestmark = pytest.mark.skipif(os.name != "posix", reason="locks of POSIX")


@pytest.fixture(autouse=True)
def parent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    module._remove_stale.cache_clear()
    return tmp_path


def names(parent: Path) -> list[str]:
    return sorted(path.name for path in parent.iterdir())


def test_a_folder_is_removed_after_the_block(parent: Path) -> None:
    with scratch_folder() as folder:
        (folder / "inner").mkdir()
        (folder / "inner" / "file").write_bytes(b"1")
        assert folder.stat().st_mode & 0o777 == 0o700
        assert names(parent) == [folder.name]
    assert names(parent) == []


def test_folders_of_killed_processes_are_removed_and_no_others(parent: Path) -> None:
    script = (
        "import os, signal, tempfile\n"
        "from cogsplat.formats.storage.scratch_folder import scratch_folder\n"
        f"tempfile.tempdir = {str(parent)!r}\n"
        "with scratch_folder() as folder:\n"
        "    (folder / 'large').write_bytes(b'1')\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    subprocess.run([sys.executable, "-c", script], check=False)
    (left,) = names(parent)
    assert (parent / left / "large").exists()
    empty = f"cogsplat-{host_digits()}-{'1' * 16}"
    others = [
        f"cogsplat-{'0' * 8}-{'1' * 16}",
        "cogsplat-notes",
        f"my-cogsplat-{host_digits()}-{'1' * 16}",
        f"cogsplat-{host_digits()}-{'2' * 16}",
    ]
    for name in (empty, *others):
        (parent / name).mkdir()
    # A folder of the right name without a lock, but with files, is none of ours.
    (parent / others[-1] / "mine").write_bytes(b"1")
    link = f"cogsplat-{host_digits()}-{'3' * 16}"
    (parent / link).symlink_to(parent / "cogsplat-notes")
    with scratch_folder() as folder:
        assert names(parent) == sorted([folder.name, link, *others])
        module._remove_stale.cache_clear()
        # A folder in use stays.
        with scratch_folder() as second:
            assert {folder.name, second.name} < set(names(parent))
    assert names(parent) == sorted([link, *others])


def test_folders_that_another_process_removes_meanwhile_are_no_error(
    parent: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names_of_stale = [f"cogsplat-{host_digits()}-{number:016x}" for number in range(2)]
    for name in names_of_stale:
        (parent / name).mkdir()
    remove = module._remove_unlocked

    def remove_all(folder: Path) -> None:
        for name in names_of_stale:
            remove(parent / name)

    monkeypatch.setattr(module, "_remove_unlocked", remove_all)
    with scratch_folder() as folder:
        assert names(parent) == [folder.name]
