"""Reader for ``torch.save`` files without PyTorch: a ZIP of a pickle and raw tensor storages.

Only dictionaries, numbers, strings and tensors are built. A pickle with any other class or function
is refused, so that no code in it can run. Tensor values are read on access.
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
"""Reason code of a damaged or unsupported file."""

# A training checkpoint with its optimiser has some hundred tensors of about 200 bytes of pickle
# each. An opcode of one byte may make an object of 64 bytes.
_MAX_PICKLE_BYTES: Final = 1 << 19

# Some hundred entries of about 100 bytes each, and the last 64 KiB, where the directory's end is.
_MAX_DIRECTORY_BYTES: Final = 1 << 20

# VGG-16 with its classifier has 528 MiB.
_MAX_BYTES: Final = 1 << 30

_DTYPES: Final[Mapping[str, str]] = {
    "FloatStorage": "<f4",
    "DoubleStorage": "<f8",
    "HalfStorage": "<f2",
    "LongStorage": "<i8",
    "IntStorage": "<i4",
}

# Exceptions that damaged pickles, ZIP files and headers raise.
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

# Opcodes that store an object under a number. CPython's unpickler allocates an array up to that
# number: eight bytes of pickle could take gigabytes.
_STORES: Final = frozenset({"PUT", "BINPUT", "LONG_BINPUT"})


@dataclass(frozen=True)
class TorchTensor:
    """Tensor of an open file, whose values `array` reads.

    Parameters
    ----------
    read : callable
        Function that returns the bytes of the storage.
    dtype : str
        numpy name of the type, such as ``<f4``.
    count : int
        Number of values in the storage.
    offset : int
        Index of the tensor's first value in the storage.
    shape : tuple of int
        Shape of the tensor.
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
            ``torch-file``: the storage has another length.
        """
        values = np.frombuffer(self.read(), np.dtype(self.dtype))
        if len(values) != self.count:
            raise DataError(CODE, f"a storage of {len(values)} values, expected {self.count}")
        size = math.prod(self.shape)
        return values[self.offset : self.offset + size].reshape(self.shape).astype(np.float32)


@contextmanager
def open_torch(path: StrPath) -> Iterator[Mapping[object, object]]:
    """Open a ``torch.save`` file for the block and give its dictionary.

    Parameters
    ----------
    path : path
        File to read.

    Yields
    ------
    mapping
        Saved dictionary; its tensors are `TorchTensor`.

    Raises
    ------
    StorageError
        The file cannot be read.
    DataError
        ``torch-file``: another format, or objects other than dictionaries, numbers, strings and
        tensors.
    """
    with _open_archive(path) as archive:
        found = _unpickle(archive)
        if not isinstance(found, dict):
            raise _refusal(path, f"a {type(found).__name__}")
        yield found


@contextmanager
def _open_archive(path: StrPath) -> Iterator[zipfile.ZipFile]:
    """Open a ZIP file for the block, and turn errors from damage into ``torch-file``."""
    with storage_errors(path), open_for_read(path) as file:
        try:
            with open_zip(
                file, _MAX_DIRECTORY_BYTES, lambda found: _refusal(path, found)
            ) as archive:
                yield archive
        except DataError:
            raise
        except _DAMAGE as error:
            raise _refusal(path, f"{type(error).__name__}: {error}") from error


def _pickle_name(archive: zipfile.ZipFile) -> str | None:
    """Return the name of the pickle in an archive, or None."""
    return next((name for name in archive.namelist() if name.endswith("/data.pkl")), None)


def _unpickle(archive: zipfile.ZipFile) -> object:
    """Return the saved object; each tensor reads its values when `TorchTensor.array` is called."""
    name = _pickle_name(archive)
    if name is None:
        raise zipfile.BadZipFile("no pickle in the ZIP file")
    folder = name[: -len("data.pkl")]
    data = _read_stored(archive, name, _MAX_PICKLE_BYTES)
    for opcode, number, position in pickletools.genops(data):
        if opcode.name in _STORES and isinstance(number, int) and number > len(data):
            raise pickle.UnpicklingError(
                f"an object numbered {number} at byte {position} of {len(data)}, expected numbers "
                "from 0 on"
            )
    stream = io.BytesIO(data)
    return _TensorUnpickler(
        stream, lambda key: _read_stored(archive, f"{folder}data/{key}", _MAX_BYTES)
    ).load()


def _read_stored(archive: zipfile.ZipFile, name: str, max_bytes: int) -> bytes:
    """Return the bytes of a ZIP entry; refuse a compressed entry, or one above `max_bytes`."""
    entry = archive.getinfo(name)
    if entry.compress_type != zipfile.ZIP_STORED or entry.file_size > min(
        max_bytes, entry.compress_size
    ):
        raise zipfile.BadZipFile(
            f"{name[:60]} of {entry.compress_size} bytes, {entry.file_size} unpacked, expected it "
            f"uncompressed and at most {max_bytes} bytes"
        )
    return archive.read(entry)


def read_state_dict(path: StrPath) -> dict[str, F32]:
    """Read the named arrays of a file of ``torch.save`` or ``numpy.savez``.

    Parameters
    ----------
    path : path
        File to read.

    Returns
    -------
    dict of str to float32 array
        Arrays by name.

    Raises
    ------
    StorageError
        The file cannot be read.
    DataError
        ``torch-file``: another format, or objects other than named arrays.
    """
    with _open_archive(path) as archive:
        if sum(entry.file_size for entry in archive.infolist()) > _MAX_BYTES:
            raise _refusal(path, f"more than {_MAX_BYTES} bytes")
        if _pickle_name(archive) is None:
            names = archive.namelist()
            return {name.removesuffix(".npy"): _read_npy(archive, name) for name in names}
        state = _unpickle(archive)
        if not isinstance(state, dict):
            raise _refusal(path, f"a {type(state).__name__}")
        # State dicts also hold the version numbers of their modules.
        return {str(k): v.array() for k, v in state.items() if isinstance(v, TorchTensor)}


def _read_npy(archive: zipfile.ZipFile, name: str) -> F32:
    """Return one array of a file of ``numpy.savez``."""
    with archive.open(name) as file:
        version = np.lib.format.read_magic(file)
        read_header = {
            (1, 0): np.lib.format.read_array_header_1_0,
            (2, 0): np.lib.format.read_array_header_2_0,
        }
        shape, by_columns, dtype = read_header[version](file)
        data = file.read()
    # numpy's `read_array` allocates the header's size before it reads.
    if dtype.hasobject or len(data) != math.prod(shape) * dtype.itemsize:
        raise ValueError(f"{name[:60]}: {len(data)} bytes, expected {dtype} of shape {shape}")
    values = np.frombuffer(data, dtype).reshape(shape, order="F" if by_columns else "C")
    return np.ascontiguousarray(values, np.float32)


@dataclass(frozen=True)
class _Storage:
    """Flat array of values that one or several tensors share."""

    read: Callable[[], bytes]
    dtype: str
    count: int


class _TensorUnpickler(pickle.Unpickler):
    """Unpickler for dictionaries of tensors, which refuses every foreign class and function."""

    def __init__(self, stream: object, read: Callable[[str], bytes]) -> None:
        super().__init__(stream)  # type: ignore[arg-type]
        self._read = read

    def find_class(self, module: str, name: str) -> object:
        """Return the constructor for an allowed class, or refuse the class."""
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
        """Return the storage that a persistent id of the pickle refers to."""
        if not isinstance(key, tuple) or len(key) != 5 or key[0] != "storage":
            raise pickle.UnpicklingError(f"{str(key)[:80]}, expected a storage")
        _, dtype, name, _, count = key
        if dtype not in _DTYPES.values() or not isinstance(count, int):
            raise pickle.UnpicklingError(f"storage of {str(dtype)[:80]}, expected numbers")
        return _Storage(lambda: self._read(str(name)), str(dtype), count)


def _tensor(
    storage: _Storage, offset: int, shape: tuple[int, ...], stride: tuple[int, ...], *_: object
) -> TorchTensor:
    """Return a contiguous tensor of a storage (``torch._utils._rebuild_tensor_v2``)."""
    count = math.prod(shape)
    steps = [math.prod(shape[axis + 1 :]) for axis in range(len(shape))]
    # Saved weights are contiguous; an axis of length 1 may have any stride.
    plain = all(size == 1 or a == b for size, a, b in zip(shape, stride, steps, strict=True))
    if not plain or not 0 <= offset <= offset + count <= storage.count:
        raise pickle.UnpicklingError(f"tensor of shape {shape} with strides {stride}")
    return TorchTensor(storage.read, storage.dtype, storage.count, offset, tuple(shape))


def _parameter(tensor: TorchTensor, *_: object) -> TorchTensor:
    """Return the tensor of a parameter (``torch._utils._rebuild_parameter``)."""
    return tensor


def _refusal(path: StrPath, found: str) -> DataError:
    """Return the ``torch-file`` error for a damaged or unsupported file."""
    return DataError(CODE, f"{path}: {found[:200]}, expected arrays of torch.save or numpy.savez")
