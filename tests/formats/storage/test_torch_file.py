"""Files of torch.save, read without PyTorch, and hostile ones."""

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest
from lpips_weights import alex
from torch_files import Named, Storage, Tensor, saved, tensor

from cogsplat.codec.errors import DataError, StorageError
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
        # Objects stored under numbers that make the unpickler of CPython keep 1 GiB and 480 MB.
        b"\x80\x02}r\x00\x00\x00\x04.",
        b"\x80\x02}p30000000\n.",
        # Lengths beyond any memory.
        b"\x80\x04\x8e" + b"\xff" * 8 + b".",
        b"\x80\x04\x95" + b"\xff" * 8 + b"}.",
    ],
    ids=["memo", "memo in digits", "bytes", "frame"],
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
    """What torch stores takes its own size in the file; nothing else is read."""
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
    """What a header says is not allocated before the bytes are there."""
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
