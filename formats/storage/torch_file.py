"""Files of ``torch.save``, read without PyTorch: a zip of a pickle and of raw storages.

Only dictionaries, numbers, strings and tensors are built: a pickle that names any other class or
function is refused, so that nothing in it can run. Tensors are read when they are asked for.
"""

from __future__ import annotations

import collections
import io
import math
import pickle
import pickletools
import zipfile
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import DataError

from .atomic import StrPath, open_for_read, storage_errors
from .zip_directory import open_zip

F32 = NDArray[np.float32]

CODE: Final = "torch-file"
"""Reason code of a file that is not what it should be."""

# A trainer's file, optimiser and all, has some hundred tensors of about 200 bytes of pickle each;
# an opcode of one byte may make an object of 64.
_MOST_PICKLE_BYTES: Final = 1 << 19

# Some hundred entries of about 100 bytes each; the end of a ZIP file is looked for in 64 KiB.
_MOST_DIRECTORY_BYTES: Final = 1 << 20

# VGG-16 whole, its classifier included, is 528 MiB.
_MOST_BYTES: Final = 1 << 30

_DTYPES: Final[Mapping[str, str]] = {
    "FloatStorage": "<f4",
    "DoubleStorage": "<f8",
    "HalfStorage": "<f2",
    "LongStorage": "<i8",
    "IntStorage": "<i4",
}

# What damaged pickles, zips and headers end in.
_DAMAGE: Final = (
    zipfile.BadZipFile,
    pickle.UnpicklingError,
    zlib.error,
    EOFError,
    KeyError,
    IndexError,
    TypeError,
    ValueError,
    AttributeError,
    NotImplementedError,
    RuntimeError,
    OverflowError,
)

# Opcodes that store an object under a number, for which the unpickler of CPython keeps an array up
# to that number: eight bytes of pickle could take gigabytes.
_STORES: Final = frozenset({"PUT", "BINPUT", "LONG_BINPUT"})


@dataclass(frozen=True)
class TorchTensor:
    """A tensor of a file that is open: its values are read by `array`.

    Parameters
    ----------
    read : callable
        Returns the bytes of the storage.
    dtype : str
        As numpy writes it.
    count : int
        Values of the storage.
    offset : int
        First of them that is the tensor's.
    shape : tuple of int
    """

    read: Callable[[], bytes]
    dtype: str
    count: int
    offset: int
    shape: tuple[int, ...]

    def array(self) -> F32:
        """Return the values as float32.

        Raises
        ------
        DataError
            ``torch-file``: the storage holds another number of values.
        """
        values = np.frombuffer(self.read(), np.dtype(self.dtype))
        if len(values) != self.count:
            raise DataError(CODE, f"a storage of {len(values)} values, expected {self.count}")
        size = math.prod(self.shape)
        return values[self.offset : self.offset + size].reshape(self.shape).astype(np.float32)


@contextmanager
def open_torch(path: StrPath) -> Iterator[Mapping[object, object]]:
    """Open what ``torch.save`` wrote; the block gets the dictionary that was saved.

    Parameters
    ----------
    path : path

    Yields
    ------
    mapping
        Dictionaries in it are dictionaries, tensors are `TorchTensor`.

    Raises
    ------
    StorageError
        It cannot be read.
    DataError
        ``torch-file``: it is no such file, or holds something else than dictionaries, numbers,
        strings and tensors.
    """
    with _opened(path) as archive:
        found = _unpickled(archive)
        if not isinstance(found, dict):
            raise _bad(path, f"a {type(found).__name__}")
        yield found


@contextmanager
def _opened(path: StrPath) -> Iterator[zipfile.ZipFile]:
    """Open a zip; what damage raises in the block becomes ``torch-file``."""
    with storage_errors(path), open_for_read(path) as file:
        try:
            with open_zip(file, _MOST_DIRECTORY_BYTES, lambda found: _bad(path, found)) as archive:
                yield archive
        except DataError:
            raise
        except _DAMAGE as error:
            raise _bad(path, f"{type(error).__name__}: {error}") from error


def _pickle_name(archive: zipfile.ZipFile) -> str | None:
    return next((name for name in archive.namelist() if name.endswith("/data.pkl")), None)


def _unpickled(archive: zipfile.ZipFile) -> object:
    """Return what was saved; tensors read their storages from the archive."""
    name = _pickle_name(archive)
    if name is None:
        raise zipfile.BadZipFile("no pickle in the zip")
    folder = name[: -len("data.pkl")]
    data = _stored(archive, name, _MOST_PICKLE_BYTES)
    for opcode, number, position in pickletools.genops(data):
        if opcode.name in _STORES and isinstance(number, int) and number > len(data):
            raise pickle.UnpicklingError(
                f"an object numbered {number} at byte {position} of {len(data)}, expected numbers "
                "from 0 on"
            )
    stream = io.BytesIO(data)
    return _Tensors(stream, lambda key: _stored(archive, f"{folder}data/{key}", _MOST_BYTES)).load()


def _stored(archive: zipfile.ZipFile, name: str, most: int) -> bytes:
    """Return an entry that is stored, as torch stores all, and so no longer than the file is."""
    entry = archive.getinfo(name)
    if entry.compress_type != zipfile.ZIP_STORED or entry.file_size > min(
        most, entry.compress_size
    ):
        raise zipfile.BadZipFile(
            f"{name[:60]} of {entry.compress_size} bytes, {entry.file_size} unpacked, expected it "
            f"stored and at most {most} bytes"
        )
    return archive.read(entry)


def read_state_dict(path: StrPath) -> dict[str, F32]:
    """Read named arrays from what ``torch.save`` or ``numpy.savez`` wrote.

    Parameters
    ----------
    path : path

    Returns
    -------
    dict of str to float32 array

    Raises
    ------
    StorageError
        It cannot be read.
    DataError
        ``torch-file``: it is neither, or holds something else than named arrays.
    """
    with _opened(path) as archive:
        if sum(entry.file_size for entry in archive.infolist()) > _MOST_BYTES:
            raise _bad(path, f"more than {_MOST_BYTES} bytes")
        if _pickle_name(archive) is None:
            return {name.removesuffix(".npy"): _npy(archive, name) for name in archive.namelist()}
        state = _unpickled(archive)
        if not isinstance(state, dict):
            raise _bad(path, f"a {type(state).__name__}")
        # State dicts carry their modules' versions beside the arrays.
        return {str(k): v.array() for k, v in state.items() if isinstance(v, TorchTensor)}


def _npy(archive: zipfile.ZipFile, name: str) -> F32:
    """Return one array of what ``numpy.savez`` wrote."""
    with archive.open(name) as file:
        version = np.lib.format.read_magic(file)
        read_header = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }
        shape, by_columns, dtype = read_header[version](file)
        data = file.read()
    # Not by `read_array`, which allocates what the header says before it reads.
    if dtype.hasobject or len(data) != math.prod(shape) * dtype.itemsize:
        raise ValueError(f"{name[:60]}: {len(data)} bytes, expected {dtype} of shape {shape}")
    values = np.frombuffer(data, dtype).reshape(shape, order="F" if by_columns else "C")
    return np.ascontiguousarray(values, np.float32)


@dataclass(frozen=True)
class _Storage:
    read: Callable[[], bytes]
    dtype: str
    count: int


class _Tensors(pickle.Unpickler):
    """Unpickler that builds dictionaries of tensors and refuses every other class or function."""

    def __init__(self, stream: object, read: Callable[[str], bytes]) -> None:
        super().__init__(stream)  # type: ignore[arg-type]
        self._read = read

    def find_class(self, module: str, name: str) -> object:
        """Return what builds the class of this name, or refuse it."""
        if (module, name) == ("collections", "OrderedDict"):
            return collections.OrderedDict
        if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
            return _tensor
        if (module, name) == ("torch._utils", "_rebuild_parameter"):
            return _parameter
        if module == "torch" and name in _DTYPES:
            return _DTYPES[name]
        raise pickle.UnpicklingError(f"{module}.{name}, expected tensors and dictionaries")

    def persistent_load(self, key: object) -> _Storage:
        """Return a storage."""
        if not isinstance(key, tuple) or len(key) != 5 or key[0] != "storage":
            raise pickle.UnpicklingError(f"{str(key)[:80]}, expected a storage")
        _, dtype, name, _, count = key
        if dtype not in _DTYPES.values() or not isinstance(count, int):
            raise pickle.UnpicklingError(f"storage of {str(dtype)[:80]}, expected numbers")
        return _Storage(lambda: self._read(str(name)), str(dtype), count)


def _tensor(
    storage: _Storage, offset: int, shape: tuple[int, ...], stride: tuple[int, ...], *_: object
) -> TorchTensor:
    """Return a tensor that is a run of its storage."""
    count = math.prod(shape)
    steps = [math.prod(shape[axis + 1 :]) for axis in range(len(shape))]
    # Saved weights are contiguous; an axis of length 1 may have any stride.
    plain = all(size == 1 or a == b for size, a, b in zip(shape, stride, steps, strict=True))
    if not plain or not 0 <= offset <= offset + count <= storage.count:
        raise pickle.UnpicklingError(f"tensor of shape {shape} with strides {stride}")
    return TorchTensor(storage.read, storage.dtype, storage.count, offset, tuple(shape))


def _parameter(tensor: TorchTensor, *_: object) -> TorchTensor:
    """Return a parameter's tensor."""
    return tensor


def _bad(path: StrPath, found: str) -> DataError:
    return DataError(CODE, f"{path}: {found[:200]}, expected arrays that torch.save wrote, or .npz")
