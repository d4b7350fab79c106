"""Reader for ``torch.save`` files without PyTorch: a ZIP of a pickle and raw tensor storages.

Only dictionaries, numbers, strings and tensors are built. A pickle with any other class or function
is refused, so that no code in it can run. Tensor values are read on access.
"""

from __future__ import annotations

import io
import math
import pickle
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray

from cogsplat.codec.errors import DataError

from .atomic import StrPath, open_for_read, storage_errors
from .npz import array_names, read_array
from .parser_errors import parser_errors
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

# Opcodes of sets, whose items are hashed and which take 216 bytes each, of bytearrays, which are
# allocated before their bytes are read, and of objects beyond dictionaries and tensors.
_REFUSED: Final = (
    *(pickle.EMPTY_SET, pickle.ADDITEMS, pickle.FROZENSET, pickle.BYTEARRAY8, pickle.NEXT_BUFFER),
    *(pickle.NEWOBJ, pickle.NEWOBJ_EX, pickle.INST, pickle.OBJ, pickle.PERSID),
)

# Dimensions of a tensor, and length of an axis. Products of longer shapes would take seconds.
_MAX_DIMENSIONS: Final = 8
_MAX_LENGTH: Final = 1 << 48


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
    with (
        storage_errors(path),
        open_for_read(path) as file,
        parser_errors(lambda found: _refusal(path, found), passed=(OSError,)),
        open_zip(file, _MAX_DIRECTORY_BYTES, lambda found: _refusal(path, found)) as archive,
    ):
        yield archive


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
        ``torch-file``: another format, objects other than named arrays, or no arrays.
    """
    arrays = _read_arrays(path)
    if not arrays:
        raise _refusal(path, "no arrays")
    return arrays


def _read_arrays(path: StrPath) -> dict[str, F32]:
    """Return the arrays of a file by name, perhaps none. Raises as `read_state_dict`."""
    with _open_archive(path) as archive:
        if sum(entry.file_size for entry in archive.infolist()) > _MAX_BYTES:
            raise _refusal(path, f"more than {_MAX_BYTES} bytes")
        if _pickle_name(archive) is None:
            return {
                name: np.ascontiguousarray(read_array(archive, name), np.float32)
                for name in array_names(archive)
            }
        state = _unpickle(archive)
        if not isinstance(state, dict):
            raise _refusal(path, f"a {type(state).__name__}")
        # State dicts also hold the version numbers of their modules.
        tensors = {str(k): v for k, v in state.items() if isinstance(v, TorchTensor)}
        # Tensors may share a storage, so their sizes are not bounded by the file's.
        if sum(4 * math.prod(tensor.shape) for tensor in tensors.values()) > _MAX_BYTES:
            raise _refusal(path, f"tensors of more than {_MAX_BYTES} bytes")
        return {name: tensor.array() for name, tensor in tensors.items()}


@dataclass(frozen=True)
class _Storage:
    """Flat array of values that one or several tensors share."""

    read: Callable[[], bytes]
    dtype: str
    count: int


class _TensorUnpickler(pickle._Unpickler):
    """Unpickler for dictionaries of tensors, which refuses every foreign class and function.

    The pure-Python unpickler, because only there can keys be checked before they are hashed: the
    hash and the text of nested tuples that share their items take exponential time.
    """

    stack: list[Any]
    append: Callable[[object], None]
    pop_mark: Callable[[], list[Any]]
    dispatch: ClassVar[dict[int, Callable[[Any], None]]] = {**pickle._Unpickler.dispatch}

    def __init__(self, stream: io.BytesIO, read: Callable[[str], bytes]) -> None:
        super().__init__(stream)
        self._read = read

    def find_class(self, module: str, name: str) -> object:
        """Return the constructor for an allowed class, or refuse the class."""
        if (module, name) == ("collections", "OrderedDict"):
            return _dictionary
        if (module, name) == ("torch._utils", "_rebuild_tensor_v2"):
            return _tensor
        if (module, name) == ("torch._utils", "_rebuild_parameter"):
            return _parameter
        if module == "torch" and name in _DTYPES:
            return _DTYPES[name]
        raise pickle.UnpicklingError(f"{module}.{name}, expected tensors and dictionaries")

    def persistent_load(self, key: object) -> _Storage:
        """Return the storage that a persistent id of the pickle refers to."""
        if not isinstance(key, tuple) or len(key) != 5 or not all(map(_is_scalar, key)):
            raise pickle.UnpicklingError("an id of another form, expected that of a storage")
        kind, dtype, name, _, count = key
        if kind != "storage" or dtype not in _DTYPES.values() or not isinstance(count, int):
            raise pickle.UnpicklingError(f"storage of {str(dtype)[:80]}, expected numbers")
        return _Storage(lambda: self._read(str(name)), str(dtype), count)

    def set_item(self) -> None:
        """Set one item of a dictionary, whose key and value are on the stack."""
        value, key = self.stack.pop(), self.stack.pop()
        self._set_items([key, value])

    def set_marked_items(self) -> None:
        """Set the items of a dictionary, whose keys and values follow the mark on the stack."""
        self._set_items(self.pop_mark())

    def make_dictionary(self) -> None:
        """Put a dictionary of the keys and values behind the mark on the stack."""
        items = self.pop_mark()
        self.append({})
        self._set_items(items)

    def skip_state(self) -> None:
        """Drop the state of an object: attributes of dictionaries, such as torch's versions."""
        self.stack.pop()

    def refuse(self) -> None:
        """Refuse an opcode that makes no allowed value."""
        raise pickle.UnpicklingError("a set, bytes or an object, expected tensors and dictionaries")

    def _set_items(self, items: list[object]) -> None:
        """Set items of the dictionary on top of the stack, given as keys and values in turn."""
        target = self.stack[-1]
        if not isinstance(target, dict):
            raise pickle.UnpicklingError("items of another object, expected those of a dictionary")
        for key, value in zip(items[::2], items[1::2], strict=True):
            if not isinstance(key, str | int):
                raise pickle.UnpicklingError(f"a key of {type(key).__name__}, expected text")
            target[key] = value

    dispatch[pickle.SETITEM[0]] = set_item
    dispatch[pickle.SETITEMS[0]] = set_marked_items
    dispatch[pickle.DICT[0]] = make_dictionary
    dispatch[pickle.BUILD[0]] = skip_state
    dispatch |= dict.fromkeys((opcode[0] for opcode in _REFUSED), refuse)


def _is_scalar(value: object) -> bool:
    """Whether a value is text, a number or None."""
    return value is None or isinstance(value, str | int | float)


def _dictionary(*arguments: object) -> dict[object, object]:
    """Return an empty dictionary; torch sets its items later."""
    if arguments:
        raise pickle.UnpicklingError("a dictionary of other values, expected an empty one")
    return {}


def _lengths(value: object) -> tuple[int, ...]:
    """Return the shape or the strides of a tensor."""
    if not isinstance(value, tuple) or len(value) > _MAX_DIMENSIONS:
        raise pickle.UnpicklingError(f"a shape of another form, expected {_MAX_DIMENSIONS} lengths")
    if not all(isinstance(length, int) and 0 <= length <= _MAX_LENGTH for length in value):
        raise pickle.UnpicklingError("a shape of other values, expected lengths of axes")
    return value


def _tensor(
    storage: object, offset: object, shape: object, stride: object, *_: object
) -> TorchTensor:
    """Return a contiguous tensor of a storage (``torch._utils._rebuild_tensor_v2``)."""
    if not isinstance(storage, _Storage) or not isinstance(offset, int):
        raise pickle.UnpicklingError("a tensor of other values, expected a storage and an offset")
    shape, stride = _lengths(shape), _lengths(stride)
    count = math.prod(shape)
    steps = [math.prod(shape[axis + 1 :]) for axis in range(len(shape))]
    # Saved weights are contiguous; an axis of length 1 may have any stride.
    plain = all(size == 1 or a == b for size, a, b in zip(shape, stride, steps, strict=True))
    if not plain or not 0 <= offset <= offset + count <= storage.count:
        raise pickle.UnpicklingError(f"tensor of shape {shape} with strides {stride}")
    return TorchTensor(storage.read, storage.dtype, storage.count, offset, shape)


def _parameter(tensor: object, *_: object) -> TorchTensor:
    """Return the tensor of a parameter (``torch._utils._rebuild_parameter``)."""
    if not isinstance(tensor, TorchTensor):
        raise pickle.UnpicklingError("a parameter of another value, expected a tensor")
    return tensor


def _refusal(path: StrPath, found: str) -> DataError:
    """Return the ``torch-file`` error for a damaged or unsupported file."""
    return DataError(CODE, f"{path}: {found[:200]}, expected arrays of torch.save or numpy.savez")
