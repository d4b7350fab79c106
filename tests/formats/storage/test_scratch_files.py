import sys
from pathlib import Path

import numpy as np
import pytest

from cogsplat.codec.errors import StorageError
from cogsplat.formats.storage.scratch_files import ScratchFiles


def resident_bytes(kind: str = "VmRSS") -> int:
    with Path("/proc/self/status").open(encoding="ascii") as file:
        return next(int(line.split()[1]) * 1024 for line in file if line.startswith(kind))


def resident_file_bytes() -> int:
    return resident_bytes("RssFile")


def test_arrays_are_zeros_that_keep_what_is_written(tmp_path):
    with ScratchFiles(tmp_path, 0) as files:
        values = files.zeros((70_000, 3), np.float32)
        small = files.zeros((2, 2), np.int32)
        assert values.shape == (70_000, 3)
        assert values.flags.c_contiguous
        assert not values.any()
        assert not small.any()
        written = np.random.default_rng(1).normal(size=values.shape).astype(np.float32)
        values[:] = written
        files.evict()
        np.testing.assert_array_equal(values, written)
    # Behind the context as well.
    np.testing.assert_array_equal(values, written)


def test_no_file_has_a_name(tmp_path):
    with ScratchFiles(tmp_path, 1 << 20) as files:
        values = files.zeros((1 << 20,), np.uint8)
        values[:] = 1
        assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells what is resident")
def test_few_pages_stay_in_memory(tmp_path):
    size, most = 96 << 20, 8 << 20
    with ScratchFiles(tmp_path, most) as files:
        values = files.zeros((size,), np.uint8)
        before = resident_file_bytes()
        highest = 0
        for start in range(0, size, 1 << 20):
            values[start : start + (1 << 20)] = 7
            files.evict()
            highest = max(highest, resident_file_bytes() - before)
        assert highest <= most + (2 << 20)
        assert int(values.sum(dtype=np.int64)) == 7 * size


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells what is resident")
def test_pages_stay_while_the_process_has_memory_left(tmp_path):
    size = 64 << 20
    with ScratchFiles(tmp_path, 0, resident_bytes() + 2 * size) as files:
        values = files.zeros((size,), np.uint8)
        before = resident_file_bytes()
        values[:] = 1
        files.evict()
        assert resident_file_bytes() - before > size // 2
        taken = np.ones(2 * size, np.uint8)
        files.evict()
        assert resident_file_bytes() - before < size // 2
        assert taken.all()
    assert values.all()


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells what is resident")
def test_pages_go_without_being_asked(tmp_path):
    size = 64 << 20
    with ScratchFiles(tmp_path, 0) as files:
        values = files.zeros((size,), np.uint8)
        before = resident_file_bytes()
        values[:] = 1
        for _ in range(2000):
            if resident_file_bytes() - before < size // 2:
                break
            # Leaves the interpreter to the thread that watches.
            np.sort(np.zeros(100_000))
        else:
            pytest.fail("all pages stayed in memory")


def test_a_folder_that_is_not_there_is_refused(tmp_path):
    with ScratchFiles(tmp_path / "none", 0) as files, pytest.raises(StorageError) as refused:
        files.zeros((1 << 20,), np.float32)
    assert refused.value.code == "not-found"
