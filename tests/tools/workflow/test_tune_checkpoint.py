"""Checkpoints: their fingerprint is read first, and nothing beyond the bytes that are stored."""

import io
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest

from cogsplat.codec.errors import CogsplatError
from cogsplat.tools.workflow.tune_checkpoint import read_checkpoint, write_checkpoint

RUN, OTHER = "0" * 64, "1" * 64
STATE = {"steps": np.array(3), "errors": np.arange(5.0), "splats.means": np.ones((4, 3), "f4")}


def code_of(path: Path, run: str = RUN) -> str:
    """Return the reason code with which a checkpoint is refused, within 64 MiB."""
    tracemalloc.start()
    try:
        with pytest.raises(CogsplatError) as error:
            read_checkpoint(path, run)
        assert tracemalloc.get_traced_memory()[1] < 64 << 20
    finally:
        tracemalloc.stop()
    assert str(path) in error.value.message
    return error.value.code


def npy(values: np.ndarray, **header: object) -> bytes:
    """Return the bytes of an array, with other values in the header."""
    page = io.BytesIO()
    if not header:
        np.save(page, values, allow_pickle=True)
        return page.getvalue()
    described = {"descr": "<f8", "fortran_order": False, "shape": (1,), **header}
    np.lib.format.write_array_header_1_0(page, described)
    return page.getvalue() + values.tobytes()


def archive(path: Path, files: dict[str, bytes], method: int = zipfile.ZIP_STORED) -> None:
    with zipfile.ZipFile(path, "w", method) as out:
        for name, data in files.items():
            out.writestr(name, data)


def test_a_checkpoint_gives_back_what_was_written(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    write_checkpoint(path, RUN, STATE)
    write_checkpoint(path, RUN, STATE)
    found = read_checkpoint(path, RUN)
    assert list(found) == list(STATE)
    for name, values in STATE.items():
        np.testing.assert_array_equal(found[name], values)
        assert found[name].dtype == values.dtype
    assert code_of(path, OTHER) == "other-checkpoint"


def test_other_files_are_no_checkpoints(tmp_path: Path) -> None:
    path = tmp_path / "a.npy"
    np.save(path, np.zeros(3))
    assert code_of(path) == "bad-checkpoint"
    path.write_bytes(b"")
    assert code_of(path) == "bad-checkpoint"
    archive(path, {"means.npy": npy(np.zeros(3))})
    assert code_of(path) == "bad-checkpoint"
    (tmp_path / "link").symlink_to(path)
    assert code_of(tmp_path / "link") == "not-a-file"


@pytest.mark.parametrize("method", [zipfile.ZIP_DEFLATED, zipfile.ZIP_STORED])
def test_the_fingerprint_is_read_before_the_arrays(tmp_path: Path, method: int) -> None:
    path = tmp_path / "a.npz"
    zeros = npy(np.zeros(0), shape=(1 << 24,)) + bytes(1 << 27)
    files = {"cogsplat-checkpoint.npy": npy(np.array(OTHER)), "splats.means.npy": zeros}
    with zipfile.ZipFile(path, "w") as out:
        for name, data in files.items():
            out.writestr(name, data, zipfile.ZIP_STORED if "cog" in name else method)
    assert code_of(path) == "other-checkpoint"
    if method == zipfile.ZIP_DEFLATED:
        assert code_of(path, OTHER) == "bad-checkpoint"


@pytest.mark.parametrize("method", [zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA])
def test_compressed_arrays_are_refused(tmp_path: Path, method: int) -> None:
    path = tmp_path / "a.npz"
    archive(path, {"cogsplat-checkpoint.npy": npy(np.array(RUN))}, method)
    assert code_of(path) == "bad-checkpoint"


@pytest.mark.parametrize(
    "data",
    [
        npy(np.zeros(3), shape=(4,)),
        npy(np.zeros(3), shape=(1 << 60,)),
        npy(np.zeros(3), shape=(-3,)),
        npy(np.zeros(3), descr="|O", shape=(3,)),
        npy(np.array([None, {}])),
        b"\x93NUMPY\x01\x00\xff\xff" + b"(" * 65535,
        b"\x93NUMPY\x03\x00",
        b"",
    ],
    ids=["longer", "huge", "negative", "objects", "pickled", "header", "version", "empty"],
)
def test_headers_that_lie_are_refused(tmp_path: Path, data: bytes) -> None:
    path = tmp_path / "a.npz"
    archive(path, {"cogsplat-checkpoint.npy": npy(np.array(RUN)), "steps.npy": data})
    assert code_of(path) == "bad-checkpoint"


def test_a_long_fingerprint_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    archive(path, {"cogsplat-checkpoint.npy": npy(np.array("0" * 1000))})
    assert code_of(path) == "bad-checkpoint"


@pytest.mark.parametrize("content", [b"notes", b"PK\x03\x04" + bytes(26) + b"other.npy", b"PK"])
def test_files_of_others_are_not_replaced(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.npz"
    path.write_bytes(content)
    with pytest.raises(CogsplatError) as error:
        write_checkpoint(path, RUN, STATE)
    assert (error.value.code, error.value.exit_code) == ("foreign-file", 2)
    assert path.read_bytes() == content


def test_a_link_is_not_written_through(tmp_path: Path) -> None:
    path, link = tmp_path / "a.npz", tmp_path / "link.npz"
    write_checkpoint(path, OTHER, STATE)
    before = path.read_bytes()
    link.symlink_to(path)
    with pytest.raises(CogsplatError) as error:
        write_checkpoint(link, RUN, STATE)
    assert error.value.code == "not-a-file"
    assert path.read_bytes() == before
