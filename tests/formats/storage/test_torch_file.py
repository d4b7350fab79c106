"""Files of torch.save, read without PyTorch, and hostile ones."""

import io
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
from lpips_weights import alex
from torch_files import Named, Storage, Tensor, saved, tensor

from cogsplat.codec.errors import DataError, StorageError
from cogsplat.formats.storage import torch_file
from cogsplat.formats.storage.torch_file import read_state_dict


def test_what_torch_saved_is_read(tmp_path: Path) -> None:
    arrays = alex(3)
    path = tmp_path / "weights.pth"
    names = list(arrays)
    state = {name: tensor(str(index), arrays[name]) for index, name in enumerate(names)}
    state[names[1]] = Tensor(state[names[1]], True, {}, rebuild="_rebuild_parameter")
    half = arrays[names[2]].astype(np.float16)
    state[names[2]] = tensor("2", half, "HalfStorage")  # type: ignore[arg-type]
    storages = {str(index): arrays[name].tobytes() for index, name in enumerate(names)}
    storages["2"] = half.tobytes()
    saved(path, {**state, "_metadata": {"version": 1}}, storages)
    found = read_state_dict(path)
    assert list(found) == names
    for name in names:
        expected = half if name == names[2] else arrays[name]
        np.testing.assert_array_equal(found[name], expected.astype(np.float32))


@pytest.mark.parametrize(
    "state",
    [
        Tensor(Storage("0", 4), 0, (5,), (1,), False, {}),
        Tensor(Storage("0", 4), 1, (4,), (1,), False, {}),
        Tensor(Storage("0", 4), -1, (2,), (1,), False, {}),
        Tensor(Storage("0", 4), 0, (2, 2), (1, 2), False, {}),
        Tensor(Storage("0", 5), 0, (4,), (1,), False, {}),
        Tensor(Storage("9", 4), 0, (4,), (1,), False, {}),
        Tensor(Storage("0", 4, "system"), 0, (4,), (1,), False, {}),
        Tensor("ls", rebuild="system"),
        Named("os", "system"),
        Named("builtins", "eval"),
        [1, 2, 3],
    ],
)
def test_hostile_pickles_build_nothing(tmp_path: Path, state: object) -> None:
    path = tmp_path / "weights.pth"
    saved(path, state if isinstance(state, list) else {"a": state}, {"0": bytes(16)})
    with pytest.raises(DataError) as caught:
        read_state_dict(path)
    assert caught.value.code == "torch-file"


@pytest.mark.parametrize(
    "pickled",
    [
        # Lengths beyond any memory.
        b"\x80\x04\x8e" + b"\xff" * 8 + b".",
        b"\x80\x04\x95" + b"\xff" * 8 + b"}.",
    ],
    ids=["bytes", "frame"],
)
def test_numbers_in_a_pickle_that_would_take_memory_are_refused(
    tmp_path: Path, pickled: bytes
) -> None:
    path = tmp_path / "weights.pth"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("archive/data.pkl", pickled)
    with pytest.raises(DataError) as caught:
        read_state_dict(path)
    assert caught.value.code == "torch-file"


@pytest.mark.parametrize("pickled", [b"\x80\x02}r\x00\x00\x00\x04.", b"\x80\x02}p30000000\n."])
def test_objects_under_large_numbers_take_no_memory(tmp_path: Path, pickled: bytes) -> None:
    """Memo indices for which CPython's compiled unpickler would allocate 1 GiB and 480 MB."""
    path = tmp_path / "weights.pth"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("archive/data.pkl", pickled)
    tracemalloc.start()
    try:
        with pytest.raises(DataError, match="no arrays"):
            read_state_dict(path)
        assert tracemalloc.get_traced_memory()[1] < 64 << 20
    finally:
        tracemalloc.stop()


def nested(depth: int, width: int = 8) -> bytes:
    """Return opcodes of nested tuples that share their items: a hash visits width^depth."""
    out = b"K\x00q\x000"
    for level in range(depth):
        reference = b"h" + bytes([level])
        out += b"(" + reference * width + b"tq" + bytes([level + 1])
        out += b"0"
    return out + b"h" + bytes([depth])


@pytest.mark.parametrize(
    "pickled",
    [
        b"\x80\x02}" + nested(24) + b"K\x01s.",
        b"\x80\x02}(" + nested(24) + b"K\x01u.",
        b"\x80\x02(" + nested(24) + b"K\x01d.",
        b"\x80\x02" + nested(24) + b"Q.",
        b"\x80\x02((X\x07\x00\x00\x00storagectorch\nFloatStorage\n" + nested(24) + b"NK\x01tQ.",
        b"\x80\x04\x8f(" + nested(24) + b"\x90.",
        b"\x80\x04(" + nested(24) + b"\x91.",
        b"\x80\x02ccollections\nOrderedDict\n(](]" + nested(24) + b"aK\x01aaatR.",
        b"\x80\x02ctorch._utils\n_rebuild_tensor_v2\n(" + nested(24) + b"K\x00))tR.",
        b"\x80\x02ctorch._utils\n_rebuild_tensor_v2\n((X\x07\x00\x00\x00storage"
        b"ctorch\nFloatStorage\nX\x01\x00\x00\x000NK\x01tQK\x00" + nested(24) + b")tR.",
        b"\x80\x05" + b"\x8f" * 500_000 + b".",
        b"\x80\x05\x96\x00\x00\x00\x00\x04\x00\x00\x00}.",
    ],
    ids=[
        *("key", "keys", "dictionary", "id", "part of an id", "set", "frozen set"),
        *("ordered dictionary", "storage", "shape", "sets", "bytearray"),
    ],
)
def test_shared_structure_takes_neither_time_nor_memory(tmp_path: Path, pickled: bytes) -> None:
    """The hash and the text of such a tuple take longer than any test."""
    path = tmp_path / "weights.pth"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("archive/data.pkl", pickled)
    tracemalloc.start()
    try:
        with pytest.raises(DataError) as caught:
            read_state_dict(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert caught.value.code == "torch-file"
    assert peak < 64 << 20


def test_tensors_of_one_storage_are_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(torch_file, "_MAX_BYTES", 1 << 16)
    values = np.zeros(1000, np.float32)
    path = tmp_path / "a.pth"
    saved(path, {str(n): tensor("0", values) for n in range(16)}, {"0": values.tobytes()})
    assert len(read_state_dict(path)) == 16
    saved(path, {str(n): tensor("0", values) for n in range(17)}, {"0": values.tobytes()})
    with pytest.raises(DataError, match="tensors of more than 65536 bytes"):
        read_state_dict(path)


def test_attributes_of_dictionaries_are_skipped(tmp_path: Path) -> None:
    """torch keeps the versions of modules as an attribute of an OrderedDict."""
    values = np.arange(3, dtype=np.float32)
    path, plain = tmp_path / "a.pth", tmp_path / "plain.pth"
    saved(plain, {"w": tensor("0", values)}, {"0": values.tobytes()})
    with zipfile.ZipFile(plain) as source, zipfile.ZipFile(path, "w") as out:
        for name in source.namelist():
            data = source.read(name)
            if name.endswith(".pkl"):
                data = data.replace(b"\x80\x02}", b"\x80\x02ccollections\nOrderedDict\n)R")
                data = data[:-1] + b"}X\x09\x00\x00\x00_metadata}sb."
            out.writestr(name, data)
    assert read_state_dict(path)["w"].tolist() == [0, 1, 2]


@pytest.mark.parametrize("length", [0, 1, 10, 100, 400])
def test_files_that_are_none_are_refused(tmp_path: Path, length: int) -> None:
    path = tmp_path / "weights.npz"
    page = io.BytesIO()
    np.savez(page, **alex(3))
    path.write_bytes(page.getvalue()[:length])
    with pytest.raises(DataError) as caught:
        read_state_dict(path)
    assert caught.value.code == "torch-file"
    with pytest.raises(StorageError):
        read_state_dict(tmp_path / "nothing.pth")


@pytest.mark.parametrize("deflated", ["a/data.pkl", "a/data/0"])
def test_entries_that_inflate_are_refused(tmp_path: Path, deflated: str) -> None:
    """torch stores entries uncompressed; compressed entries are refused."""
    plain, packed = tmp_path / "plain.pth", tmp_path / "packed.pth"
    values = np.zeros(1000, np.float32)
    saved(plain, {"w": tensor("0", values)}, {"0": values.tobytes()})
    assert len(read_state_dict(plain)["w"]) == 1000
    with zipfile.ZipFile(plain) as source, zipfile.ZipFile(packed, "w") as out:
        for name in source.namelist():
            method = zipfile.ZIP_DEFLATED if name.endswith(deflated[1:]) else zipfile.ZIP_STORED
            out.writestr(name, source.read(name), method)
    with pytest.raises(DataError, match="expected it uncompressed"):
        read_state_dict(packed)


def test_a_long_pickle_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.pth"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a/data.pkl", b"\x80\x02" + b"}" * (1 << 20))
    with pytest.raises(DataError, match="expected it uncompressed and at most"):
        read_state_dict(path)


def test_arrays_of_any_layout_are_read(tmp_path: Path) -> None:
    values = np.arange(12, dtype=np.float64).reshape(3, 4)
    path = tmp_path / "a.npz"
    np.savez(path, rows=values, columns=np.asfortranarray(values), one=np.float32(2))
    found = read_state_dict(path)
    assert list(found) == ["rows", "columns", "one"]
    for name in ("rows", "columns"):
        np.testing.assert_array_equal(found[name], values.astype(np.float32))
    assert found["one"] == 2.0


@pytest.mark.parametrize("values", [np.array([None]), np.zeros(3)])
def test_objects_and_sizes_that_are_not_there_are_refused(
    tmp_path: Path, values: np.ndarray
) -> None:
    """An array is allocated only once the file holds all its bytes."""
    whole, path = io.BytesIO(), tmp_path / "a.npz"
    np.save(whole, values, allow_pickle=True)
    data = whole.getvalue().replace(b"(3,)", b"(9" + b"0" * 12 + b",)")
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("w.npy", data)
    with pytest.raises(DataError) as caught:
        read_state_dict(path)
    assert caught.value.code == "torch-file"


def test_a_large_directory_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.pth"
    with zipfile.ZipFile(path, "w") as archive:
        for number in range(20_000):
            archive.writestr(f"a/data/{number}", b"")
    with pytest.raises(DataError, match="a ZIP directory of more than 1048576 bytes"):
        read_state_dict(path)
